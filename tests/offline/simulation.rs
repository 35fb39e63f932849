//! Compares the simulator with closed forms, with reference implementations and with itself.

use std::convert::Infallible;
use std::f64::consts::PI;
use std::fs;
use std::path::{Path, PathBuf};

use anytime_scan_matcher::app::planar_pose;
use anytime_scan_matcher::geometry::{Point, Pose2, Twist2, wrap_angle};
use anytime_scan_matcher::io::bag::{Bag, BagWriter, Compression};
use anytime_scan_matcher::io::gray_image::GrayImage;
use anytime_scan_matcher::io::tum::{self, TumWriter};
use anytime_scan_matcher::io::{map_file, simulated_bag};
use anytime_scan_matcher::knobs::Seconds;
use anytime_scan_matcher::map::grid::{Cell, OccupancyGrid};
use anytime_scan_matcher::messages::encode;
use anytime_scan_matcher::messages::geometry_msgs::Pose;
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;
use anytime_scan_matcher::scan::{BeamGeometry, ScanConverter};
use anytime_scan_matcher::simulation::built_in::BuiltIn;
use anytime_scan_matcher::simulation::drive::{START, Settings, SimulatedMessage, simulate, truth_message};
use anytime_scan_matcher::simulation::grid_world::GridWorld;
use anytime_scan_matcher::simulation::information::{pair_covariance_bound, scan_information};
use anytime_scan_matcher::simulation::lidar::{Lidar, LidarKnobs};
use anytime_scan_matcher::simulation::motion::Motion;
use anytime_scan_matcher::simulation::odometer::{Odometer, OdometerKnobs};
use anytime_scan_matcher::simulation::pairs::Pairs;
use anytime_scan_matcher::simulation::random_world::RandomWorld;
use anytime_scan_matcher::simulation::route::Route;
use anytime_scan_matcher::simulation::scene::Scene;
use anytime_scan_matcher::simulation::shapes::Shapes;
use anytime_scan_matcher::simulation::traffic::{Traffic, TrafficKnobs};
use anytime_scan_matcher::simulation::vehicle::{Drive, VehicleKnobs};
use anytime_scan_matcher::simulation::world::World;
use anytime_scan_matcher::time::Stamp;
use nalgebra::{Matrix3, Vector3};
use proptest::prelude::*;
use rand::SeedableRng;
use rand_pcg::Pcg64;

fn direction(angle: f64) -> Point {
    Point::new(angle.cos(), angle.sin())
}

// ---- worlds ----

proptest! {
    #[test]
    fn inside_a_box_ranges_are_those_of_its_nearest_side(
        x in -1.9..1.9, y in -0.9..0.9, angle in -PI..PI, turn in -PI..PI, shift in -50.0..50.0,
    ) {
        let placed = Pose2::new(shift, -shift, turn);
        let world = Shapes::default().block(&placed.transform(), 4.0, 2.0);
        let d = direction(angle);
        let side = |position: f64, step: f64, half: f64| (half.copysign(step) - position) / step;
        let expected = side(x, d.x, 2.0).min(side(y, d.y, 1.0));
        let seen = world.range(placed.transform().apply(Point::new(x, y)), placed.transform().rotate(d), 100.0).unwrap();
        prop_assert!((seen - expected).abs() < 1e-9, "{seen} is not {expected}");
        let clearance = world.clearance(placed.transform().apply(Point::new(x, y)));
        prop_assert!((clearance - (2.0 - x.abs()).min(1.0 - y.abs())).abs() < 1e-9);
    }

    #[test]
    fn a_circle_is_hit_at_its_radius(distance in 0.0..10.0, angle in -PI..PI, radius in 0.1..5.0) {
        let centre = Point::new(3.0, -2.0);
        let world = Shapes::default().pillar(centre, radius);
        let origin = centre - Point::new(distance, 0.0);
        let hit = world.range(origin, direction(angle), 100.0);
        let misses = distance > radius && (angle.abs() > PI / 2.0 || distance * angle.sin().abs() > radius);
        prop_assert_eq!(hit.is_none(), misses);
        if let Some(range) = hit {
            prop_assert!(((origin + direction(angle) * range - centre).norm() - radius).abs() < 1e-9);
            // No point of the circle on that ray is nearer.
            let half_way = (origin + direction(angle) * (0.5 * range) - centre).norm();
            prop_assert_eq!(half_way < radius, distance < radius);
        }
        prop_assert_eq!(world.range(origin, direction(angle), hit.unwrap_or(1.0) * 0.999), None);
    }

    #[test]
    fn no_ray_slips_through_a_corner(corner in 0_usize..4, x in -1.9..1.9, y in -0.9..0.9) {
        let world = Shapes::default().block(&Pose2::IDENTITY.transform(), 4.0, 2.0);
        let to = [Point::new(2.0, 1.0), Point::new(-2.0, 1.0), Point::new(-2.0, -1.0), Point::new(2.0, -1.0)][corner] - Point::new(x, y);
        let range = world.range(Point::new(x, y), to.normalize(), 100.0).unwrap();
        prop_assert!((range - to.norm()).abs() < 1e-6);
    }

    #[test]
    fn grid_ranges_are_those_of_the_nearest_occupied_square(
        cells in random_cells(), yaw in -PI..PI, x in 0.0..12.0, y in 0.0..12.0, angle in -PI..PI, max in 0.0..20.0,
    ) {
        let origin = Pose2::new(-7.3, 4.1, yaw);
        let grid = OccupancyGrid::new(WIDTH, RESOLUTION, origin, cells.clone()).unwrap();
        let start = Point::new(x, y) * RESOLUTION;
        let d = direction(angle);
        let seen = grid.range(origin.transform().apply(start), origin.transform().rotate(d), max * RESOLUTION);
        let nearest = occupied(&cells)
            .filter_map(|corner| enters_square(start, d, corner))
            .filter(|&range| range <= max * RESOLUTION)
            .min_by(f64::total_cmp);
        match (seen, nearest) {
            (Some(seen), Some(nearest)) => prop_assert!((seen - nearest).abs() < 1e-9, "{seen} is not {nearest}"),
            (seen, nearest) => prop_assert_eq!(seen, nearest),
        }
    }

    #[test]
    fn grid_clearance_is_safe_and_not_too_small(cells in random_cells(), x in 0.0..12.0, y in 0.0..12.0) {
        let grid = OccupancyGrid::new(WIDTH, RESOLUTION, Pose2::IDENTITY, cells.clone()).unwrap();
        let point = Point::new(x, y) * RESOLUTION;
        let clearance = GridWorld::new(grid).clearance(point);
        let border = [x, y, 12.0 - x, 12.0 - y].map(|cells| cells * RESOLUTION).into_iter().fold(f64::INFINITY, f64::min);
        let truth = occupied(&cells).map(|corner| distance_to_square(point, corner)).fold(border, f64::min);
        prop_assert!(clearance <= truth + 1e-9, "{clearance} is more than {truth}");
        prop_assert!(clearance >= truth - 2.0 * 2.0_f64.sqrt() * RESOLUTION, "{clearance} is far less than {truth}");
    }

    #[test]
    fn no_odd_ray_hangs(x in odd_numbers(), y in odd_numbers(), dx in odd_numbers(), dy in odd_numbers(), max in odd_numbers()) {
        let grid = OccupancyGrid::new(2, 0.1, Pose2::IDENTITY, vec![Cell::Free; 4]).unwrap();
        prop_assert_eq!(grid.range(Point::new(x, y), Point::new(dx, dy), max), None);
    }
}

const WIDTH: usize = 12;
const RESOLUTION: f64 = 0.25;

fn random_cells() -> impl Strategy<Value = Vec<Cell>> {
    prop::collection::vec(prop::bool::weighted(0.08), WIDTH * WIDTH)
        .prop_map(|bits| bits.into_iter().map(|occupied| if occupied { Cell::Occupied } else { Cell::Free }).collect())
}

fn odd_numbers() -> impl Strategy<Value = f64> {
    prop::sample::select(vec![0.0, -0.0, 1.0, -1.0, 0.1, 1e-300, 1e300, f64::INFINITY, f64::NEG_INFINITY, f64::NAN])
}

/// Lower left corners of the occupied squares.
fn occupied(cells: &[Cell]) -> impl Iterator<Item = Point> + '_ {
    let corner = |i: usize| Point::new((i % WIDTH) as f64, (i / WIDTH) as f64) * RESOLUTION;
    cells.iter().enumerate().filter(|(_, cell)| **cell == Cell::Occupied).map(move |(i, _)| corner(i))
}

/// The distance at which a ray enters a square, from the interval in which it is between both pairs of sides.
fn enters_square(start: Point, direction: Point, corner: Point) -> Option<f64> {
    let between = |position: f64, step: f64, low: f64| {
        let (a, b) = ((low - position) / step, (low + RESOLUTION - position) / step);
        (a.min(b), a.max(b))
    };
    let (x, y) = (between(start.x, direction.x, corner.x), between(start.y, direction.y, corner.y));
    let (enter, leave) = (x.0.max(y.0).max(0.0), x.1.min(y.1));
    (enter <= leave).then_some(enter)
}

fn distance_to_square(point: Point, corner: Point) -> f64 {
    let outside = |position: f64, low: f64| (low - position).max(position - low - RESOLUTION).max(0.0);
    outside(point.x, corner.x).hypot(outside(point.y, corner.y))
}

#[test]
fn rays_pass_unknown_cells_but_cars_do_not() {
    let cells = vec![Cell::Free, Cell::Unknown, Cell::Occupied];
    let grid = OccupancyGrid::new(3, 1.0, Pose2::IDENTITY, cells).unwrap();
    assert_eq!(grid.range(Point::new(0.5, 0.5), Point::new(1.0, 0.0), 10.0), Some(1.5));
    assert_eq!(GridWorld::new(grid).clearance(Point::new(1.5, 0.5)).to_bits(), 0.0_f64.to_bits());
}

// ---- lidar ----

/// A motion that rests for the first second and reaches 3 m/s some seconds later.
fn motion(scene: &Scene) -> Motion {
    Motion::drive(&scene.route, &VehicleKnobs::default(), 10.0)
}

fn corridor() -> Scene {
    Scene::built_in(BuiltIn::Corridor).unwrap()
}

fn scan_with(knobs: &LidarKnobs, seconds: f64) -> LaserScan {
    let scene = corridor();
    let motion = motion(&scene);
    Lidar::new(knobs, Pcg64::seed_from_u64(5)).scan(|_| scene.world.as_ref(), |after| motion.pose_at(seconds + after), START)
}

#[test]
fn scans_of_any_shape_pass_the_checks_of_the_matcher() {
    for (beams, field_of_view) in [(10, 10.0), (181, 180.0), (1081, 270.0), (1080, 360.0), (10_000, 360.0)] {
        let scan = scan_with(&LidarKnobs { beams, field_of_view, ..LidarKnobs::default() }, 0.0);
        let scan = ScanConverter::default().convert(&scan, false).unwrap();
        assert_eq!(scan.len(), beams as usize);
        assert_eq!(scan.beams().is_full_circle(), field_of_view >= 360.0);
    }
}

#[test]
fn rays_without_a_wall_in_range_have_no_return() {
    let all = scan_with(&LidarKnobs { noise: 0.0, range_resolution: 0.0, ..LidarKnobs::default() }, 0.0);
    let knobs = LidarKnobs { noise: 0.0, range_resolution: 0.0, range_min: 2.0, range_max: 4.0, ..LidarKnobs::default() };
    let limited = scan_with(&knobs, 0.0);
    let mut seen = [0; 3];
    for (&range, &limited) in all.ranges.iter().zip(&limited.ranges) {
        let (case, expected) = match range {
            r if r < 2.0 => (0, f32::NEG_INFINITY),
            r if r > 4.0 => (1, f32::INFINITY),
            r => (2, r),
        };
        seen[case] += 1;
        assert_eq!(limited.to_bits(), expected.to_bits());
    }
    assert!(seen.iter().all(|&count| count > 50), "{seen:?}");
}

#[test]
fn noise_and_rounding_are_as_configured() {
    let exact = scan_with(&LidarKnobs { noise: 0.0, range_resolution: 0.0, ..LidarKnobs::default() }, 0.0);
    let noisy = scan_with(&LidarKnobs { noise: 0.02, ..LidarKnobs::default() }, 0.0);
    let errors: Vec<f64> = noisy.ranges.iter().zip(&exact.ranges).map(|(a, b)| f64::from(a - b)).collect();
    let n = errors.len() as f64;
    let mean = errors.iter().sum::<f64>() / n;
    let deviation = (errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt();
    assert!(mean.abs() < 0.003 && (deviation - 0.02).abs() < 0.002, "mean {mean}, deviation {deviation}");
    for range in noisy.ranges {
        let millimetres = f64::from(range) * 1e3;
        assert!((millimetres - millimetres.round()).abs() < 2e-3, "{range}");
    }
}

#[test]
fn a_slow_sweep_distorts_the_scan_of_a_moving_car_only() {
    let instant = LidarKnobs { noise: 0.0, ..LidarKnobs::default() };
    let sweeping = LidarKnobs { scan_duration: Seconds(0.0216), ..instant.clone() };
    assert_eq!(scan_with(&instant, 0.5).ranges, scan_with(&sweeping, 0.5).ranges);
    let (still, swept) = (scan_with(&instant, 4.0), scan_with(&sweeping, 4.0));
    let scene = corridor();
    let drive = motion(&scene);
    assert!((drive.pose_at(4.0).translation() - drive.pose_at(4.0216).translation()).norm() > 0.05);
    // Each ray equals that of an instantaneous scan at its time.
    for ray in [0, 540, 1080] {
        let taken = scan_with(&instant, 4.0 + ray as f64 * f64::from(swept.time_increment));
        assert_eq!(swept.ranges[ray].to_bits(), taken.ranges[ray].to_bits());
    }
    assert_eq!(still.ranges[0].to_bits(), swept.ranges[0].to_bits());
    assert!((still.ranges[1080] - swept.ranges[1080]).abs() > 0.005 || (still.ranges[540] - swept.ranges[540]).abs() > 0.01);
}

// ---- odometry ----

const PERFECT: OdometerKnobs =
    OdometerKnobs { rate: 50.0, distance_scale: 0.0, yaw_scale: 0.0, yaw_drift: 0.0, distance_noise: 0.0, yaw_noise: 0.0 };

fn plane(pose: &Pose) -> Pose2 {
    Pose2::new(pose.position.x, pose.position.y, 2.0 * pose.orientation.z.atan2(pose.orientation.w))
}

/// The odometry of a drive, and the true poses relative to the start.
fn readings(knobs: &OdometerKnobs, motion: &Motion, seed: u64) -> Vec<(Odometry, Pose2)> {
    let start = motion.pose_at(0.0);
    let mut odometer = Odometer::new(knobs, start, Pcg64::seed_from_u64(seed));
    let at = |k: i32| motion.pose_at(f64::from(k) / knobs.rate);
    (0..500).map(|k| (odometer.read(at(k), Stamp::default()), start.between(&at(k)))).collect()
}

#[test]
fn without_errors_odometry_is_the_truth_and_its_twist_makes_its_pose() {
    let readings = readings(&PERFECT, &motion(&corridor()), 1);
    let mut integrated = Pose2::IDENTITY;
    for (reading, truth) in &readings {
        let pose = plane(&reading.pose.pose);
        let error = truth.between(&pose);
        assert!(error.distance() < 1e-9 && error.theta.abs() < 1e-9, "{error:?}");
        let twist = &reading.twist.twist;
        integrated =
            integrated * Twist2 { vx: twist.linear.x, vy: twist.linear.y, omega: twist.angular.z }.motion(1.0 / PERFECT.rate);
        assert!(integrated.between(&pose).distance() < 1e-9);
    }
    assert!(readings[499].1.distance() > 10.0);
}

#[test]
fn odometry_at_rest_is_exact_and_its_covariance_is_never_zero() {
    for (reading, _) in &readings(&OdometerKnobs::default(), &motion(&corridor()), 1)[..45] {
        assert_eq!(reading.twist.twist.linear.x.to_bits(), 0.0_f64.to_bits());
        assert!((0..6).all(|i| reading.pose.covariance[i][i] > 0.0 && reading.twist.covariance[i][i] > 0.0));
    }
}

#[test]
fn odometry_errors_match_its_covariance() {
    let motion = motion(&corridor());
    let drives: Vec<f64> = (0..400)
        .map(|seed| {
            let (reading, truth) = readings(&OdometerKnobs::default(), &motion, seed).pop().unwrap();
            let pose = plane(&reading.pose.pose);
            let error = Vector3::new(pose.x - truth.x, pose.y - truth.y, wrap_angle(pose.theta - truth.theta));
            let covariance = Matrix3::from_fn(|row, column| reading.pose.covariance[[0, 1, 5][row]][[0, 1, 5][column]]);
            error.dot(&(covariance.try_inverse().unwrap() * error))
        })
        .collect();
    // Chi-squared with 3 degrees of freedom: mean 3, its standard error here 0.12; 95 % below 7.81.
    let mean = drives.iter().sum::<f64>() / drives.len() as f64;
    let within = drives.iter().filter(|&&d| d < 7.81).count() as f64 / drives.len() as f64;
    assert!((2.5..3.6).contains(&mean) && (0.92..0.98).contains(&within), "mean {mean}, within {within}");
}

// ---- drives ----

/// Poses at every control step; checked to be smooth and within the limits of the car.
fn checked_drive(route: &Route, knobs: &VehicleKnobs, seconds: f64) -> Vec<Pose2> {
    const STEP: f64 = 0.005;
    let motion = Motion::drive(route, knobs, seconds);
    let steps = 0..;
    let times = steps.map(|k| f64::from(k) * STEP).take_while(|time| *time <= seconds);
    let poses: Vec<Pose2> = times.map(|time| motion.pose_at(time)).collect();
    let twists: Vec<Twist2> = poses.windows(2).map(|pair| Twist2::from_motion(&pair[0].between(&pair[1]), STEP)).collect();
    let tightest = knobs.max_steering.tan() / knobs.wheelbase;
    for (i, twist) in twists.iter().enumerate() {
        let resting = (i as f64 + 1.0) * STEP <= 1.0 + 1e-9;
        assert_eq!(resting, twist.vx.abs() < 1e-9, "step {i}: {twist:?}");
        assert!(twist.vx >= 0.0 && twist.vx <= knobs.speed + 1e-6 && twist.vy.abs() < 1e-6, "step {i}: {twist:?}");
        if knobs.drive == Drive::Ackermann {
            assert!(twist.omega.abs() <= tightest * twist.vx + 1e-4, "step {i}: {twist:?}");
        }
    }
    for pair in twists.windows(2) {
        assert!((pair[1].vx - pair[0].vx).abs() <= knobs.acceleration * STEP + 1e-6);
        assert!((pair[1].omega - pair[0].omega).abs() < 0.4, "{pair:?}");
    }
    poses
}

fn path_length(poses: &[Pose2]) -> f64 {
    poses.windows(2).map(|pair| pair[0].between(&pair[1]).distance()).sum()
}

/// Minimum distance of the car from the walls: at its rear axle, its nose and the middle between.
fn min_clearance(world: &dyn World, poses: &[Pose2]) -> f64 {
    let places = |pose: &Pose2| [0.0, 0.15, 0.35].map(|ahead| pose.transform().apply(Point::new(ahead, 0.0)));
    poses.iter().flat_map(places).map(|place| world.clearance(place)).fold(f64::INFINITY, f64::min)
}

#[test]
fn the_car_keeps_its_distance_from_the_walls_of_the_built_in_worlds() {
    for &which in BuiltIn::ALL {
        let scene = Scene::built_in(which).unwrap();
        for &drive in Drive::ALL {
            for speed in [0.5, 3.0, 6.0] {
                let knobs = VehicleKnobs { drive, speed, ..VehicleKnobs::default() };
                let poses = checked_drive(&scene.route, &knobs, 60.0);
                let clearance = min_clearance(scene.world.as_ref(), &poses);
                let length = path_length(&poses);
                eprintln!(
                    "{which:?} {drive:?} {speed} m/s: {length:.1} m, clearance {clearance:.2} m, lap {:.1} m",
                    scene.route.length()
                );
                assert!(clearance > 0.25, "{which:?} {drive:?} {speed} m/s: {clearance} m from a wall");
                assert!(length > 55.0 * speed.min(1.5));
            }
        }
    }
}

fn maps() -> Option<PathBuf> {
    crate::common::shared("data/maps")
}

#[test]
fn the_car_drives_200_m_through_real_maps() {
    let Some(folder) = maps() else { return };
    for name in ["levine", "columbia", "porto", "berlin", "skirk", "vegas"] {
        for seed in 0..3 {
            let map = map_file::read(&folder.join(name).with_extension("yaml")).unwrap();
            let scene = Scene::in_map(map, seed).unwrap();
            let poses = checked_drive(&scene.route, &VehicleKnobs::default(), 120.0);
            let clearance = min_clearance(scene.world.as_ref(), &poses);
            let length = path_length(&poses);
            eprintln!("{name}, seed {seed}: {length:.0} m, clearance {clearance:.2} m, lap {:.1} m", scene.route.length());
            assert!(length >= 200.0 && clearance > 0.2, "{name}: {length} m, {clearance} m from a wall");
        }
    }
}

// ---- simulate ----

fn record(settings: &Settings, scene: &Scene) -> Vec<(Stamp, SimulatedMessage)> {
    let mut messages = Vec::new();
    let outcome = simulate(settings, scene, |time, message| {
        messages.push((time, message));
        Ok::<(), Infallible>(())
    });
    outcome.unwrap();
    messages
}

fn bytes(messages: &[(Stamp, SimulatedMessage)]) -> Vec<u8> {
    let encoded = |message: &SimulatedMessage| match message {
        SimulatedMessage::Mount(message) => encode(message).unwrap(),
        SimulatedMessage::Odometry(message) => encode(message).unwrap(),
        SimulatedMessage::Truth { stamp, map_from_base } => encode(&truth_message(*stamp, *map_from_base)).unwrap(),
        SimulatedMessage::Scan(message) => encode(message).unwrap(),
    };
    messages.iter().flat_map(|(time, message)| [time.nanoseconds().to_le_bytes().to_vec(), encoded(message)].concat()).collect()
}

fn short() -> Settings {
    let mut settings = Settings::default();
    settings.drive.duration = Seconds(3.0);
    settings
}

#[test]
fn the_same_seed_makes_the_same_bytes() {
    let scene = corridor();
    let first = bytes(&record(&short(), &scene));
    assert!(first == bytes(&record(&short(), &corridor())));
    let mut other = short();
    other.drive.seed = 2;
    assert!(first != bytes(&record(&other, &scene)));
}

#[test]
fn messages_have_the_order_and_times_of_a_real_robot() {
    let mut settings = short();
    settings.lidar.rate = 30.0;
    let messages = record(&settings, &corridor());
    assert!(matches!(messages[0], (START, SimulatedMessage::Mount(_))));
    assert!(messages.windows(2).all(|pair| pair[0].0 <= pair[1].0));
    let (mut scans, mut truths, mut latest_odometry) = (Vec::new(), Vec::new(), Stamp::default());
    for (time, message) in &messages {
        match message {
            SimulatedMessage::Mount(_) => {}
            SimulatedMessage::Odometry(odometry) => {
                latest_odometry = odometry.header.stamp.into();
                assert_eq!(latest_odometry, *time);
            }
            SimulatedMessage::Truth { stamp, .. } => truths.push(*stamp),
            SimulatedMessage::Scan(scan) => {
                let stamp = Stamp::from(scan.header.stamp);
                assert_eq!(time.nanoseconds() - stamp.nanoseconds(), 5_000_000);
                assert!(latest_odometry.offset_by(0.02) > stamp);
                scans.push(stamp);
            }
        }
    }
    let grid: Vec<Stamp> = (0..90).map(|k| START.offset_by(f64::from(k) / 30.0)).collect();
    assert_eq!(scans, grid);
    assert_eq!(truths, grid);
    assert_eq!(grid[1].nanoseconds() - START.nanoseconds(), 33_333_333);
}

#[test]
fn a_drive_is_recorded_as_a_bag_and_its_truth_as_a_trajectory() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str| {
        let mut truth = Vec::new();
        let bag = BagWriter::create(folder.path().join(name), Compression::Lz4).unwrap();
        let scans = simulated_bag::record(&short(), &corridor(), bag, TumWriter::new(&mut truth)).unwrap();
        (scans, String::from_utf8(truth).unwrap(), fs::read(folder.path().join(name)).unwrap())
    };
    let (scans, truth, bytes) = write("a.bag");
    assert!((scans, &truth, &bytes) == (120, &write("b.bag").1, &write("b.bag").2));
    let bag = Bag::open(folder.path().join("a.bag")).unwrap();
    for (topic, count) in [("/scan", 120), ("/gt_pose", 120), ("/odom", 150), ("/tf_static", 1)] {
        assert_eq!(bag.message_count(Some(&[topic])), count, "{topic}");
    }
    assert_eq!((bag.topics_of::<LaserScan>(), bag.topics_of::<Odometry>()), (vec!["/scan"], vec!["/odom"]));
    let trajectory = tum::parse(&truth, Path::new("truth.tum")).unwrap();
    assert_eq!((trajectory.poses().len(), trajectory.ends().0.stamp), (120, START));
}

#[test]
fn an_error_of_the_recorder_ends_the_drive() {
    let mut count = 0;
    let outcome = simulate(&short(), &corridor(), |_, _| {
        count += 1;
        if count == 5 { Err("disk full") } else { Ok(()) }
    });
    assert_eq!((outcome, count), (Err("disk full"), 5));
}

// ---- map files ----

const YAML: &str =
    "image: map.png\nresolution: 0.05\norigin: [-1.0, -2.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n";

/// A map with three values: black at the top left, white, and a grey that means unknown.
fn map_folder(yaml: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("map.yaml"), yaml).unwrap();
    let image = GrayImage::new(2, vec![0, 254, 254, 205]).unwrap();
    image.write_png(fs::File::create(folder.path().join("map.png")).unwrap()).unwrap();
    fs::write(folder.path().join("map.pgm"), b"P2\n# a comment\n2 2\n255\n0 254\n254 205\n").unwrap();
    folder
}

fn read_map(yaml: &str) -> Result<OccupancyGrid, String> {
    map_file::read(&map_folder(yaml).path().join("map.yaml")).map_err(|error| error.to_string())
}

#[test]
fn maps_are_read_as_map_server_reads_them() {
    use Cell::{Free, Occupied, Unknown};
    for (yaml, cells) in [
        (YAML.to_owned(), [Free, Unknown, Occupied, Free]),
        (YAML.replace(".png", ".pgm"), [Free, Unknown, Occupied, Free]),
        (YAML.replace("negate: 0", "negate: 1"), [Occupied, Occupied, Free, Occupied]),
        (YAML.to_owned() + "mode: trinary\n", [Free, Unknown, Occupied, Free]),
    ] {
        let grid = read_map(&yaml).unwrap();
        assert_eq!((grid.width(), grid.height(), grid.cells()), (2, 2, &cells[..]), "{yaml}");
        assert!((grid.centre(0, 1) - Point::new(-0.975, -1.925)).norm() < 1e-12);
    }
}

#[test]
fn bad_maps_name_the_file_the_field_and_the_remedy() {
    for (yaml, expected) in [
        (YAML.replace("map.png", "none.png"), vec!["image", "none.png", "relative to the map file"]),
        (YAML.replace("map.png", "map.yaml"), vec!["image", "map.yaml", "PNG or PGM"]),
        (YAML.replace("resolution: 0.05", "resolution: 0"), vec!["resolution is 0", "above 0"]),
        (YAML.replace("resolution: 0.05", "resolution: .nan"), vec!["resolution is NaN", "above 0"]),
        (YAML.replace("resolution: 0.05\n", ""), vec!["resolution"]),
        (YAML.replace("resolution: 0.05", "resolution: coarse"), vec!["a map file needs image, resolution"]),
        (YAML.replace("-2.0, 0.0]", "-2.0]"), vec!["a map file needs"]),
        (YAML.replace("-2.0, 0.0]", "-2.0, .inf]"), vec!["origin", "[x, y, yaw]"]),
        (YAML.replace("negate: 0", "negate: 2"), vec!["negate is 2", "0 (dark is occupied)"]),
        (YAML.replace("0.65", "65"), vec!["occupied_thresh is 65", "between 0 and 1"]),
        (YAML.replace("0.196", "0.7"), vec!["free_thresh is 0.7", "less than occupied_thresh"]),
        (YAML.to_owned() + "mode: raw\n", vec!["mode is raw", "trinary"]),
        ("not a map".to_owned(), vec!["a map file needs"]),
    ] {
        let message = read_map(&yaml).unwrap_err();
        for part in ["map.yaml"].into_iter().chain(expected) {
            assert!(message.contains(part), "`{part}` is not in: {message}");
        }
    }
    let missing = map_file::read(Path::new("nowhere/map.yaml")).unwrap_err().to_string();
    assert!(missing.contains("nowhere/map.yaml"), "{missing}");
}

#[test]
fn maps_without_room_to_drive_are_an_error() {
    let blocked = OccupancyGrid::new(100, 0.05, Pose2::IDENTITY, vec![Cell::Unknown; 10_000]).unwrap();
    assert!(Scene::in_map(blocked, 1).err().unwrap().to_string().contains("away from walls"));
    let narrow = OccupancyGrid::new(30, 0.05, Pose2::IDENTITY, vec![Cell::Free; 3000]).unwrap();
    assert!(Scene::in_map(narrow, 1).err().unwrap().to_string().contains("no loop"));
}

#[test]
fn an_empty_hall_is_driven_in_circles() {
    let hall = OccupancyGrid::new(200, 0.05, Pose2::new(3.0, 1.0, 0.7), vec![Cell::Free; 40_000]).unwrap();
    let scene = Scene::in_map(hall, 1).unwrap();
    let poses = checked_drive(&scene.route, &VehicleKnobs::default(), 30.0);
    assert!(min_clearance(scene.world.as_ref(), &poses) > 0.3 && path_length(&poses) > 30.0);
}

#[test]
fn the_demo_bag_equals_a_drive_with_defaults_to_the_bit() {
    let bag = Bag::open(Path::new(env!("CARGO_MANIFEST_DIR")).join("bags/demo.bag")).unwrap();
    let mut settings = Settings::default();
    settings.drive.duration = Seconds(10.0);
    let recorded = bag.messages(None).flat_map(|message| {
        let message = message.unwrap();
        [message.time.nanoseconds().to_le_bytes().to_vec(), message.data].concat()
    });
    assert!(recorded.eq(bytes(&record(&settings, &corridor()))));
}

#[test]
fn a_simulated_bag_has_the_odometry_on_tf_too() {
    let folder = tempfile::TempDir::new().unwrap();
    let out = folder.path().join("out.bag");
    let mut settings = Settings::default();
    settings.drive.duration = Seconds(0.5);
    let bag = BagWriter::create(&out, Compression::None).unwrap();
    simulated_bag::record(&settings, &corridor(), bag, TumWriter::new(std::io::sink())).unwrap();
    let (mut odometry, mut transforms) = (Vec::new(), Vec::new());
    for message in Bag::open(&out).unwrap().messages(None) {
        let message = message.unwrap();
        match message.connection.topic.as_str() {
            "/odom" => odometry.push(message.decode::<Odometry>().unwrap()),
            "/tf" => transforms.extend(message.decode::<TFMessage>().unwrap().transforms),
            _ => {}
        }
    }
    assert!(odometry.len() > 10 && odometry.len() == transforms.len(), "{} {}", odometry.len(), transforms.len());
    for (odometry, transform) in odometry.iter().zip(&transforms) {
        assert_eq!((&transform.header, &*transform.child_frame_id), (&odometry.header, "base_link"));
        let t = &transform.transform;
        let pose = Pose2::new(t.translation.x, t.translation.y, t.rotation.yaw());
        assert_eq!((transform.header.frame_id.as_str(), pose), ("odom", planar_pose(&odometry.pose.pose).unwrap()));
    }
}

// ---- traffic ----

/// The ranges of all scans of a drive of 20 s, without noise.
fn ranges_amid(traffic: TrafficKnobs, scan_duration: f64) -> Vec<f32> {
    let mut settings = Settings { traffic, ..Settings::default() };
    settings.lidar = LidarKnobs { beams: 271, rate: 10.0, noise: 0.0, scan_duration: Seconds(scan_duration), ..settings.lidar };
    let scans = record(&settings, &corridor()).into_iter().filter_map(|(_, message)| match message {
        SimulatedMessage::Scan(scan) => Some(scan.ranges),
        _ => None,
    });
    scans.flatten().collect()
}

#[test]
fn more_traffic_hides_more_rays_and_changes_nothing_else() {
    let empty = ranges_amid(TrafficKnobs::default(), 0.0);
    for (walkers, rivals, least) in [(10, 0, 0.02), (30, 0, 0.07), (0, 1, 0.05), (0, 4, 0.07), (60, 4, 0.2)] {
        let ranges = ranges_amid(TrafficKnobs { walkers, rivals }, 0.0);
        assert!(ranges == ranges_amid(TrafficKnobs { walkers, rivals }, 0.0));
        assert!(ranges.iter().zip(&empty).all(|(range, empty)| range <= empty), "traffic is behind a wall");
        let nearest = ranges.iter().copied().fold(f32::INFINITY, f32::min);
        assert!(nearest > 0.15, "the car touches traffic: {nearest}");
        let covered = ranges.iter().zip(&empty).filter(|(range, empty)| range < empty).count();
        let share = covered as f64 / empty.len() as f64;
        println!("{walkers} walkers and {rivals} rivals cover {:.1} % of the rays", 100.0 * share);
        assert!(share > least && share < 2.0 * least, "{share}");
    }
}

#[test]
fn people_and_cars_respect_their_speed_limits() {
    let scene = corridor();
    let motion = motion(&scene);
    let moved = |knobs: TrafficKnobs, seconds: f64, step: f64, fastest: f64| {
        let traffic = Traffic::new(&knobs, &scene.route, scene.world.as_ref(), &motion, Pcg64::seed_from_u64(3));
        // A person or car hit centrally by a ray must be near the same ray a moment later.
        let from = motion.pose_at(seconds).translation();
        let seen = |at: f64, angle: f64| traffic.at(scene.world.as_ref(), at).range(from, direction(angle), 30.0).unwrap();
        let nearest = |at: f64| (0..3600).map(|i| seen(at, f64::from(i) * PI / 1800.0)).fold(f64::INFINITY, f64::min);
        assert!((nearest(seconds) - nearest(seconds + step)).abs() < fastest * step + 1e-3, "at {seconds}");
    };
    for tenths in 0..90 {
        let seconds = 0.1 * f64::from(tenths);
        moved(TrafficKnobs { walkers: 60, rivals: 0 }, seconds, 0.02, 6.0);
        moved(TrafficKnobs { walkers: 0, rivals: 4 }, seconds, 0.02, 6.0);
    }
}

#[test]
fn moving_objects_are_seen_where_they_are_at_the_time_of_the_ray() {
    let traffic = TrafficKnobs { walkers: 40, rivals: 2 };
    assert!(ranges_amid(traffic.clone(), 0.0) != ranges_amid(traffic.clone(), 0.05));
    // At rest only moving objects differ.
    let first_second = |ranges: Vec<f32>| ranges[..271 * 9].to_vec();
    let still =
        |traffic: TrafficKnobs| (first_second(ranges_amid(traffic.clone(), 0.0)), first_second(ranges_amid(traffic, 0.05)));
    let (instant, swept) = still(TrafficKnobs::default());
    assert!(instant == swept);
    let (instant, swept) = still(traffic);
    assert!(instant != swept);
}

// ---- pairs of scans ----

/// Cases in which the minimum covariance is known: n beams perpendicular to a wall determine its distance to noise / sqrt(n), and a pair of
/// scans has twice that variance.
#[test]
fn the_cramer_rao_bound_equals_closed_forms() {
    let (noise, beams) = (0.01, 101_u8);
    let room = Shapes::default().block(&Pose2::IDENTITY.transform(), 10.0, 8.0);
    let all_round = BeamGeometry::new(0.0, 2.0 * PI / f64::from(beams), beams.into());
    let circle = Shapes::default().pillar(Point::zeros(), 4.0);
    let of_circle = scan_information(&circle, &Pose2::IDENTITY, &all_round, noise, 30.0);
    let expected = 0.5 * f64::from(beams) / (noise * noise);
    assert!((of_circle.m11 / expected - 1.0).abs() < 1e-6 && (of_circle.m22 / expected - 1.0).abs() < 1e-6, "{of_circle}");
    assert!(of_circle.m33 < 1e-9 * expected, "a circle does not constrain the heading: {of_circle}");
    assert_eq!(pair_covariance_bound(&of_circle), None);

    // Finite differences of the ranges, from a pose in a room.
    let at = Pose2::new(1.3, -0.7, 0.4);
    let range = |pose: Pose2, beam: Point| room.range(pose.translation(), pose.transform().rotate(beam), 30.0).unwrap();
    let step = 1e-5;
    let derivative = |beam: Point| {
        let change = |dx: f64, dy: f64, turn: f64| {
            let moved = |sign: f64| range(Pose2::new(at.x + sign * dx, at.y + sign * dy, at.theta + sign * turn), beam);
            (moved(1.0) - moved(-1.0)) / (2.0 * step)
        };
        Vector3::new(change(step, 0.0, 0.0), change(0.0, step, 0.0), change(0.0, 0.0, step))
    };
    let sum: Matrix3<f64> = all_round.directions().iter().map(|&beam| derivative(beam)).map(|d| d * d.transpose()).sum();
    let information = scan_information(&room, &at, &all_round, noise, 30.0);
    assert!((information * noise * noise - sum).norm() < 1e-4 * sum.norm(), "{information} {sum}");
    let bound = pair_covariance_bound(&information).unwrap();
    assert!((bound * information - Matrix3::identity() * 2.0).norm() < 1e-6);
}

#[test]
fn pairs_are_determined_by_their_seed_and_agree_with_their_truth() {
    let drawn = |seed| Pairs::new(RandomWorld::Room, 181, seed).take(20).collect::<Vec<_>>();
    assert_eq!(format!("{:?}", drawn(3)), format!("{:?}", drawn(3)));
    assert_ne!(format!("{:?}", drawn(3)), format!("{:?}", drawn(4)));
    for kind in RandomWorld::ALL {
        for pair in Pairs::new(*kind, 361, 1).take(20) {
            let motion = pair.reference_from_sensed;
            assert!(motion.distance() <= 0.2 && motion.theta.abs().to_degrees() < 6.0, "{motion:?}");
            let off = motion.between(&pair.first_guess);
            assert!(off.distance() < 0.06 && off.theta.abs().to_degrees() < 3.0, "{off:?}");
            let nearest = pair.reference.ranges().iter().copied().fold(f64::INFINITY, f64::min);
            assert!(nearest > 0.3, "{}: a wall at {nearest} m", kind.name());
            assert_eq!(pair_covariance_bound(&pair.information).is_none(), *kind == RandomWorld::FeaturelessCorridor);
        }
    }
}
