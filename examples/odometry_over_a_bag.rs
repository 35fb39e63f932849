//! Estimates the pose of every scan of a bag: `cargo run --release --example odometry_over_a_bag --no-default-features --features cli [BAG]`.
#![allow(clippy::print_stdout)] // an example prints its results

use std::error::Error;
use std::sync::Arc;

use anytime_scan_matcher::anytime::clock::{Clock, MonotonicClock};
use anytime_scan_matcher::app::App;
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::io::bag::{Bag, BagError};
use anytime_scan_matcher::io::contract_schedule::ContractSchedule;
use anytime_scan_matcher::replay::{Source, Topics, replay};

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).unwrap_or_else(|| "bags/demo.bag".into());
    let bag = Bag::open(path)?;
    // Laser scans or point clouds; wheel odometry on /odom, if the bag has any; the pose of the laser from /tf_static.
    let topics = Topics::resolve(&bag, "/scan", None)?;

    // Every parameter has a default. `--set` and YAML files use the same function.
    let mut config = Config::default();
    config.set("odometry.keyframe_distance", &0.5.into(), "this example")?;

    let clock: Arc<dyn Clock> = Arc::new(MonotonicClock::default());
    let mut app = App::new(&config, Arc::clone(&clock))?;
    let source = Source { bag: &bag, topics: &topics, schedule: &ContractSchedule::default() };
    let mut scans = 0;
    replay::<BagError>(
        &source,
        &mut app,
        &*clock,
        || {}, // called for every message read, to show progress
        |_scan, estimate, _app| {
            let pose = estimate.registration.map_from_base();
            if scans % 40 == 0 {
                println!("{}: {:.3} m, {:.3} m, {:.2} deg", estimate.stamp, pose.x, pose.y, pose.theta.to_degrees());
            }
            scans += 1;
            Ok(())
        },
    )?;
    println!("{scans} scans, {} keyframes", app.odometry_counters().keyframes);
    Ok(())
}
