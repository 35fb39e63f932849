//! What a replay hands to the mapper: every scan with what odometry makes of it.

use crate::app::sensed::Sensed;
use crate::app::{App, Estimate};
use crate::mapping::{Mapper, SelfHits};

/// Hands a scan that has been answered to the mapper, and to what looks for the robot in it.
pub fn hand_over(mapper: &mut Mapper, self_hits: &mut SelfHits, message: &Sensed, estimate: &Estimate, app: &mut App) {
    match app.sighting(message, estimate) {
        Some((sighting, measured)) => {
            self_hits.add(&measured, &sighting.odom_from_laser());
            mapper.add(sighting);
        }
        None => {
            mapper.add_unseen(estimate.stamp, estimate.registration.odom_from_base, &app.mount().0.base_from_laser);
        }
    }
}
