//! Scans from point clouds: lasers with several layers, depth cameras, and nodes that merge several lasers publish points.

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, Point3};
use thiserror::Error;

use crate::geometry::Point;
use crate::messages::sensor_msgs::{LaserScan, PointCloud2, PointField};
use crate::scan::{BeamGeometry, Scan, ScanError};

crate::knobs! {
    /// Point clouds as scans.
    pub struct CloudKnobs {
        /// Whether to take the clouds of the topic `cloud` instead of the scans of `scan`.
        input: bool = false;
        /// Points lower than this above the base frame's origin are left out: the floor is no wall. A flat cloud, with all points at one
        /// height of its own frame, is the sweep of a laser: it is taken whole.
        min_height: f64 = 0.1, in -100 to 100, unit "m";
        /// Points higher than this above the base frame's origin are left out: the ceiling is no wall.
        max_height: f64 = 2.0, in -100 to 100, unit "m";
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
    /// Floor and ceiling only.
    #[error(
        "none of the {points} points is from {low} to {high} m above the base: they are from {lowest:.2} to {highest:.2} m \
         (cloud.min_height, cloud.max_height; is the transform to the cloud's frame right?)"
    )]
    NoneAtHeight {
        /// Points there are.
        points: usize,
        /// `cloud.min_height`.
        low: f64,
        /// `cloud.max_height`.
        high: f64,
        /// Height of the lowest point.
        lowest: f64,
        /// Height of the highest point.
        highest: f64,
    },
    /// The points make no scan.
    #[error(transparent)]
    Scan(#[from] ScanError),
}

/// Points at heights that differ by less than this are of one plane: what is left of it after rounding to 32 bits, m.
const FLAT: f64 = 1e-3;

/// The scan that a level laser above or below the cloud's origin would have taken of the points between the heights of `knobs`.
/// `level_from_cloud` turns points into the frame of that laser, whose plane is z = 0 of the base: see [`crate::transforms::Mount`].
pub fn scan(cloud: &PointCloud2, knobs: &CloudKnobs, level_from_cloud: &Isometry3<f64>) -> Result<Scan, CloudError> {
    let own: Vec<Point3<f64>> = points(cloud)?.collect();
    let is_flat = extent(own.iter().map(|point| point.z)).is_none_or(|(low, high)| high - low < FLAT);
    let mut points: Vec<Point3<f64>> = own.iter().map(|point| level_from_cloud * point).collect();
    if !is_flat {
        let heights = extent(points.iter().map(|point| point.z));
        points.retain(|point| (knobs.min_height..=knobs.max_height).contains(&point.z));
        if let (Some((lowest, highest)), true) = (heights, points.is_empty()) {
            let (low, high) = (knobs.min_height, knobs.max_height);
            return Err(CloudError::NoneAtHeight { points: own.len(), low, high, lowest, highest });
        }
    }
    nearest_of_each_direction(cloud, knobs, points.iter().map(|point| Point::new(point.x, point.y)))
}

/// The message of a scan in all directions of `knobs` that has seen nothing, with the cloud's header.
#[allow(clippy::cast_possible_truncation)] // messages carry 32 bits
pub fn empty_scan(cloud: &PointCloud2, knobs: &CloudKnobs) -> LaserScan {
    let increment = TAU / f64::from(knobs.beams);
    LaserScan {
        header: cloud.header.clone(),
        angle_min: (0.5 * increment - PI) as f32,
        angle_max: (PI - 0.5 * increment) as f32,
        angle_increment: increment as f32,
        range_min: knobs.range_min as f32,
        range_max: knobs.range_max as f32,
        ranges: vec![f32::INFINITY; knobs.beams as usize],
        ..LaserScan::default()
    }
}

/// Heights of the lowest and the highest point of a cloud in its own frame, m; `None` if it holds none.
pub fn own_heights(cloud: &PointCloud2) -> Result<Option<(f64, f64)>, CloudError> {
    Ok(extent(points(cloud)?.map(|point| point.z)))
}

/// The least and the greatest number.
fn extent(numbers: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    numbers.map(|number| (number, number)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

fn nearest_of_each_direction(
    cloud: &PointCloud2,
    knobs: &CloudKnobs,
    points: impl Iterator<Item = Point>,
) -> Result<Scan, CloudError> {
    let beams = knobs.beams as usize;
    let increment = TAU / f64::from(knobs.beams);
    let first = 0.5 * increment - PI;
    let mut directions = BeamGeometry::new(first, increment, beams).directions().to_vec();
    // No measurement, where an infinite range would say that nothing is there: a cloud has as many directions as it has points.
    let mut ranges = vec![f64::NAN; beams];
    for point in points {
        let range = point.norm();
        if !(knobs.range_min..=knobs.range_max).contains(&range) || range == 0.0 {
            continue;
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a fraction of a turn
        let beam = (((point.y.atan2(point.x) + PI) / increment) as usize).min(beams - 1);
        if ranges[beam].is_nan() || range < ranges[beam] {
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

/// The points that are finite; without a field `z`, those of a plane. Lengths are checked before anything is read.
fn points(cloud: &PointCloud2) -> Result<impl Iterator<Item = Point3<f64>> + '_, CloudError> {
    let PointCloud2 { width, height, point_step, row_step, is_bigendian, .. } = *cloud;
    let (x, y) = (Coordinate::find(cloud, "x")?, Coordinate::find(cloud, "y")?);
    let z = Coordinate::find(cloud, "z").ok();
    let [columns, rows, step, row] = [width, height, point_step, row_step].map(u64::from);
    let end = rows.saturating_sub(1).saturating_mul(row).saturating_add(columns.saturating_mul(step));
    let step = point_step as usize;
    if end > cloud.data.len() as u64 || x.end().max(y.end()).max(z.map_or(0, Coordinate::end)) > step {
        return Err(CloudError::TooShort { width, height, point_step, bytes: cloud.data.len() });
    }
    let rows = (0..height as usize).map(move |number| &cloud.data[number * row_step as usize..][..width as usize * step]);
    let points = rows.flat_map(move |row| row.chunks_exact(step)).filter_map(move |point| {
        let read = |coordinate: Coordinate| coordinate.read(point, is_bigendian);
        Some(Point3::new(read(x)?, read(y)?, z.map_or(Some(0.0), read)?))
    });
    Ok(points.filter(|point| point.iter().all(|coordinate| coordinate.is_finite())))
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

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

    /// Points in 32 bits, `z` first.
    fn cloud_of(points: &[[f32; 3]]) -> PointCloud2 {
        let field = |name: &str, offset| PointField { name: name.into(), offset, datatype: PointField::FLOAT32, count: 1 };
        PointCloud2 {
            height: 1,
            width: points.len() as u32,
            fields: vec![field("z", 0), field("x", 4), field("y", 8)],
            point_step: 12,
            row_step: 12 * points.len() as u32,
            data: points.iter().flat_map(|[x, y, z]| [z, x, y].map(|v| v.to_le_bytes())).flatten().collect(),
            ..PointCloud2::default()
        }
    }

    /// A room of 6 m by 6 m, seen from 0.4 m above its floor: walls 2.5 m high, floor and ceiling nearer than these.
    fn room() -> PointCloud2 {
        let mut points = Vec::new();
        for i in 0..2000 {
            let angle = std::f32::consts::TAU * i as f32 / 2000.0;
            let (sin, cos) = angle.sin_cos();
            let wall = 3.0 / sin.abs().max(cos.abs());
            points.extend([0.3, 0.9, 2.0].map(|height: f32| [wall * cos, wall * sin, height - 0.4]));
            points
                .extend([(1.0, 0.02), (2.0, -0.02), (2.5, 2.5)].map(|(r, height): (f32, f32)| [r * cos, r * sin, height - 0.4]));
        }
        cloud_of(&points)
    }

    fn distance_to_walls(scan: &Scan) -> f64 {
        scan.rays().map(|(_, d, range)| (d * range).abs().max() - 3.0).fold(0.0, |worst, off| off.abs().max(worst))
    }

    #[test]
    fn floor_and_ceiling_are_no_walls() {
        let above_floor = Isometry3::translation(0.0, 0.0, 0.4);
        let made = scan(&room(), &CloudKnobs::default(), &above_floor).unwrap();
        assert!(made.valid_len() > 1000 && distance_to_walls(&made) < 1e-6, "{}", distance_to_walls(&made));
        let whole = CloudKnobs { min_height: -100.0, max_height: 100.0, ..CloudKnobs::default() };
        assert!(distance_to_walls(&scan(&room(), &whole, &above_floor).unwrap()) > 1.0, "the limits make the difference");
        // Heights are those above the base, whichever way the sensor looks: a camera's z axis looks ahead, its y axis down.
        let camera = Isometry3::from_parts(
            above_floor.translation,
            UnitQuaternion::from_euler_angles(-std::f64::consts::FRAC_PI_2, 0.0, -std::f64::consts::FRAC_PI_2),
        );
        let seen: Vec<[f32; 3]> = points(&room())
            .unwrap()
            .map(|point| camera.inverse() * (above_floor * point))
            .map(|point| [point.x as f32, point.y as f32, point.z as f32])
            .collect();
        let by_camera = scan(&cloud_of(&seen), &CloudKnobs::default(), &camera).unwrap();
        assert!(by_camera.valid_len() > 1000 && distance_to_walls(&by_camera) < 1e-5);
        assert!((camera.rotation * Vector3::z() - Vector3::x()).norm() < 1e-9, "z looks ahead");
        let (low, high) = own_heights(&room()).unwrap().unwrap();
        assert!((low + 0.42).abs() < 1e-6 && (high - 2.1).abs() < 1e-6, "{low} {high}");
    }

    #[test]
    fn a_cloud_without_points_at_the_heights_says_where_they_are() {
        let floor: Vec<[f32; 3]> = (0..500).map(|i| [1.0, i as f32 * 0.01, 0.0001 * i as f32 - 0.4]).collect();
        let problem = scan(&cloud_of(&floor), &CloudKnobs::default(), &Isometry3::identity()).unwrap_err().to_string();
        assert!(problem.contains("none of the 500 points is from 0.1 to 2 m") && problem.contains("-0.40 to -0.35"), "{problem}");
        assert!(problem.contains("cloud.min_height"), "{problem}");
    }

    #[test]
    fn every_point_is_where_it_was() {
        let cloud = ring(400, 2.0);
        let made = scan(&cloud, &CloudKnobs::default(), &Isometry3::identity()).unwrap();
        assert_eq!((made.len(), made.valid_len()), (1080, 400));
        let originals: Vec<_> = points(&cloud).unwrap().map(|point| Point::new(point.x, point.y)).collect();
        for (i, direction, range) in made.rays() {
            let nearest = originals.iter().map(|point| (direction * range - point).norm()).fold(f64::INFINITY, f64::min);
            assert!(nearest < 1e-9, "{i}: {nearest}");
            assert!((direction.y.atan2(direction.x) - made.beams().angle(i)).abs() < 0.6 * TAU / 1080.0);
        }
        let on_its_head = Isometry3::rotation(Vector3::x() * PI);
        let turned = scan(&cloud, &CloudKnobs::default(), &on_its_head).unwrap();
        assert!(turned.rays().all(|(_, direction, _)| originals.iter().any(|p| (p.y / 2.0 + direction.y).abs() < 1e-6)));
    }

    #[test]
    fn the_nearest_point_of_a_direction_counts_and_ranges_have_limits() {
        let mut cloud = ring(400, 2.0);
        let nearer = ring(400, 1.5);
        cloud.data.extend(nearer.data);
        (cloud.height, cloud.row_step) = (2, 16 * 400);
        let made = scan(&cloud, &CloudKnobs::default(), &Isometry3::identity()).unwrap();
        assert!((0..made.len()).all(|i| !made.saw_nothing(i)), "between its points a cloud says nothing");
        assert!(made.rays().all(|(_, _, range)| (range - 1.5).abs() < 1e-6));
        let far = CloudKnobs { range_min: 1.7, ..CloudKnobs::default() };
        assert!(scan(&cloud, &far, &Isometry3::identity()).unwrap().rays().all(|(_, _, range)| (range - 2.0).abs() < 1e-6));
    }

    #[test]
    fn clouds_that_are_none_are_named() {
        let error = |spoil: fn(&mut PointCloud2)| {
            let mut cloud = ring(400, 2.0);
            spoil(&mut cloud);
            scan(&cloud, &CloudKnobs::default(), &Isometry3::identity()).unwrap_err().to_string()
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
