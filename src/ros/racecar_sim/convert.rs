//! The messages of `racecar_simulator`, including its peculiarities, which subscribers must be able to cope with.

use super::RANGE_MAX;
use crate::geometry::{Pose2, Twist2};
use crate::messages::geometry_msgs::{PoseStamped, TransformStamped};
use crate::messages::nav_msgs::Odometry;
use crate::messages::sensor_msgs::LaserScan;
use crate::messages::std_msgs::Header;
use crate::messages::tf2_msgs::TFMessage;
use crate::simulation::drive::MAP_FRAME;
use crate::simulation::lidar::LASER_FRAME;
use crate::simulation::odometer::BASE_FRAME;
use crate::time::Stamp;

/// Minimum speed for which it computes a yaw rate, m/s.
const MIN_TURNING_SPEED: f64 = 0.5;

/// Its scans give no scan time, repeat the ranges as intensities, and give the maximum range if there is no wall.
#[allow(clippy::cast_possible_truncation)] // the message carries 32 bits
pub(super) fn scan(number: u32, mut scan: LaserScan) -> LaserScan {
    scan.header.seq = number;
    (scan.scan_time, scan.time_increment) = (0.0, 0.0);
    for range in &mut scan.ranges {
        *range = range.clamp(0.0, RANGE_MAX as f32);
    }
    scan.intensities.clone_from(&scan.ranges);
    scan
}

/// Its odometry is the ground truth in the map frame, with a covariance of zero. The yaw rate is zero if the car is slow or
/// drives backwards.
pub(super) fn odometry(number: u32, stamp: Stamp, map_from_base: Pose2, twist: Twist2) -> Odometry {
    let mut message =
        Odometry { header: Header::new(number, stamp, MAP_FRAME), child_frame_id: BASE_FRAME.into(), ..Odometry::default() };
    message.pose.pose = map_from_base.into();
    message.twist.twist.linear.x = twist.vx;
    message.twist.twist.angular.z = if twist.vx < MIN_TURNING_SPEED { 0.0 } else { twist.omega };
    message
}

/// Its transforms are map -> base -> laser, without an odometry frame.
pub(super) fn transforms(number: u32, stamp: Stamp, map_from_base: Pose2, base_from_laser: Pose2) -> TFMessage {
    let transform = |parent: &str, child: &str, pose: Pose2| TransformStamped {
        header: Header::new(number, stamp, parent),
        child_frame_id: child.into(),
        transform: pose.into(),
    };
    let transforms = vec![transform(MAP_FRAME, BASE_FRAME, map_from_base), transform(BASE_FRAME, LASER_FRAME, base_from_laser)];
    TFMessage { transforms }
}

/// Its ground truth pose has no stamp, and a frame with a leading slash.
pub(super) fn ground_truth(number: u32, map_from_base: Pose2) -> PoseStamped {
    PoseStamped { header: Header::new(number, Stamp::default(), &format!("/{MAP_FRAME}")), pose: map_from_base.into() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::racecar_sim::RacecarSimKnobs;
    use crate::simulation::built_in::BuiltIn;
    use crate::simulation::lidar::Lidar;
    use rand::SeedableRng as _;

    #[test]
    fn the_first_and_last_rays_coincide_and_scans_have_no_times() {
        let knobs = RacecarSimKnobs { scan_std_dev: 0.0, ..RacecarSimKnobs::default() }.lidar();
        let (world, _) = BuiltIn::Room.build();
        let mut lidar = Lidar::new(&knobs, rand_pcg::Pcg64::seed_from_u64(1));
        let scan = scan(7, lidar.scan(|_| &world, |_| Pose2::new(2.0, -1.0, 0.4), Stamp::from_seconds(5.0)));
        assert_eq!((scan.ranges.len(), scan.header.seq, scan.header.frame_id.as_str()), (1080, 7, "laser"));
        assert!((scan.ranges[0] - scan.ranges[1079]).abs() < 1e-4, "{} {}", scan.ranges[0], scan.ranges[1079]);
        assert!((scan.angle_max - scan.angle_min - std::f32::consts::TAU).abs() < 1e-4);
        assert!(scan.scan_time == 0.0 && scan.time_increment == 0.0 && scan.range_min == 0.0 && scan.intensities == scan.ranges);
        let open = super::scan(0, LaserScan { ranges: vec![f32::INFINITY, f32::NEG_INFINITY], ..LaserScan::default() });
        assert_eq!(open.ranges, [100.0, 0.0]);
    }

    #[test]
    fn the_yaw_rate_is_zero_for_slow_cars() {
        let omega = |vx| {
            let twist = Twist2 { vx, vy: 0.0, omega: 1.0 };
            odometry(0, Stamp::default(), Pose2::IDENTITY, twist).twist.twist.angular.z.to_bits()
        };
        assert_eq!([omega(0.4), omega(-2.0), omega(0.6)], [0.0_f64, 0.0, 1.0].map(f64::to_bits));
    }
}
