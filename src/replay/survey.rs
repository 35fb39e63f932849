//! Passes the scans of a replay, with their odometry poses, to the mapper.

use crate::app::sensed::SensorMessage;
use crate::app::{App, Estimate};
use crate::mapping::{Mapper, SelfHits};

/// Adds a processed scan to the map, and to the detection of self hits.
pub fn add_scan(mapper: &mut Mapper, self_hits: &mut SelfHits, message: &SensorMessage, estimate: &Estimate, app: &mut App) {
    match app.posed_scan(message, estimate) {
        Some((posed_scan, measured)) => {
            self_hits.add(&measured, &posed_scan.odom_from_laser());
            mapper.add(posed_scan);
        }
        None => {
            mapper.add_pose_only(estimate.stamp, estimate.registration.odom_from_base, &app.mount().0.base_from_laser);
        }
    }
}
