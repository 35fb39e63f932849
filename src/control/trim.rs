//! Steering trim: learns the steering offset, the steering angle of the wheels when straight wheels are commanded.

/// Learning distance over which an error of the trim decays to 37 %, m. A random heading error of 0.2 degrees then changes the
/// trim of a racecar by 0.01 degrees; the offset of a servo is constant for the whole drive.
const LEARNING_DISTANCE: f64 = 5.0;
/// Maximum trim, rad (three degrees): no servo is farther off. Larger estimates come from pose jumps or from manual driving.
const MAX_TRIM: f64 = 0.05;

/// The steering trim of a car, learned while driving.
///
/// A control law without integral term compensates a steering offset only with a lasting lateral error: the Stanley controller
/// with `v tan(offset) / k`, 3 cm at 8 m/s for half a degree. The offset is therefore estimated as a disturbance: if the car has
/// turned farther to the left than commanded, its wheels point farther to the left.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Trim {
    angle: f64,
}

impl Trim {
    /// Steering angle of the wheels when commanded to be straight, rad.
    pub fn angle(&self) -> f64 {
        self.angle
    }

    /// Learns from one step: over `distance` m the heading has changed by `excess` rad more than commanded, with this trim taken
    /// into account.
    ///
    /// For small angles the offset estimated from one step is `excess wheelbase / distance`, with the weight
    /// `distance / LEARNING_DISTANCE`. Sums of `excess` telescope, so the noise of the headings does not accumulate.
    pub fn learn(&mut self, excess: f64, distance: f64, wheelbase: f64) {
        let max_excess = 2.0 * MAX_TRIM * distance.abs() / wheelbase;
        let forward = distance.signum();
        self.angle = (self.angle + forward * excess.clamp(-max_excess, max_excess) * wheelbase / LEARNING_DISTANCE)
            .clamp(-MAX_TRIM, MAX_TRIM);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_steering_offset_is_learned_despite_noise() {
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
    fn pose_jumps_change_the_trim_only_within_its_limits() {
        let mut trim = Trim::default();
        trim.learn(3.0, 0.2, 0.33);
        assert!(trim.angle() < 0.01, "{}", trim.angle());
        (0..1000).for_each(|_| trim.learn(3.0, 0.2, 0.33));
        assert!((trim.angle() - MAX_TRIM).abs() < 1e-12);
        // In reverse the same offset turns the car in the opposite direction.
        let mut back = Trim::default();
        back.learn(-0.01, -0.2, 0.33);
        assert!(back.angle() > 0.0);
    }
}
