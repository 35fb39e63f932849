//! `ackermann_msgs`.

use super::definition::messages;
use super::std_msgs::Header;

messages! { "ackermann_msgs":
    AckermannDrive { steering_angle: f32, steering_angle_velocity: f32, speed: f32, acceleration: f32, jerk: f32 }
    AckermannDriveStamped { header: Header, drive: AckermannDrive }
}
