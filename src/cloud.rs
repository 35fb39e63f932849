//! Scans from point clouds: some drivers, and nodes that merge several lasers, publish points rather than ranges.

use std::f64::consts::{PI, TAU};

use thiserror::Error;

use crate::geometry::Point;
use crate::messages::sensor_msgs::{PointCloud2, PointField};
use crate::scan::{BeamGeometry, Scan, ScanError};

crate::knobs! {
    /// Point clouds as scans.
    pub struct CloudKnobs {
        /// Whether to match the clouds of the topic `cloud` instead of the scans of `scan`.
        input: bool = false;
        /// Directions, all round; of the points in one the nearest counts.
        beams: u32 = 1080, in 10 to 10000;
        /// Points nearer than this are left out.
        range_min: f64 = 0.1, in 0 to 1000, unit "m";
        /// Points farther than this are left out.
        range_max: f64 = 50.0, in 0.1 to 1000, unit "m";
    }
}

/// Why a cloud is of no use.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CloudError {
    /// There is no such coordinate, or it is no number.
    #[error("the cloud has no field '{0}' of 32 or 64 bits floating point")]
    NoCoordinate(&'static str),
    /// The data ends before the last point, or points are shorter than their fields.
    #[error("{width} x {height} points of {point_step} bytes do not fit into {bytes} bytes")]
    TooShort {
        /// Points of a row.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes of a point.
        point_step: u32,
        /// Bytes there are.
        bytes: usize,
    },
    /// The points make no scan.
    #[error(transparent)]
    Scan(#[from] ScanError),
}

/// The scan that a laser in the cloud's origin would have taken in the plane. `upside_down`: the cloud's frame is on its head.
pub fn scan(cloud: &PointCloud2, knobs: &CloudKnobs, upside_down: bool) -> Result<Scan, CloudError> {
    let beams = knobs.beams as usize;
    let increment = TAU / f64::from(knobs.beams);
    let first = 0.5 * increment - PI;
    let mut directions = BeamGeometry::new(first, increment, beams).directions().to_vec();
    let mut ranges = vec![f64::INFINITY; beams]; // no measurement
    let side = if upside_down { -1.0 } else { 1.0 };
    for (x, y) in points(cloud)? {
        let point = Point::new(x, side * y);
        let range = point.norm();
        if !(knobs.range_min..=knobs.range_max).contains(&range) || range == 0.0 {
            continue;
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a fraction of a turn
        let beam = (((point.y.atan2(point.x) + PI) / increment) as usize).min(beams - 1);
        if range < ranges[beam] {
            ranges[beam] = range;
            directions[beam] = point / range;
        }
    }
    let geometry = BeamGeometry::about(first, increment, directions);
    Ok(Scan::new(cloud.header.stamp.into(), geometry.into(), (knobs.range_min, knobs.range_max), ranges)?)
}

/// Where a coordinate is within a point, and whether it has 64 bits.
#[derive(Clone, Copy)]
struct Coordinate {
    offset: usize,
    is_wide: bool,
}

impl Coordinate {
    fn find(cloud: &PointCloud2, name: &'static str) -> Result<Self, CloudError> {
        let field = cloud.fields.iter().find(|field| field.name == name).ok_or(CloudError::NoCoordinate(name))?;
        match field.datatype {
            PointField::FLOAT32 => Ok(Self { offset: field.offset as usize, is_wide: false }),
            PointField::FLOAT64 => Ok(Self { offset: field.offset as usize, is_wide: true }),
            _ => Err(CloudError::NoCoordinate(name)),
        }
    }

    fn end(self) -> usize {
        self.offset + if self.is_wide { 8 } else { 4 }
    }

    /// `None`: the point is shorter than that.
    fn read(self, point: &[u8], is_big_endian: bool) -> Option<f64> {
        let bytes = point.get(self.offset..)?;
        if self.is_wide {
            let bytes = *bytes.first_chunk()?;
            Some(if is_big_endian { f64::from_be_bytes(bytes) } else { f64::from_le_bytes(bytes) })
        } else {
            let bytes = *bytes.first_chunk()?;
            Some(f64::from(if is_big_endian { f32::from_be_bytes(bytes) } else { f32::from_le_bytes(bytes) }))
        }
    }
}

/// The points from above. Lengths are checked before anything is read.
fn points(cloud: &PointCloud2) -> Result<impl Iterator<Item = (f64, f64)> + '_, CloudError> {
    let PointCloud2 { width, height, point_step, row_step, .. } = *cloud;
    let (x, y) = (Coordinate::find(cloud, "x")?, Coordinate::find(cloud, "y")?);
    let [columns, rows, step, row] = [width, height, point_step, row_step].map(u64::from);
    let end = rows.saturating_sub(1).saturating_mul(row).saturating_add(columns.saturating_mul(step));
    let step = point_step as usize;
    if end > cloud.data.len() as u64 || x.end().max(y.end()) > step {
        return Err(CloudError::TooShort { width, height, point_step, bytes: cloud.data.len() });
    }
    let rows = (0..height as usize).map(move |number| &cloud.data[number * row_step as usize..][..width as usize * step]);
    let points = rows.flat_map(move |row| row.chunks_exact(step));
    Ok(points.filter_map(move |point| Some((x.read(point, cloud.is_bigendian)?, y.read(point, cloud.is_bigendian)?))))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ring of points in 32 bits, `x` at 4 and `y` at 8 of 16 bytes.
    fn ring(points: u32, radius: f32) -> PointCloud2 {
        let field = |name: &str, offset| PointField { name: name.into(), offset, datatype: PointField::FLOAT32, count: 1 };
        let angle = |i: u32| std::f32::consts::TAU * (i as f32 + 0.3) / points as f32;
        let point =
            |i| [[0; 4], (radius * f32::cos(angle(i))).to_le_bytes(), (radius * f32::sin(angle(i))).to_le_bytes(), [7; 4]];
        PointCloud2 {
            height: 1,
            width: points,
            fields: vec![field("y", 8), field("x", 4)],
            point_step: 16,
            row_step: 16 * points,
            data: (0..points).flat_map(point).flatten().collect(),
            ..PointCloud2::default()
        }
    }

    #[test]
    fn every_point_is_where_it_was() {
        let cloud = ring(400, 2.0);
        let made = scan(&cloud, &CloudKnobs::default(), false).unwrap();
        assert_eq!((made.len(), made.valid_len()), (1080, 400));
        let originals: Vec<_> = points(&cloud).unwrap().map(|(x, y)| Point::new(x, y)).collect();
        for (i, direction, range) in made.rays() {
            let nearest = originals.iter().map(|point| (direction * range - point).norm()).fold(f64::INFINITY, f64::min);
            assert!(nearest < 1e-9, "{i}: {nearest}");
            assert!((direction.y.atan2(direction.x) - made.beams().angle(i)).abs() < 0.6 * TAU / 1080.0);
        }
        let turned = scan(&cloud, &CloudKnobs::default(), true).unwrap();
        assert!(turned.rays().all(|(_, direction, _)| originals.iter().any(|p| (p.y / 2.0 + direction.y).abs() < 1e-6)));
    }

    #[test]
    fn the_nearest_point_of_a_direction_counts_and_ranges_have_limits() {
        let mut cloud = ring(400, 2.0);
        let nearer = ring(400, 1.5);
        cloud.data.extend(nearer.data);
        (cloud.height, cloud.row_step) = (2, 16 * 400);
        let made = scan(&cloud, &CloudKnobs::default(), false).unwrap();
        assert!(made.rays().all(|(_, _, range)| (range - 1.5).abs() < 1e-6));
        let far = CloudKnobs { range_min: 1.7, ..CloudKnobs::default() };
        assert!(scan(&cloud, &far, false).unwrap().rays().all(|(_, _, range)| (range - 2.0).abs() < 1e-6));
    }

    #[test]
    fn clouds_that_are_none_are_named() {
        let error = |spoil: fn(&mut PointCloud2)| {
            let mut cloud = ring(400, 2.0);
            spoil(&mut cloud);
            scan(&cloud, &CloudKnobs::default(), false).unwrap_err().to_string()
        };
        assert!(error(|cloud| cloud.width = 401).contains("401 x 1 points of 16 bytes"));
        assert!(error(|cloud| (cloud.height, cloud.row_step) = (u32::MAX, u32::MAX)).contains("do not fit"));
        assert!(error(|cloud| cloud.point_step = 0).contains("of 0 bytes"));
        assert!(error(|cloud| cloud.fields[0].offset = u32::MAX).contains("do not fit"));
        assert!(error(|cloud| cloud.fields[0].name = "z".into()).contains("no field 'y'"));
        assert!(error(|cloud| cloud.fields[1].datatype = 5).contains("no field 'x'"));
        assert!(error(|cloud| cloud.width = 10).contains("10 of 1080 rays"));
    }
}
