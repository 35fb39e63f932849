//! The racecar of F1TENTH, a car at a tenth of its size, as its simulators have it. What simulates, drives or localizes a car takes its
//! defaults from here.

/// Distance between the axles, m.
pub const WHEELBASE: f64 = 0.33;
/// Greatest steering angle, rad.
pub const MAX_STEERING: f64 = 0.4189;
/// Greatest change of the steering angle, rad/s.
pub const STEERING_RATE: f64 = 3.2;
/// Greatest acceleration and braking, m/s^2.
pub const MAX_ACCELERATION: f64 = 7.51;
