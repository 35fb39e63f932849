//! Masks rays that must not be used: directions without interest, and directions in which the laser sees the robot itself.

use std::f64::consts::TAU;

use crate::geometry::Point;
use crate::knobs::{KnobValue, Value, expected, numbers};

crate::knobs! {
    /// The rays of a scan that are used, by the matcher, the particle filter and the mapper.
    pub struct ScanKnobs {
        /// Minimum bearing of the rays used; unset: no limit. Bearings are in the laser's frame, seen from above.
        min_angle: Option<f64> = None, in -7 to 7, unit "rad";
        /// Maximum bearing of the rays used, counter-clockwise; unset: no limit.
        max_angle: Option<f64> = None, in -7 to 7, unit "rad";
        /// Sectors in which the laser sees the robot itself, whose rays are not used: `[[from, to], ...]`, counter-clockwise.
        /// With a third number, `[from, to, range]`, only measurements up to that range are discarded.
        masked_sectors: Sectors = Sectors::default(), unit "rad, rad, m";
    }
}

/// A sector in which measurements are discarded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sector {
    /// First bearing, rad.
    pub from: f64,
    /// Last bearing, counter-clockwise from the first, rad.
    pub to: f64,
    /// Maximum range of the discarded measurements, m; `None`: all are discarded.
    pub range: Option<f64>,
}

/// Sectors as a parameter.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sectors(pub Vec<Sector>);

impl KnobValue for Sectors {
    fn from_value(value: &Value) -> Result<Self, String> {
        let sector = |value: &Value| match numbers(value)?[..] {
            [from, to] => Some(Sector { from, to, range: None }),
            [from, to, range] if range > 0.0 => Some(Sector { from, to, range: Some(range) }),
            _ => None,
        };
        let sectors: Option<Vec<Sector>> = value.as_array().and_then(|sectors| sectors.iter().map(sector).collect());
        sectors.map(Self).ok_or_else(|| expected(Self::kind(), value))
    }

    fn to_value(&self) -> Value {
        let sector = |sector: &Sector| Value::from([sector.from, sector.to].into_iter().chain(sector.range).collect::<Vec<_>>());
        self.0.iter().map(sector).collect()
    }

    fn kind() -> String {
        "[[from, to], ...] or [[from, to, range], ...]".into()
    }
}

/// The mask of the rays that are used.
#[derive(Clone, Debug, Default)]
pub struct Mask {
    sectors: Vec<Sector>,
}

impl Mask {
    /// Creates the mask of these parameters.
    pub fn new(knobs: &ScanKnobs) -> Self {
        let mut sectors = knobs.masked_sectors.0.clone();
        if knobs.min_angle.is_some() || knobs.max_angle.is_some() {
            // The sector outside the limits. With only one limit, it is half a turn wide.
            let from = knobs.max_angle.unwrap_or_else(|| knobs.min_angle.unwrap_or_default() + TAU / 2.0);
            let to = knobs.min_angle.unwrap_or_else(|| from + TAU / 2.0);
            sectors.push(Sector { from: from + f64::EPSILON, to: to - f64::EPSILON, range: None });
        }
        Self { sectors }
    }

    /// Whether all rays are used.
    pub fn is_empty(&self) -> bool {
        self.sectors.is_empty()
    }

    /// The maximum range of the discarded measurements in a direction, m; negative if all measurements are used.
    pub fn limit(&self, direction: &Point) -> f64 {
        let bearing = direction.y.atan2(direction.x);
        let within = |sector: &&Sector| (bearing - sector.from).rem_euclid(TAU) <= (sector.to - sector.from).rem_euclid(TAU);
        let limits = self.sectors.iter().filter(within).map(|sector| sector.range.unwrap_or(f64::INFINITY));
        limits.fold(f64::NEG_INFINITY, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limit(mask: &Mask, bearing: f64) -> f64 {
        mask.limit(&Point::new(bearing.cos(), bearing.sin()))
    }

    #[test]
    fn sectors_may_wrap_around_and_end_at_their_range() {
        let sectors = Sectors::from_value(&serde_json::json!([[3.0, -3.0], [0.1, 0.2, 0.5]])).unwrap();
        assert_eq!(Sectors::from_value(&sectors.to_value()).unwrap(), sectors);
        let mask = Mask::new(&ScanKnobs { masked_sectors: sectors, ..ScanKnobs::default() });
        let limits = [3.1, -3.1, 0.15].map(|bearing| limit(&mask, bearing));
        assert!(limits[..2].iter().all(|limit| *limit == f64::INFINITY) && (limits[2] - 0.5).abs() < 1e-12, "{limits:?}");
        assert!([0.0, 0.3, 2.9, -2.9].iter().all(|&bearing| limit(&mask, bearing) < 0.0) && !mask.is_empty());
        for wrong in [
            serde_json::json!([[1.0]]),
            serde_json::json!([1.0, 2.0]),
            serde_json::json!([[1.0, 2.0, -1.0]]),
            serde_json::json!("x"),
        ] {
            assert!(Sectors::from_value(&wrong).unwrap_err().contains("[from, to]"), "{wrong}");
        }
    }

    #[test]
    fn angle_limits_apply_on_either_side() {
        let front = Mask::new(&ScanKnobs { min_angle: Some(-1.0), max_angle: Some(1.5), ..ScanKnobs::default() });
        assert!([-0.99, 0.0, 1.49].iter().all(|&bearing| limit(&front, bearing) < 0.0));
        assert!([-1.01, 1.51, 3.0].iter().all(|&bearing| limit(&front, bearing) > 0.0));
        let left = Mask::new(&ScanKnobs { min_angle: Some(-0.5), ..ScanKnobs::default() });
        assert!(limit(&left, -0.6) > 0.0 && limit(&left, 2.0) < 0.0 && Mask::default().is_empty());
    }
}
