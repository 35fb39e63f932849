//! The heading from an IMU message.

use super::{InputError, MAX_VELOCITY, yaw};
use crate::messages::sensor_msgs::Imu;
use crate::odometry::heading::HeadingReading;

/// Reads the yaw and the yaw rate of an IMU message; `None` if the message carries no information. The yaw rate of an IMU mounted
/// `upside_down` changes sign; its orientation already accounts for the mounting.
pub(super) fn reading(message: &Imu, upside_down: bool) -> Result<Option<HeadingReading>, InputError> {
    let (rates, orientation) = (&message.angular_velocity, &message.orientation);
    if ![rates.x, rates.y, rates.z].iter().all(|rate| rate.abs() <= MAX_VELOCITY) {
        return Err(InputError::VelocityNotFinite);
    }
    // A first variance of -1 means that there is no orientation, but not every driver sets it.
    let has_orientation = message.orientation_covariance[0] >= 0.0 && orientation.norm() != 0.0;
    let yaw = if has_orientation { Some(yaw(orientation)?) } else { None };
    let is_empty = yaw.is_none() && rates.x == 0.0 && rates.y == 0.0 && rates.z == 0.0;
    let rate = if upside_down { -rates.z } else { rates.z };
    Ok((!is_empty).then(|| HeadingReading { stamp: message.header.stamp.into(), yaw, rate }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry_msgs::Quaternion;

    fn imu(yaw: Option<f64>, rate: f64) -> Imu {
        let mut message = Imu::default();
        if let Some(yaw) = yaw {
            message.orientation = Quaternion::from_yaw(yaw);
        }
        message.angular_velocity.z = rate;
        message
    }

    fn read_heading(message: &Imu, upside_down: bool) -> Option<(Option<f64>, f64)> {
        reading(message, upside_down).unwrap().map(|reading| (reading.yaw, reading.rate))
    }

    #[test]
    fn only_measured_quantities_are_read() {
        let (yaw, rate) = read_heading(&imu(Some(0.5), 0.2), false).unwrap();
        assert!((yaw.unwrap() - 0.5).abs() < 1e-12 && (rate - 0.2).abs() < 1e-12);
        assert_eq!(read_heading(&imu(None, 0.2), true), Some((None, -0.2)));
        let unknown = Imu { orientation_covariance: [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], ..imu(Some(0.5), 0.2) };
        assert_eq!(read_heading(&unknown, false), Some((None, 0.2)));
        assert_eq!(read_heading(&Imu::default(), false), None);
    }

    #[test]
    fn invalid_rotations_are_rejected() {
        assert_eq!(reading(&imu(None, f64::NAN), false), Err(InputError::VelocityNotFinite));
        let mut long = imu(Some(0.5), 0.2);
        long.orientation.w = 2.0;
        assert!(matches!(reading(&long, false), Err(InputError::QuaternionNotNormalized { .. })));
        long.orientation.w = f64::NAN;
        assert!(reading(&long, false).is_err());
    }
}
