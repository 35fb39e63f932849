//! Times of the correspondence searches by number of beams.

use super::ProfileError;
use crate::anytime::clock::Clock;
use crate::geometry::Point;
use crate::io::bag::Bag;
use crate::matching::classic::correspondence::{CorrespondenceKind, Nearest};
use crate::matching::classic::reference::Reference;
use crate::messages::sensor_msgs::LaserScan;
use crate::quantile;
use crate::replay::microseconds;
use crate::scan::{MIN_BEAMS, Scan, ScanConverter};

/// Approximate number of pairs of consecutive scans, spread over the bag.
const PAIRS: u64 = 12;
/// Timed repetitions for each pair, beam count and search.
const REPEATS: usize = 5;

/// The median time of a search over all points of a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchTime {
    /// The search.
    pub search: CorrespondenceKind,
    /// Number of beams of both scans.
    pub beams: usize,
    /// Median over pairs and repetitions, us.
    pub time_us: f64,
}

/// Times every search on pairs of consecutive scans, with all beams and with each halving of their number. Every search starts
/// without initial correspondences, as in the first iteration of a match. The time to prepare the reference is not included.
pub fn measure(bag: &Bag, scan_topic: &str, max_distance: f64, clock: &dyn Clock) -> Result<Vec<SearchTime>, ProfileError> {
    let pairs = pairs(bag, scan_topic)?;
    let mut converter = ScanConverter::default();
    let mut times = Vec::new();
    for stride in (0..).map(|halvings| 1_usize << halvings) {
        let beams = pairs.first().map_or(0, |(first, _)| first.ranges.len() / stride);
        if beams < 2 * MIN_BEAMS {
            break;
        }
        let mut convert = |message: &LaserScan| converter.convert(&subsampled(message, stride), false).ok();
        let scans: Vec<(Scan, Scan)> =
            pairs.iter().filter_map(|(first, second)| Some((convert(first)?, convert(second)?))).collect();
        let mut samples = vec![Vec::new(); CorrespondenceKind::ALL.len()];
        for (first, second) in &scans {
            time_pair(first, second, max_distance, clock, &mut samples);
        }
        for (&search, mut samples) in CorrespondenceKind::ALL.iter().filter(|kind| kind.search().is_some()).zip(samples) {
            samples.sort_by(f64::total_cmp);
            times.extend(quantile::of_sorted(&samples, 0.5).map(|time_us| SearchTime { search, beams, time_us }));
        }
    }
    Ok(times)
}

/// Adds times to the samples of each search. The searches alternate, so that a slowdown of the machine affects all equally.
fn time_pair(first: &Scan, second: &Scan, max_distance: f64, clock: &dyn Clock, samples: &mut [Vec<f64>]) {
    let mut reference = Reference::default();
    reference.set(first);
    let points: Vec<Point> = second.rays().map(|(_, direction, range)| direction * range).collect();
    let mut searches: Vec<_> = CorrespondenceKind::ALL.iter().filter_map(|kind| kind.search()).collect();
    for search in &mut searches {
        search.prepare(&reference);
    }
    let mut nearest = vec![Nearest::NONE; points.len()];
    for _ in 0..REPEATS {
        for (search, samples) in searches.iter().zip(samples.iter_mut()) {
            nearest.fill(Nearest::NONE);
            let start = clock.now();
            search.find(&reference, &points, max_distance, &mut nearest);
            samples.push(microseconds(clock.now().saturating_sub(start)));
        }
    }
}

/// Reads pairs of consecutive scans, spread over the bag.
fn pairs(bag: &Bag, scan_topic: &str) -> Result<Vec<(LaserScan, LaserScan)>, ProfileError> {
    let every = (bag.message_count(Some(&[scan_topic])) / PAIRS).max(2);
    let mut pairs = Vec::new();
    let mut first = None;
    for (i, message) in (0_u64..).zip(bag.messages(Some(&[scan_topic]))) {
        let position = i % every;
        if position > 1 {
            continue;
        }
        let scan: Option<LaserScan> = message?.decode().ok();
        match (position, first.take(), scan) {
            (0, _, scan) => first = scan,
            (_, Some(first), Some(second)) if first.ranges.len() == second.ranges.len() => pairs.push((first, second)),
            _ => {}
        }
    }
    Ok(pairs)
}

/// A scan with every `stride`-th beam.
#[allow(clippy::cast_possible_truncation)] // the message carries 32 bits
fn subsampled(message: &LaserScan, stride: usize) -> LaserScan {
    let ranges: Vec<f32> = message.ranges.iter().step_by(stride).copied().collect();
    let increment = f64::from(message.angle_increment) * stride as f64;
    let last = f64::from(message.angle_min) + increment * ranges.len().saturating_sub(1) as f64;
    LaserScan {
        angle_increment: increment as f32,
        angle_max: last as f32,
        time_increment: message.time_increment * stride as f32,
        ranges,
        intensities: Vec::new(),
        ..message.clone()
    }
}
