//! What a replay hands to the mapper: every scan with what odometry makes of it.

use crate::app::sensed::Sensed;
use crate::app::{App, Estimate};
use crate::mapping::{Mapper, Passage, SelfHits, Sighting};
use crate::odometry::Outcome;

/// Hands a scan that has been answered to the mapper, and to what looks for the robot in it.
pub fn hand_over(mapper: &mut Mapper, self_hits: &mut SelfHits, message: &Sensed, estimate: &Estimate, app: &mut App) {
    let registration = &estimate.registration;
    let (odom_from_base, base_from_laser) = (registration.odom_from_base, app.mount().0.base_from_laser);
    let passage = match &registration.outcome {
        Outcome::First => Some(Passage::Start),
        Outcome::Matched => Some(Passage::Known),
        // Where no match was tried the scan was malformed, or one that had been answered before.
        Outcome::Predicted(_) => registration.refinement.map(|_| Passage::Lost),
    };
    let scan = passage.and_then(|passage| Some((passage, app.scan(message)?)));
    match scan {
        Some((passage, scan)) => {
            self_hits.add(&scan, &(odom_from_base * base_from_laser));
            mapper.add(Sighting { scan: app.undistorted(scan), odom_from_base, base_from_laser, passage });
        }
        None => mapper.add_unseen(estimate.stamp, odom_from_base, &base_from_laser),
    }
}
