//! Steering trim: what the wheels are turned by when they are to be straight.

/// The car drives so far until an error of the trim has fallen to 37 %, m. A heading that is 0.2 degrees off by chance then moves the trim
/// of a racecar by 0.01 degrees; the offset of a servo is one for the whole drive.
const REACH: f64 = 5.0;
/// No servo is farther off, three degrees, rad: what asks for more is a pose that jumps, or somebody else at the wheel.
const MOST: f64 = 0.05;

/// The trim of a car, learned along the way.
///
/// A law that steers towards the path makes up for an offset only by standing beside the path: Stanley's by `v tan(offset) / k`, 3 cm at
/// 8 m/s for half a degree. So the offset is estimated as a disturbance: a car that has turned by more than its commands say has wheels
/// that stand farther to the left.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Trim {
    angle: f64,
}

impl Trim {
    /// Steering angle of the wheels when they are told to be straight, rad.
    pub fn angle(&self) -> f64 {
        self.angle
    }

    /// On `way` m the car, `wheelbase` m from axle to axle, has turned by `excess` rad more than its commands, with this trim taken into
    /// account, say.
    ///
    /// In small angles the offset of one step is `excess wheelbase / way`, and its weight `way / REACH`. Sums of `excess` telescope: noise
    /// of the headings does not add up.
    pub fn learn(&mut self, excess: f64, way: f64, wheelbase: f64) {
        let most = 2.0 * MOST * way.abs() / wheelbase;
        let forward = way.signum();
        self.angle = (self.angle + forward * excess.clamp(-most, most) * wheelbase / REACH).clamp(-MOST, MOST);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_offset_of_the_wheels_is_found_and_noise_is_not() {
        let (mut trim, offset, wheelbase) = (Trim::default(), 0.02_f64, 0.33);
        let mut noise = 0.0;
        for step in 0..200 {
            let next = 0.004 * f64::from(step * 7919 % 13 - 6) / 6.0;
            trim.learn(0.2 * (offset - trim.angle()).tan() / wheelbase + next - noise, 0.2, wheelbase);
            noise = next;
        }
        assert!((trim.angle() - offset).abs() < 5e-4, "{}", trim.angle());
    }

    #[test]
    fn a_pose_that_jumps_moves_it_no_farther_than_a_servo_could() {
        let mut trim = Trim::default();
        trim.learn(3.0, 0.2, 0.33);
        assert!(trim.angle() < 0.01, "{}", trim.angle());
        (0..1000).for_each(|_| trim.learn(3.0, 0.2, 0.33));
        assert!((trim.angle() - MOST).abs() < 1e-12);
        // Backwards the same wheels turn the car the other way.
        let mut back = Trim::default();
        back.learn(-0.01, -0.2, 0.33);
        assert!(back.angle() > 0.0);
    }
}
