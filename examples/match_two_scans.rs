//! Matches two simulated scans: `cargo run --release --example match_two_scans --no-default-features`.
#![allow(clippy::print_stdout)] // an example prints its results

use anytime_scan_matcher::matching::classic::rejection::RejectionKnobs;
use anytime_scan_matcher::matching::{Matcher, MatchingKnobs};
use anytime_scan_matcher::simulation::pairs::Pairs;
use anytime_scan_matcher::simulation::random_world::RandomWorld;

fn main() {
    // A matcher reuses its buffers from match to match: make one, and use it for all scans.
    let mut matcher = Matcher::new(&MatchingKnobs::default(), &RejectionKnobs::default());

    // Two scans of 1081 beams in a random room, range noise of 1 cm, and an initial guess that is 15 mm and 0.6 degrees off.
    for pair in Pairs::new(RandomWorld::Room, 1081, 1).take(3) {
        matcher.set_reference(&pair.reference);
        let mut refinement = matcher.begin(&pair.sensed, pair.first_guess);

        // An anytime algorithm: `pose` is the best estimate so far at any time. Here it is refined until it has converged.
        let stopped = loop {
            if let Some(reason) = refinement.refine() {
                break reason;
            }
        };

        let error = pair.reference_from_sensed.between(&refinement.pose());
        println!("{} after {} iterations", stopped.name(), refinement.trace().len());
        println!("  true   {:?}\n  found  {:?}", pair.reference_from_sensed, refinement.pose());
        println!("  off by {:.2} mm and {:.3} deg", 1e3 * error.distance(), error.theta.to_degrees());
        if let Some(covariance) = refinement.uncertainty().and_then(|uncertainty| uncertainty.covariance) {
            let sigma = covariance.map_diagonal(f64::sqrt);
            println!("  sigma  {:.2} mm, {:.2} mm, {:.3} deg", 1e3 * sigma.x, 1e3 * sigma.y, sigma.z.to_degrees());
        }
    }
}
