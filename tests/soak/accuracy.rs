//! Accuracy of single matches over simulated pairs of scans: error, consistency of the covariance, and how far off a guess may be.
//! `cargo test --test soak accuracy -- --nocapture --test-threads 1` prints the tables.

use anytime_scan_matcher::geometry::{Point, Pose2, PoseCovariance, wrap_angle};
use anytime_scan_matcher::matching::classic::rejection::RejectionKnobs;
use anytime_scan_matcher::matching::{Matcher, MatchingKnobs};
use anytime_scan_matcher::simulation::information::pair_covariance_bound;
use anytime_scan_matcher::simulation::pairs::{Pairs, ScanPair};
use anytime_scan_matcher::simulation::random_world::RandomWorld;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const PAIRS: usize = 500;
const SEED: u64 = 4;
/// A match is lost if its translation error is above this, m.
const LOST_TRANSLATION: f64 = 0.05;
/// A match is lost if its rotation error is above this, deg.
const LOST_ROTATION: f64 = 1.0;
/// Maximum error of a far-off guess along each axis, m.
const FAR_TRANSLATION: f64 = 0.5;
/// Maximum rotation error of a far-off guess, deg.
const FAR_ROTATION: f64 = 45.0;

/// The limits for one setting.
struct Limits {
    world: RandomWorld,
    beams: u32,
    /// RMSE from a good guess, mm and mdeg; in the featureless corridor the translation is that across it.
    translation: f64,
    rotation: f64,
    /// Mean normalised estimation error squared, 3 if the covariance is right; `None`: a direction is unconstrained and there is no covariance.
    nees: Option<(f64, f64)>,
    /// Matches lost out of [`PAIRS`] from a zero guess, and from one off by up to [`FAR_TRANSLATION`] and [`FAR_ROTATION`].
    lost: (usize, usize),
}

/// If a direction is unconstrained, the minimum number of pairs that report it.
const OPEN: usize = PAIRS - PAIRS / 100;

const fn limits(world: RandomWorld, beams: u32, rmse: (f64, f64), nees: Option<(f64, f64)>, lost: (usize, usize)) -> Limits {
    Limits { world, beams, translation: rmse.0, rotation: rmse.1, nees, lost }
}

use RandomWorld::{Corridor, CurvedRoom, FeaturelessCorridor, Room, RoughRoom};

/// The target limits.
const MUSTS: [Limits; 3] = [
    limits(Room, 1080, (1.0, 6.0), Some((2.5, 3.5)), (5, 500)),
    limits(Room, 361, (1.75, 12.0), Some((2.5, 3.5)), (5, 500)),
    limits(Room, 181, (2.6, 17.0), Some((2.5, 3.5)), (5, 500)),
];

/// The limits reached: a tenth above the measured errors, a fifth above the measured numbers of lost matches.
const REACHED: [Limits; 15] = [
    limits(Room, 1080, (0.99, 6.0), Some((2.5, 3.5)), (0, 57)),
    limits(Room, 361, (1.69, 11.6), Some((2.5, 3.5)), (0, 60)),
    limits(Room, 181, (2.47, 17.0), Some((2.5, 3.5)), (0, 52)),
    limits(CurvedRoom, 1080, (1.90, 29.4), Some((2.0, 5.3)), (0, 12)),
    limits(CurvedRoom, 361, (3.57, 57.4), Some((2.0, 4.3)), (0, 11)),
    limits(CurvedRoom, 181, (5.34, 85.4), Some((2.0, 3.8)), (0, 12)),
    limits(RoughRoom, 1080, (1.25, 9.5), Some((2.0, 3.2)), (0, 52)),
    limits(RoughRoom, 361, (2.40, 21.8), Some((2.0, 3.0)), (0, 57)),
    limits(RoughRoom, 181, (4.02, 39.1), Some((2.0, 3.4)), (0, 54)),
    limits(Corridor, 1080, (2.24, 5.5), Some((2.0, 2.7)), (8, 39)),
    limits(Corridor, 361, (4.38, 8.5), Some((2.0, 2.7)), (19, 46)),
    limits(Corridor, 181, (6.56, 14.9), Some((2.0, 2.7)), (42, 74)),
    limits(FeaturelessCorridor, 1080, (0.35, 1.6), None, (0, 0)),
    limits(FeaturelessCorridor, 361, (0.64, 2.9), None, (0, 0)),
    limits(FeaturelessCorridor, 181, (0.84, 3.9), None, (0, 0)),
];

/// A matcher with default parameters.
fn default_matcher() -> Matcher {
    Matcher::new(&MatchingKnobs::default(), &RejectionKnobs::default())
}

fn matched(matcher: &mut Matcher, pair: &ScanPair, guess: Pose2) -> (Pose2, Option<PoseCovariance>) {
    matcher.set_reference(&pair.reference);
    let mut refinement = matcher.begin(&pair.sensed, guess);
    while refinement.refine().is_none() {}
    (refinement.pose(), refinement.uncertainty().and_then(|uncertainty| uncertainty.covariance))
}

/// The error of a pose in the frame of the reference: x, y, heading.
fn error(pair: &ScanPair, pose: &Pose2) -> Vector3<f64> {
    let truth = pair.reference_from_sensed;
    Vector3::new(pose.x - truth.x, pose.y - truth.y, wrap_angle(pose.theta - truth.theta))
}

fn is_lost(translation: f64, rotation: f64) -> bool {
    translation.abs() > LOST_TRANSLATION || rotation.abs().to_degrees() > LOST_ROTATION
}

/// A pose off by up to [`FAR_TRANSLATION`] and [`FAR_ROTATION`].
fn from_afar(pose: &Pose2, random: &mut Pcg64) -> Pose2 {
    let mut off = |most: f64| random.random_range(-most..most);
    let (x, y, theta) = (off(FAR_TRANSLATION), off(FAR_TRANSLATION), off(FAR_ROTATION.to_radians()));
    Pose2::new(pose.x + x, pose.y + y, pose.theta + theta)
}

/// The direction that the scans constrain best.
fn best_known(pair: &ScanPair) -> Point {
    let eigen = pair.information.fixed_view::<2, 2>(0, 0).into_owned().symmetric_eigen();
    eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// The results of the pairs of one setting.
#[derive(Debug)]
struct Accuracy {
    translation_mm: f64,
    /// In the direction that the scans constrain best.
    across_mm: f64,
    rotation_mdeg: f64,
    /// The Cramer-Rao bound on the RMSE, over the pairs that have one.
    bound_mm: f64,
    bound_mdeg: f64,
    nees: f64,
    without_covariance: usize,
    lost_from_guess: usize,
    lost_from_zero: usize,
    lost_from_afar: usize,
}

impl Accuracy {
    fn measure(world: RandomWorld, beams: u32) -> Self {
        let mut matcher = default_matcher();
        let mut random = Pcg64::seed_from_u64(SEED);
        let (mut errors, mut across, mut nees, mut bounds) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let mut lost = [0; 3];
        for pair in Pairs::new(world, beams, SEED).take(PAIRS) {
            let (pose, covariance) = matched(&mut matcher, &pair, pair.first_guess);
            let error_of_pair = error(&pair, &pose);
            let inverse = covariance.and_then(PoseCovariance::try_inverse);
            nees.extend(inverse.map(|inverse| error_of_pair.dot(&(inverse * error_of_pair))));
            let best_known = best_known(&pair);
            across.push(best_known.dot(&error_of_pair.xy()));
            errors.push(error_of_pair);
            bounds.extend(pair_covariance_bound(&pair.information));

            let far = from_afar(&pair.reference_from_sensed, &mut random);
            let others = [Pose2::IDENTITY, far].map(|guess| matched(&mut matcher, &pair, guess).0);
            for (lost, pose) in lost.iter_mut().zip([pose, others[0], others[1]]) {
                let error = error(&pair, &pose);
                // The position along a featureless corridor is unobservable.
                let across_only = world == FeaturelessCorridor;
                let translation = if across_only { best_known.dot(&error.xy()) } else { error.xy().norm() };
                *lost += usize::from(is_lost(translation, error.z));
            }
        }
        let root_of_mean = |variance: fn(&PoseCovariance) -> f64| -> f64 {
            (bounds.iter().map(variance).sum::<f64>() / bounds.len() as f64).sqrt()
        };
        Self {
            translation_mm: 1e3 * rms(&errors.iter().map(|e| e.xy().norm()).collect::<Vec<_>>()),
            across_mm: 1e3 * rms(&across),
            rotation_mdeg: 1e3 * rms(&errors.iter().map(|e| e.z.to_degrees()).collect::<Vec<_>>()),
            bound_mm: 1e3 * root_of_mean(|bound| bound.m11 + bound.m22),
            bound_mdeg: 1e3 * root_of_mean(|bound| bound.m33).to_degrees(),
            nees: nees.iter().sum::<f64>() / nees.len() as f64,
            without_covariance: PAIRS - nees.len(),
            lost_from_guess: lost[0],
            lost_from_zero: lost[1],
            lost_from_afar: lost[2],
        }
    }
}

const HEADER: &str =
    "world                 beams | RMSE mm  across  bound | RMSE mdeg  bound |   NEES  none | lost of 500: guess  zero   far";

fn print(limits: &Limits, a: &Accuracy) {
    println!(
        "{:<21} {:>5} | {:>7.3} {:>7.3} {:>6.3} | {:>9.2} {:>6.2} | {:>6.2} {:>5} | {:>18} {:>5} {:>5}",
        limits.world.name(),
        limits.beams,
        a.translation_mm,
        a.across_mm,
        a.bound_mm,
        a.rotation_mdeg,
        a.bound_mdeg,
        a.nees,
        a.without_covariance,
        a.lost_from_guess,
        a.lost_from_zero,
        a.lost_from_afar
    );
    let must = MUSTS.iter().find(|must| must.world == limits.world && must.beams == limits.beams);
    if let Some(Limits { translation, rotation, nees: Some((low, high)), lost, .. }) = must {
        println!(
            "{:>27} | {translation:>7.3} {:>14} | {rotation:>9.2} {:>6} | {:.1}-{:.1} {:>22} {:>6}",
            "must", "", "", low, high, "", lost.0
        );
    }
}

fn check(limits: &Limits, a: &Accuracy) {
    let name = format!("{} of {} beams: {a:?}", limits.world.name(), limits.beams);
    let translation = if limits.world == FeaturelessCorridor { a.across_mm } else { a.translation_mm };
    assert!(translation <= limits.translation, "{name}");
    assert!(a.rotation_mdeg <= limits.rotation, "{name}");
    match limits.nees {
        Some((low, high)) => assert!((low..=high).contains(&a.nees), "{name}"),
        None => assert!(a.without_covariance >= OPEN, "{name}"),
    }
    assert_eq!(a.lost_from_guess, 0, "{name}");
    assert!(a.lost_from_zero <= limits.lost.0 && a.lost_from_afar <= limits.lost.1, "{name}");
}

fn every_setting_of(world: RandomWorld) {
    println!("{HEADER}");
    for limits in REACHED.iter().filter(|limits| limits.world == world) {
        let accuracy = Accuracy::measure(world, limits.beams);
        print(limits, &accuracy);
        check(limits, &accuracy);
    }
}

#[test]
fn rooms() {
    every_setting_of(Room);
}

#[test]
fn curved_rooms() {
    every_setting_of(CurvedRoom);
}

#[test]
fn rough_rooms() {
    every_setting_of(RoughRoom);
}

#[test]
fn corridors() {
    every_setting_of(Corridor);
}

#[test]
fn featureless_corridors() {
    every_setting_of(FeaturelessCorridor);
}

// ---- how far off a guess may be ----

const DISTANCES: [f64; 6] = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5];
const ANGLES: [f64; 7] = [0.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0];
const PAIRS_PER_CELL: usize = 100;

/// Percentage of the pairs that are matched, by distance and rotation of the guess error, in random directions.
fn success_table(world: RandomWorld, beams: u32) -> Vec<Vec<usize>> {
    let pairs: Vec<ScanPair> = Pairs::new(world, beams, SEED).take(PAIRS_PER_CELL).collect();
    let mut matcher = default_matcher();
    let mut random = Pcg64::seed_from_u64(SEED);
    let mut succeeds = |pair: &ScanPair, distance: f64, angle: f64| {
        let (sin, cos) = random.random_range(0.0..std::f64::consts::TAU).sin_cos();
        let turn = if random.random() { angle } else { -angle }.to_radians();
        let truth = pair.reference_from_sensed;
        let guess = Pose2::new(truth.x + distance * cos, truth.y + distance * sin, truth.theta + turn);
        let error = error(pair, &matched(&mut matcher, pair, guess).0);
        !is_lost(error.xy().norm(), error.z)
    };
    let mut cell = |distance, angle| 100 * pairs.iter().filter(|pair| succeeds(pair, distance, angle)).count() / PAIRS_PER_CELL;
    DISTANCES.iter().map(|&distance| ANGLES.iter().map(|&angle| cell(distance, angle)).collect()).collect()
}

#[test]
fn success_from_far_off() {
    for (world, beams) in [(Room, 1080), (Room, 361), (Room, 181), (Corridor, 361), (RoughRoom, 361)] {
        let table = success_table(world, beams);
        println!("% matched, {} of {beams} beams, from a guess off by\n          {ANGLES:>5.0?} deg", world.name());
        for (distance, row) in DISTANCES.iter().zip(&table) {
            println!("{distance:>7.1} m {row:>6?}");
        }
        let well_within = table.iter().flat_map(|row| &row[..3]);
        // In a corridor only a few beams constrain the position along it: 91 % measured.
        let least = if world == Corridor { 89 } else { 99 };
        assert!(well_within.min() >= Some(&least), "{} of {beams} beams: {table:?}", world.name());
    }
}
