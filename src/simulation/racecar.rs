//! Parameters of the F1TENTH racecar (scale 1:10), as in its simulators. They are the defaults for simulation, path following and
//! localization.

/// Distance between the axles, m.
pub const WHEELBASE: f64 = 0.33;
/// Maximum steering angle, rad.
pub const MAX_STEERING: f64 = 0.4189;
/// Maximum rate of the steering angle, rad/s.
pub const STEERING_RATE: f64 = 3.2;
/// Maximum acceleration and deceleration, m/s^2.
pub const MAX_ACCELERATION: f64 = 7.51;
