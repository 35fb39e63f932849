//! The particle filter on simulated drives through real maps.

mod clock;
mod command;
mod contract;
mod lag;
mod recovery;
mod sweep;

use std::convert::Infallible;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::common::{corridor, shared};
use anytime_scan_matcher::anytime::clock::{Clock, MonotonicClock};
use anytime_scan_matcher::anytime::interrupt::{InterruptRequest, NeverInterrupt};
use anytime_scan_matcher::app::ScanProcessor as _;
use anytime_scan_matcher::app::localizer::{Localizer, RejectedScan};
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::evaluation::consistency::Consistency;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::map_file;
use anytime_scan_matcher::knobs::Seconds;
use anytime_scan_matcher::localization::estimate::Belief;
use anytime_scan_matcher::map::grid::OccupancyGrid;
use anytime_scan_matcher::matching::StopReason;
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use anytime_scan_matcher::simulation::drive::{Settings, SimulatedMessage, simulate};
use anytime_scan_matcher::simulation::scene::Scene;
use anytime_scan_matcher::time::Stamp;

fn map(name: &str) -> Option<OccupancyGrid> {
    Some(map_file::read(&shared(&format!("data/maps/{name}.yaml"))?).unwrap())
}

/// A drive, simulated message by message.
struct Drive {
    seed: u32,
    seconds: f64,
    rate: f64,
}

/// The results of a drive.
#[derive(Default)]
struct Outcome {
    /// For each scan the error of the belief, and the belief.
    answers: Vec<(Pose2, Belief)>,
    metres: f64,
    times: Vec<Duration>,
    /// Rays cast for each scan.
    rays: Vec<u64>,
}

impl Outcome {
    /// RMS of the position error, m, and of the heading error, deg, after the first `skip` scans.
    fn rmse(&self, skip: usize) -> (f64, f64) {
        let errors: Vec<_> = self.answers.iter().skip(skip).map(|(error, _)| *error).collect();
        let root = |of: fn(&Pose2) -> f64| (errors.iter().map(|e| of(e).powi(2)).sum::<f64>() / errors.len() as f64).sqrt();
        (root(Pose2::distance), root(|error| error.theta.to_degrees()))
    }

    /// Consistency of the covariances.
    fn consistency(&self, skip: usize) -> Consistency {
        let poses = self.answers.iter().skip(skip).map(|(error, belief)| {
            let Pose2 { x, y, theta } = belief.map_from_base;
            (&belief.map_from_base, &belief.covariance, Pose2::new(x - error.x, y - error.y, theta - error.theta))
        });
        let poses: Vec<_> = poses.collect();
        Consistency::of(poses.iter().map(|(pose, covariance, truth)| (*pose, *covariance, truth))).unwrap()
    }

    fn time(&mut self, percent: usize) -> Duration {
        self.times.sort_unstable();
        self.times[(self.times.len() - 1) * percent / 100]
    }

    /// Whether the estimate was right during the last second of the drive.
    fn converged(&self, rate: f64) -> bool {
        let last = self.answers.len().saturating_sub(rate as usize);
        self.answers[last..].iter().all(|answer| is_right(answer) && answer.1.is_localized())
    }
}

/// Whether the estimated pose is right.
fn is_right((error, _): &(Pose2, Belief)) -> bool {
    error.distance() < 0.3 && error.theta.abs() < 0.1
}

/// Runs drives one after the other, between which the robot is kidnapped; `prepare` is called before the first scan.
fn run(map: &OccupancyGrid, drives: &[Drive], config: &Config, prepare: impl Fn(&mut Localizer, Pose2)) -> Outcome {
    run_in(map, map, drives, config, prepare)
}

/// The same in a world that may differ from the localizer's map.
fn run_in(
    world: &OccupancyGrid,
    map: &OccupancyGrid,
    drives: &[Drive],
    config: &Config,
    prepare: impl Fn(&mut Localizer, Pose2),
) -> Outcome {
    let mut localizer = Localizer::new(map.clone(), config, clock()).unwrap();
    let (mut truth, mut outcome) = (Truth::default(), Outcome::default());
    for (number, drive) in drives.iter().enumerate() {
        let later = number as f64 * (drive.seconds + 1.0);
        let scene = Scene::in_map(world.clone(), drive.seed).unwrap();
        let mut settings = Settings::default();
        settings.drive.duration = Seconds(drive.seconds);
        settings.drive.seed = drive.seed;
        settings.lidar.rate = drive.rate;
        let first = truth.0.len();
        // As in the node, a scan waits until its odometry has arrived.
        let mut held: Option<LaserScan> = None;
        simulate::<Infallible>(&settings, &scene, |_, message| {
            held = feed(&mut localizer, shifted(message, later), &mut truth, &prepare).or(held.take());
            if let Some(scan) = held.take_if(|scan| localizer.wait_for_inputs(&scan.header).is_none()) {
                let (start, rays) = (Instant::now(), localizer.filter().rays_cast());
                let belief = process(&mut localizer, &scan).unwrap();
                outcome.times.push(start.elapsed());
                outcome.rays.push(localizer.filter().rays_cast() - rays);
                let true_pose = truth.at(scan.header.stamp.into());
                let (x, y) = (belief.map_from_base.x - true_pose.x, belief.map_from_base.y - true_pose.y);
                let error = Pose2::new(x, y, belief.map_from_base.theta - true_pose.theta);
                outcome.answers.push((error, belief));
            }
            Ok(())
        })
        .unwrap();
        outcome.metres += truth.0[first..].windows(2).map(|poses| poses[0].1.between(&poses[1].1).distance()).sum::<f64>();
    }
    outcome
}

/// The true poses so far.
#[derive(Default)]
struct Truth(Vec<(Stamp, Pose2)>);

impl Truth {
    fn latest(&self) -> Pose2 {
        self.0.last().unwrap().1
    }

    fn at(&self, stamp: Stamp) -> Pose2 {
        self.0.iter().rev().find(|(time, _)| *time <= stamp).unwrap().1
    }
}

/// Passes a message of a simulated drive to the localizer, except a scan, which is returned. `start` is called with the first true pose.
fn feed(
    localizer: &mut Localizer,
    message: SimulatedMessage,
    truth: &mut Truth,
    start: impl Fn(&mut Localizer, Pose2),
) -> Option<LaserScan> {
    match message {
        SimulatedMessage::Mount(mount) => localizer.on_transforms(&mount).unwrap(),
        SimulatedMessage::Odometry(odometry) => localizer.on_odometry(&odometry).unwrap(),
        SimulatedMessage::Truth { stamp, map_from_base } => {
            if truth.0.is_empty() {
                start(localizer, map_from_base);
            }
            truth.0.push((stamp, map_from_base));
        }
        SimulatedMessage::Scan(scan) => return Some(scan),
    }
    None
}

/// The message with a stamp `seconds` later.
fn shifted(mut message: SimulatedMessage, seconds: f64) -> SimulatedMessage {
    match &mut message {
        SimulatedMessage::Mount(_) => {}
        SimulatedMessage::Odometry(odometry) => {
            odometry.header.stamp = Stamp::from(odometry.header.stamp).offset_by(seconds).into();
        }
        SimulatedMessage::Truth { stamp, .. } => *stamp = stamp.offset_by(seconds),
        SimulatedMessage::Scan(scan) => scan.header.stamp = Stamp::from(scan.header.stamp).offset_by(seconds).into(),
    }
    message
}

/// A clock; the answers do not depend on it.
fn clock() -> Arc<dyn Clock> {
    Arc::new(MonotonicClock::default())
}

/// Processes a scan, including the work after the answer.
fn process(localizer: &mut Localizer, scan: &LaserScan) -> Result<Belief, RejectedScan> {
    let mut fix = localizer.on_scan(scan, Duration::ZERO, &NeverInterrupt);
    localizer.conclude(&mut fix);
    localizer.maintain(&NeverInterrupt);
    fix.belief
}

fn at_truth(localizer: &mut Localizer, pose: Pose2) {
    localizer.start_at(&(pose * Pose2::new(0.1, -0.1, 0.05)), None);
}

/// Checks that drives are tracked with errors of at most `most`, m and deg.
fn tracks(map: &OccupancyGrid, name: &str, (seconds, metres): (f64, f64), threads: u32, most: (f64, f64)) {
    let mut config = Config::default();
    config.localization.threads = threads;
    let mut outcome = run(map, &[Drive { seed: 3, seconds, rate: 40.0 }], &config, at_truth);
    let (position, heading) = outcome.rmse(40);
    let times = [50, 99, 100].map(|percent| outcome.time(percent));
    let effective = outcome.answers.iter().map(|(_, belief)| belief.effective).sum::<f64>() / outcome.answers.len() as f64;
    eprintln!(
        "{name}: {:.0} m, position {position:.4} m, heading {heading:.3} deg, effective {effective:.0}; update p50, p99, max {times:?}",
        outcome.metres
    );
    assert!(outcome.metres >= metres && position < most.0 && heading < most.1);
    let Consistency { positions_within, nees, .. } = outcome.consistency(0);
    eprintln!("{name}: {:.1} % of the positions within three sigma, NEES {nees:.2}", 100.0 * positions_within);
    assert!(positions_within > 0.98 && nees < 3.0, "{name}: overconfident");
}

#[test]
fn a_drive_is_tracked() {
    tracks(&corridor(), "made-up corridor", (25.0, 40.0), 0, (0.0152, 0.21));
}

#[test]
fn the_map_may_be_rotated_and_have_any_resolution() {
    let grid = corridor();
    let turned = OccupancyGrid::new(grid.width(), 0.06, Pose2::new(7.0, -3.0, 2.0), grid.cells().to_vec()).unwrap();
    let outcome = run(&turned, &[Drive { seed: 3, seconds: 8.0, rate: 20.0 }], &Config::default(), at_truth);
    let (position, heading) = outcome.rmse(20);
    assert!(outcome.metres > 5.0 && position < 0.05 && heading < 0.5, "{position} m, {heading} deg in {} m", outcome.metres);
}

#[test]
#[ignore = "half a minute for each map"]
fn long_drives_on_real_maps_are_tracked() {
    // A fifth above the figures of docs/localization.md.
    for (name, most) in [("levine", (0.018, 0.216)), ("columbia", (0.0156, 0.276)), ("skirk", (0.0108, 0.192))] {
        let Some(map) = map(name) else { return };
        tracks(&map, name, (85.0, 200.0), 1, most);
    }
}

#[test]
fn the_same_seed_gives_the_same_belief_on_any_number_of_threads() {
    let map = corridor();
    let beliefs = |threads: u32, seed: u32| {
        let mut config = Config::default();
        config.set_yaml(&format!("localization: {{threads: {threads}, seed: {seed}, global_particles: 20000}}"), "test").unwrap();
        let outcome = run(&map, &[Drive { seed: 1, seconds: 1.5, rate: 20.0 }], &config, |_, _| {});
        outcome.answers.into_iter().map(|(_, belief)| belief).collect::<Vec<_>>()
    };
    let one = beliefs(1, 1);
    assert!(one == beliefs(1, 1) && one == beliefs(3, 1));
    assert!(one != beliefs(1, 2));
}

/// Results of global localization trials.
struct Tries {
    /// Fraction of the trials that end at the robot.
    found: f64,
    /// Fraction of all answers that report a wrong pose as localized.
    false_claims: f64,
}

fn search(map: &OccupancyGrid, name: &str, tries: u32, seconds: f64, rate: f64) -> Tries {
    let (mut found, mut waits, mut claims, mut answers) = (0, Vec::new(), 0, 0);
    for seed in 1..=tries {
        let mut config = Config::default();
        config.localization.seed = seed;
        let outcome = run(map, &[Drive { seed, seconds, rate }], &config, |_, _| {});
        let false_claims = outcome.answers.iter().filter(|answer| answer.1.is_localized() && !is_right(answer)).count();
        let last_wrong = outcome.answers.iter().rposition(|answer| !(answer.1.is_localized() && is_right(answer)));
        waits.push(last_wrong.map_or(0.0, |last| (last + 1) as f64 / rate));
        (claims, answers) = (claims + false_claims, answers + outcome.answers.len());
        let converged = outcome.converged(rate);
        found += u32::from(converged);
        if !converged || false_claims > 0 {
            let (error, belief) = outcome.answers.last().unwrap();
            eprintln!("{name}, seed {seed}: {false_claims} false claims; at last {error:?}, {belief:?}");
        }
    }
    waits.sort_by(f64::total_cmp);
    let tries = Tries { found: f64::from(found) / f64::from(tries), false_claims: claims as f64 / answers as f64 };
    let median = waits[waits.len() / 2];
    eprintln!(
        "{name}: {found} of {} trials found the robot within {seconds} s, half of them within {median} s; false claims in {:.2} % of the answers",
        waits.len(),
        100.0 * tries.false_claims
    );
    tries
}

#[test]
fn the_robot_is_found_wherever_it_is() {
    assert!(search(&corridor(), "made-up corridor", 3, 20.0, 10.0).found > 0.99);
}

#[test]
#[ignore = "some minutes"]
fn the_robot_is_found_on_real_maps() {
    let maps = ["levine", "columbia"].into_iter().filter_map(|name| Some((name, map(name)?)));
    let all: Vec<Tries> = maps.map(|(name, map)| search(&map, name, 20, 45.0, 40.0)).collect();
    assert!(all.iter().all(|tries| tries.found >= 0.95 && tries.false_claims < 0.01));
}

/// The first scans of a drive through the corridor, and its start pose.
fn three_scans() -> (Vec<LaserScan>, Pose2) {
    let (mut scans, mut start) = (Vec::new(), None);
    simulate::<()>(&Settings::default(), &Scene::in_map(corridor(), 1).unwrap(), |_, message| match message {
        SimulatedMessage::Scan(scan) => {
            scans.push(scan);
            if scans.len() == 3 { Err(()) } else { Ok(()) }
        }
        SimulatedMessage::Truth { map_from_base, .. } => {
            start.get_or_insert(map_from_base);
            Ok(())
        }
        _ => Ok(()),
    })
    .unwrap_err();
    (scans, start.unwrap())
}

#[test]
fn an_interrupt_is_answered_at_once_and_the_scan_is_used_later() {
    let mut localizer = Localizer::new(corridor(), &Config::default(), clock()).unwrap();
    let ((scans, start), request) = (three_scans(), InterruptRequest::default());
    localizer.start_at(&start, None);
    let mut answer = |scan: &LaserScan| {
        let mut fix = localizer.on_scan(scan, Duration::ZERO, &request);
        localizer.conclude(&mut fix);
        localizer.maintain(&NeverInterrupt);
        (fix.stop_reason, fix.belief.unwrap())
    };
    request.make();
    let (reason, called) = answer(&scans[0]);
    assert_eq!((reason, called.beams), (Some(StopReason::Interrupted), 0));
    request.clear();
    let (reason, free) = answer(&scans[1]);
    assert_eq!((reason, free.beams), (Some(StopReason::Converged), 60));
    let [free, called] = [free, called].map(|belief| belief.covariance.m11 + belief.covariance.m22);
    assert!(free < 0.5 * called, "the first scan must have narrowed the cloud: {free} after {called} m^2");
}

#[test]
fn no_scan_is_used_twice_and_bad_scans_change_nothing() {
    let mut localizer = Localizer::new(corridor(), &Config::default(), clock()).unwrap();
    let (scans, _) = three_scans();
    process(&mut localizer, &scans[1]).unwrap();
    let poses: Vec<_> = localizer.filter().poses().collect();
    assert_eq!(process(&mut localizer, &scans[1]), Err(RejectedScan::NotNewer));
    assert_eq!(process(&mut localizer, &scans[0]), Err(RejectedScan::NotNewer));
    let mut broken = scans[2].clone();
    broken.ranges.truncate(5);
    assert!(matches!(process(&mut localizer, &broken), Err(RejectedScan::Unusable(_))));
    assert!(poses.iter().eq(localizer.filter().poses().collect::<Vec<_>>().iter()));
    // Outside the map nothing can be estimated, and nothing fails.
    localizer.start_at(&Pose2::new(1e4, -1e4, 0.0), None);
    assert!(process(&mut localizer, &scans[2]).unwrap().map_from_base.is_finite());
}
