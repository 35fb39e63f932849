//! Times every single match, with another pair at every call and including the preparation of both scans, because a mean over batches
//! hides how long the slow matches take. Next to the times of all calls it prints those of each pair's fastest call, which exclude what
//! the machine did meanwhile.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

mod walk;

use std::hint::black_box;
use std::time::{Duration, Instant};

use anytime_scan_matcher::matching::classic::correspondence::CorrespondenceKind;
use anytime_scan_matcher::matching::classic::rejection::RejectionKnobs;
use anytime_scan_matcher::matching::{Matcher, MatchingKnobs};
use anytime_scan_matcher::quantile::quantile;
use walk::{LASERS, Laser, match_pair, walk};

/// Timed calls for each pair.
const ROUNDS: usize = 5;
/// Beams of all pairs of a laser together, which limits the number of pairs of lasers with many beams.
const BEAMS: usize = 2_000_000;

fn main() {
    println!("             matcher  beams  pairs |  median     p99  ratio | fastest of {ROUNDS}: median     p99  ratio   [us]");
    for (name, correspondence, with_covariance) in [
        ("covariance included", CorrespondenceKind::Projective, true),
        ("classic, without", CorrespondenceKind::JumpTable, false),
    ] {
        for (degrees, beams) in LASERS {
            let knobs = MatchingKnobs { correspondence, ..MatchingKnobs::default() };
            let pairs = (BEAMS / beams).min(2000);
            let (all, fastest) = times(&knobs, Laser::with_field_of_view(degrees, beams), pairs, with_covariance);
            println!("{name:>20} {beams:>6} {pairs:>6} | {} |             {}", figures(all), figures(fastest));
        }
    }
}

/// The times of all calls, and of the fastest call for each pair.
fn times(knobs: &MatchingKnobs, laser: Laser, pairs: usize, with_covariance: bool) -> (Vec<Duration>, Vec<Duration>) {
    let mut matcher = Matcher::new(knobs, &RejectionKnobs::default());
    let pairs = walk(laser, u32::try_from(pairs).unwrap());
    let (mut all, mut fastest) = (Vec::new(), vec![Duration::MAX; pairs.len()]);
    for round in 0..=ROUNDS {
        for (pair, fastest) in pairs.iter().zip(&mut fastest) {
            let start = Instant::now();
            black_box(match_pair(&mut matcher, pair, with_covariance));
            let time = start.elapsed();
            // The first round warms up.
            if round > 0 {
                all.push(time);
                *fastest = time.min(*fastest);
            }
        }
    }
    (all, fastest)
}

fn figures(mut times: Vec<Duration>) -> String {
    let mut at = |fraction: f64| 1e6 * quantile(&mut times, fraction, Duration::cmp).unwrap().as_secs_f64();
    let (median, p99) = (at(0.5), at(0.99));
    format!("{median:>7.1} {p99:>7.1} {:>6.2}", p99 / median)
}
