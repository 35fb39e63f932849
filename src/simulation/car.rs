//! A simulated car that executes commands step by step in a world.

use crate::geometry::{Pose2, Twist2};

use super::vehicle::{Command, Vehicle, VehicleKnobs};
use super::world::World;

/// Collision radius around the middle of the rear axle, m.
const COLLISION_RADIUS: f64 = 0.2;

/// A car and its pose in a world.
pub struct Car<'a> {
    world: &'a dyn World,
    knobs: &'a VehicleKnobs,
    vehicle: Vehicle<'a>,
    map_from_base: Pose2,
    twist: Twist2,
    hits: u32,
}

impl<'a> Car<'a> {
    /// A car at rest.
    pub fn new(world: &'a dyn World, knobs: &'a VehicleKnobs, map_from_base: Pose2) -> Self {
        Self { world, knobs, vehicle: Vehicle::new(knobs), map_from_base, twist: Twist2::default(), hits: 0 }
    }

    /// Pose of `base_link`.
    pub fn map_from_base(&self) -> Pose2 {
        self.map_from_base
    }

    /// Velocity in the frame of the car.
    pub fn twist(&self) -> Twist2 {
        self.twist
    }

    /// Number of collisions with walls.
    pub fn hits(&self) -> u32 {
        self.hits
    }

    /// Executes a command for `seconds` within the limits of the car; walls stop it.
    pub fn step(&mut self, command: Command, seconds: f64) {
        let speed = command.speed.clamp(-self.knobs.speed, self.knobs.speed);
        self.twist = self.vehicle.step(Command { speed, ..command }, seconds);
        let next = self.map_from_base * self.twist.motion(seconds);
        let clearance = |pose: &Pose2| self.world.clearance(pose.translation());
        if clearance(&next) < COLLISION_RADIUS.min(clearance(&self.map_from_base)) {
            self.hits += u32::from(self.twist != Twist2::default());
            self.vehicle.stop();
            self.twist = Twist2::default();
        } else {
            self.map_from_base = next;
        }
    }

    /// Places the car somewhere else; it keeps its speed.
    pub fn teleport(&mut self, map_from_base: Pose2) {
        self.map_from_base = map_from_base;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::built_in::BuiltIn;

    #[test]
    fn walls_stop_the_car_and_it_can_reverse() {
        let (world, _) = BuiltIn::Room.build();
        let knobs = VehicleKnobs::default();
        let mut car = Car::new(&world, &knobs, Pose2::new(3.0, 0.0, 0.0));
        let mut drive = |speed: f64, ticks: u32| {
            for _ in 0..ticks {
                car.step(Command { speed, curvature: 0.0 }, 0.01);
            }
            (car.map_from_base(), car.twist())
        };
        let (at_wall, twist) = drive(5.0, 300);
        assert!((4.0..4.9).contains(&at_wall.x) && at_wall.y.abs() < 1e-9, "{at_wall:?}");
        assert!(twist.vx.abs() < 0.1, "{twist:?}");
        let (away, twist) = drive(-1.0, 200);
        assert!(away.x < at_wall.x - 1.0 && (twist.vx + 1.0).abs() < 1e-9, "{away:?} {twist:?}");
    }

    #[test]
    fn no_command_is_faster_than_the_car() {
        let (world, _) = BuiltIn::Corridor.build();
        let knobs = VehicleKnobs { speed: 2.0, ..VehicleKnobs::default() };
        let mut car = Car::new(&world, &knobs, Pose2::new(0.0, -6.1, 0.0));
        for _ in 0..200 {
            car.step(Command { speed: 100.0, curvature: 0.0 }, 0.01);
        }
        assert!((car.twist().vx - 2.0).abs() < 1e-9);
    }
}
