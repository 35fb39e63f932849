//! Converts point clouds to scans: multi-layer lasers, depth cameras, and nodes that merge several lasers publish point clouds.

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, Point3};
use thiserror::Error;

use crate::geometry::Point;
use crate::messages::sensor_msgs::{LaserScan, PointCloud2, PointField};
use crate::scan::{BeamGeometry, Scan, ScanError};

crate::knobs! {
    /// The conversion of point clouds to scans.
    pub struct CloudKnobs {
        /// Use the clouds of the topic `cloud` instead of the scans of `scan`.
        input: bool = false;
        /// Minimum height of the points used, above the origin of the base frame, so that the floor is not a wall. A flat cloud,
        /// with all points at the same height of its own frame, is the sweep of a laser: all its points are used.
        min_height: f64 = 0.1, in -100 to 100, unit "m";
        /// Maximum height of the points used, above the origin of the base frame, so that the ceiling is not a wall.
        max_height: f64 = 2.0, in -100 to 100, unit "m";
        /// Number of beams over 360 degrees; of the points of a beam, the nearest is used.
        beams: u32 = 1080, in 10 to 10000;
        /// Minimum range of the points used.
        range_min: f64 = 0.1, in 0 to 1000, unit "m";
        /// Maximum range of the points used.
        range_max: f64 = 50.0, in 0.1 to 1000, unit "m";
    }
}

/// Why a cloud is unusable.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CloudError {
    /// A coordinate is missing, or not a floating point number.
    #[error("the cloud has no field '{0}' of type FLOAT32 or FLOAT64")]
    NoCoordinate(&'static str),
    /// The data ends before the last point, or a point is shorter than its fields.
    #[error("{width} x {height} points of {point_step} bytes do not fit into {bytes} bytes")]
    TooShort {
        /// Points per row.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes per point.
        point_step: u32,
        /// Bytes of data.
        bytes: usize,
    },
    /// No point is at the configured heights.
    #[error(
        "none of the {points} points is from {low} to {high} m above the base: they are from {lowest:.2} to {highest:.2} m \
         (cloud.min_height, cloud.max_height; is the transform to the cloud's frame right?)"
    )]
    NoneAtHeight {
        /// Number of points.
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
    /// The points do not form a usable scan.
    #[error(transparent)]
    Scan(#[from] ScanError),
}

/// Maximum difference of the heights of a flat cloud, m: the effect of rounding to 32 bits.
const MAX_FLAT_HEIGHT: f64 = 1e-3;

/// Converts a cloud to the scan that a level laser above or below the cloud's origin would measure of the points between the
/// heights of `knobs`. `level_from_cloud` transforms points to the frame of that laser, whose plane is z = 0 of the base: see
/// [`crate::transforms::Mount`].
pub fn scan(cloud: &PointCloud2, knobs: &CloudKnobs, level_from_cloud: &Isometry3<f64>) -> Result<Scan, CloudError> {
    let own: Vec<Point3<f64>> = points(cloud)?.collect();
    let is_flat = extent(own.iter().map(|point| point.z)).is_none_or(|(low, high)| high - low < MAX_FLAT_HEIGHT);
    let mut points: Vec<Point3<f64>> = own.iter().map(|point| level_from_cloud * point).collect();
    if !is_flat {
        let heights = extent(points.iter().map(|point| point.z));
        points.retain(|point| (knobs.min_height..=knobs.max_height).contains(&point.z));
        if let (Some((lowest, highest)), true) = (heights, points.is_empty()) {
            let (low, high) = (knobs.min_height, knobs.max_height);
            return Err(CloudError::NoneAtHeight { points: own.len(), low, high, lowest, highest });
        }
    }
    nearest_per_beam(cloud, knobs, points.iter().map(|point| Point::new(point.x, point.y)))
}

/// The message of a scan over 360 degrees with all beams out of range, with the cloud's header.
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

/// Heights of the lowest and the highest point of a cloud in its own frame, m; `None` if it is empty.
pub fn own_heights(cloud: &PointCloud2) -> Result<Option<(f64, f64)>, CloudError> {
    Ok(extent(points(cloud)?.map(|point| point.z)))
}

/// The minimum and the maximum.
fn extent(numbers: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    numbers.map(|number| (number, number)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

fn nearest_per_beam(cloud: &PointCloud2, knobs: &CloudKnobs, points: impl Iterator<Item = Point>) -> Result<Scan, CloudError> {
    let beams = knobs.beams as usize;
    let increment = TAU / f64::from(knobs.beams);
    let first = 0.5 * increment - PI;
    let mut directions = BeamGeometry::new(first, increment, beams).directions().to_vec();
    // NaN (no measurement) instead of infinity (nothing there), because a cloud has no directions without points.
    let mut ranges = vec![f64::NAN; beams];
    for point in points {
        let range = point.norm();
        if !(knobs.range_min..=knobs.range_max).contains(&range) || range == 0.0 {
            continue;
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // an angle within one turn
        let beam = (((point.y.atan2(point.x) + PI) / increment) as usize).min(beams - 1);
        if ranges[beam].is_nan() || range < ranges[beam] {
            ranges[beam] = range;
            directions[beam] = point / range;
        }
    }
    let geometry = BeamGeometry::with_directions(first, increment, directions);
    Ok(Scan::new(cloud.header.stamp.into(), geometry.into(), (knobs.range_min, knobs.range_max), ranges)?)
}

/// The position of a coordinate within a point, and whether it has 64 bits.
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

    /// Reads the coordinate; `None` if the point is too short.
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

/// The finite points; `z` is 0 without such a field. Lengths are checked before anything is read.
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

    /// A ring of points in 32 bits, `x` at byte 4 and `y` at byte 8 of 16.
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

    /// A room of 6 m by 6 m, from a sensor 0.4 m above its floor: walls 2.5 m high; floor and ceiling points are nearer than the
    /// walls.
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
    fn floor_and_ceiling_are_not_walls() {
        let above_floor = Isometry3::translation(0.0, 0.0, 0.4);
        let scan_of_cloud = scan(&room(), &CloudKnobs::default(), &above_floor).unwrap();
        assert!(
            scan_of_cloud.valid_len() > 1000 && distance_to_walls(&scan_of_cloud) < 1e-6,
            "{}",
            distance_to_walls(&scan_of_cloud)
        );
        let unlimited = CloudKnobs { min_height: -100.0, max_height: 100.0, ..CloudKnobs::default() };
        assert!(
            distance_to_walls(&scan(&room(), &unlimited, &above_floor).unwrap()) > 1.0,
            "without limits, floor and ceiling are walls"
        );
        // Heights are above the base, however the sensor is oriented: a camera's z axis points forward, its y axis down.
        let camera = Isometry3::from_parts(
            above_floor.translation,
            UnitQuaternion::from_euler_angles(-std::f64::consts::FRAC_PI_2, 0.0, -std::f64::consts::FRAC_PI_2),
        );
        let camera_points: Vec<[f32; 3]> = points(&room())
            .unwrap()
            .map(|point| camera.inverse() * (above_floor * point))
            .map(|point| [point.x as f32, point.y as f32, point.z as f32])
            .collect();
        let by_camera = scan(&cloud_of(&camera_points), &CloudKnobs::default(), &camera).unwrap();
        assert!(by_camera.valid_len() > 1000 && distance_to_walls(&by_camera) < 1e-5);
        assert!((camera.rotation * Vector3::z() - Vector3::x()).norm() < 1e-9, "z points forward");
        let (low, high) = own_heights(&room()).unwrap().unwrap();
        assert!((low + 0.42).abs() < 1e-6 && (high - 2.1).abs() < 1e-6, "{low} {high}");
    }

    #[test]
    fn the_error_for_a_cloud_without_points_at_the_heights_gives_their_heights() {
        let floor: Vec<[f32; 3]> = (0..500).map(|i| [1.0, i as f32 * 0.01, 0.0001 * i as f32 - 0.4]).collect();
        let problem = scan(&cloud_of(&floor), &CloudKnobs::default(), &Isometry3::identity()).unwrap_err().to_string();
        assert!(problem.contains("none of the 500 points is from 0.1 to 2 m") && problem.contains("-0.40 to -0.35"), "{problem}");
        assert!(problem.contains("cloud.min_height"), "{problem}");
    }

    #[test]
    fn every_point_keeps_its_position() {
        let cloud = ring(400, 2.0);
        let scan_of_cloud = scan(&cloud, &CloudKnobs::default(), &Isometry3::identity()).unwrap();
        assert_eq!((scan_of_cloud.len(), scan_of_cloud.valid_len()), (1080, 400));
        let originals: Vec<_> = points(&cloud).unwrap().map(|point| Point::new(point.x, point.y)).collect();
        for (i, direction, range) in scan_of_cloud.rays() {
            let nearest = originals.iter().map(|point| (direction * range - point).norm()).fold(f64::INFINITY, f64::min);
            assert!(nearest < 1e-9, "{i}: {nearest}");
            assert!((direction.y.atan2(direction.x) - scan_of_cloud.beams().angle(i)).abs() < 0.6 * TAU / 1080.0);
        }
        let upside_down = Isometry3::rotation(Vector3::x() * PI);
        let flipped = scan(&cloud, &CloudKnobs::default(), &upside_down).unwrap();
        assert!(flipped.rays().all(|(_, direction, _)| originals.iter().any(|p| (p.y / 2.0 + direction.y).abs() < 1e-6)));
    }

    #[test]
    fn the_nearest_point_of_a_beam_is_used_and_ranges_are_limited() {
        let mut cloud = ring(400, 2.0);
        let nearer = ring(400, 1.5);
        cloud.data.extend(nearer.data);
        (cloud.height, cloud.row_step) = (2, 16 * 400);
        let scan_of_cloud = scan(&cloud, &CloudKnobs::default(), &Isometry3::identity()).unwrap();
        assert!(
            (0..scan_of_cloud.len()).all(|i| !scan_of_cloud.is_out_of_range(i)),
            "there is no measurement between the points of a cloud"
        );
        assert!(scan_of_cloud.rays().all(|(_, _, range)| (range - 1.5).abs() < 1e-6));
        let far = CloudKnobs { range_min: 1.7, ..CloudKnobs::default() };
        assert!(scan(&cloud, &far, &Isometry3::identity()).unwrap().rays().all(|(_, _, range)| (range - 2.0).abs() < 1e-6));
    }

    #[test]
    fn errors_for_malformed_clouds_name_the_problem() {
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
