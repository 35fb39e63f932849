//! Pairs of scans for the benches: a walk through the tests' room.
#![allow(dead_code, unreachable_pub)]

#[path = "../../tests/common/mod.rs"]
mod common;

use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::matching::Matcher;
use anytime_scan_matcher::scan::Scan;
pub use common::Laser;
use common::normal;
use rand::SeedableRng;
use rand_pcg::Pcg64;

/// Fields of view, in degrees, and numbers of beams of the lasers in the benches.
pub const LASERS: [(f64, usize); 4] = [(180.0, 181), (180.0, 361), (270.0, 1081), (270.0, 10_000)];

/// A reference scan, a scan to match, and an initial guess of its pose.
pub struct Pair {
    pub reference: Scan,
    pub sensed: Scan,
    pub guess: Pose2,
}

/// The steps of a walk through the room, each with an initial guess that is off by 15 mm and 0.6 degrees.
pub fn walk(laser: Laser, steps: u32) -> Vec<Pair> {
    let mut rng = Pcg64::seed_from_u64(21);
    let pose = |i: u32| {
        let angle = f64::from(i) * 0.05;
        Pose2::new(1.5 * angle.cos() - 1.0, 1.5 * angle.sin(), angle + 1.5)
    };
    let scans: Vec<Scan> = (0..=steps).map(|i| laser.scan(pose(i), 0.01, 0.0, &mut rng)).collect();
    let mut pair = |i: u32| {
        let motion = pose(i).between(&pose(i + 1));
        let mut off = |value: f64| value + 0.01 * normal(&mut rng);
        let guess = Pose2::new(off(motion.x), off(motion.y), off(motion.theta));
        Pair { reference: scans[i as usize].clone(), sensed: scans[i as usize + 1].clone(), guess }
    };
    (0..steps).map(&mut pair).collect()
}

/// Runs a whole match, including the preparation of both scans.
pub fn match_pair(matcher: &mut Matcher, pair: &Pair, with_covariance: bool) -> Pose2 {
    matcher.set_reference(&pair.reference);
    let mut refinement = matcher.begin(&pair.sensed, pair.guess);
    while refinement.refine().is_none() {}
    if with_covariance {
        std::hint::black_box(refinement.uncertainty());
    }
    refinement.pose()
}
