//! A node that works on scans of random length, and estimates that can be checked.

use std::hint;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::shared_memory::{CompletedEstimate, Responder, SharedEstimate};
use anytime_scan_matcher::time::Stamp;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Timeout of waits, far longer than a loaded machine needs.
pub(crate) const TIMEOUT: Duration = Duration::from_secs(60);

/// A segment name that no other test or test run uses.
pub(crate) fn unique(test: &str) -> String {
    format!("/anytime_scan_matcher_{test}_{}", std::process::id())
}

/// The file of the segment `name`.
pub(crate) fn file_of(name: &str) -> PathBuf {
    PathBuf::from(format!("/dev/shm{name}"))
}

/// The estimate with this number, from which every field is derived.
pub(crate) fn estimate(number: u32) -> SharedEstimate {
    let value = f64::from(number);
    SharedEstimate {
        stamp: Stamp::from_ros(number, number % 1_000_000_000),
        odom_from_base: Pose2 { x: value, y: -2.0 * value, theta: value + 0.5 },
        position_deviation: value + 0.25,
        heading_deviation: value + 0.75,
        elapsed: Duration::from_nanos(u64::from(number) * 3),
        ok: number.is_multiple_of(2),
        deadline_met: number.is_multiple_of(3),
        interrupted: number.is_multiple_of(5),
    }
}

/// Checks that all fields belong to the same estimate.
pub(crate) fn assert_whole(completed: &CompletedEstimate) {
    assert_eq!(completed.estimate, estimate(completed.number));
}

/// Lets up to `longest_us` microseconds pass, mostly spinning, sometimes asleep.
pub(crate) fn pause_randomly(rng: &mut Pcg64, longest_us: u64) {
    if rng.random_bool(0.02) {
        thread::sleep(Duration::from_micros(longest_us));
        return;
    }
    let (start, time) = (Instant::now(), Duration::from_micros(rng.random_range(0..=longest_us)));
    while start.elapsed() < time {
        hint::spin_loop();
    }
}

/// Works on scans until told to stop, with random pauses; returns the number of estimates published.
pub(crate) fn work(responder: &Responder, seed: u64, stop: &AtomicBool) -> u32 {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut published = 0;
    while !stop.load(Ordering::Relaxed) {
        if rng.random_bool(0.5) {
            pause_randomly(&mut rng, 20);
        }
        responder.begin();
        for _ in 0..rng.random_range(0..20) {
            pause_randomly(&mut rng, 5);
            if responder.is_requested() {
                break;
            }
        }
        published += 1;
        assert_eq!(responder.publish(&estimate(published)), published);
    }
    published
}
