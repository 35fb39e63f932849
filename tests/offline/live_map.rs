//! The map that is built while the robot drives, compared with the truth and with the map built offline, and the data that is kept for it.

use std::convert::Infallible;
use std::fs;
use std::sync::Arc;

use anytime_scan_matcher::anytime::clock::MonotonicClock;
use anytime_scan_matcher::app::sensed::SensorMessage;
use anytime_scan_matcher::app::{App, ScanProcessor as _};
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::geometry::{Point, Pose2};
use anytime_scan_matcher::io::map_file;
use anytime_scan_matcher::io::map_files::{MapFiles, MapPaths};
use anytime_scan_matcher::knobs::Seconds;
use anytime_scan_matcher::map::grid::{Cell, OccupancyGrid};
use anytime_scan_matcher::mapping::{EvidenceGrid, LiveMap, Mapper, MotionStatus, PosedScan};
use anytime_scan_matcher::scan::Scan;
use anytime_scan_matcher::simulation::built_in::BuiltIn;
use anytime_scan_matcher::simulation::drive::{Settings, SimulatedMessage, simulate};
use anytime_scan_matcher::simulation::scene::Scene;

/// Odometry error of the drive per scan: too long, and to the left.
const ERROR: Pose2 = Pose2 { x: 0.002, y: 0.0, theta: 0.0004 };

/// A drive of some laps by bad odometry: the scans, and their true poses relative to the first one.
fn drive(seconds: f64) -> Vec<(PosedScan, Scan, Pose2)> {
    let mut settings = Settings::default();
    (settings.drive.duration, settings.lidar.beams, settings.lidar.rate) = (Seconds(seconds), 181, 10.0);
    let mut app = App::new(&Config::default(), Arc::new(MonotonicClock::default())).unwrap();
    let (mut seen, mut before): (Vec<(PosedScan, Scan, Pose2)>, Option<Pose2>) = (Vec::new(), None);
    let mut odom_from_base = Pose2::IDENTITY;
    simulate::<Infallible>(&settings, &Scene::built_in(BuiltIn::Corridor).unwrap(), |_, message| {
        match message {
            SimulatedMessage::Mount(message) => app.on_transforms(&message).unwrap(),
            SimulatedMessage::Odometry(message) => app.on_odometry(&message).unwrap(),
            SimulatedMessage::Scan(scan) => {
                let estimate = app.on_scan(&scan, std::time::Duration::ZERO);
                let (posed_scan, measured) = app.posed_scan(&SensorMessage::Scan(scan), &estimate).unwrap();
                let pose = posed_scan.odom_from_base;
                if let Some(before) = before.replace(pose) {
                    odom_from_base = odom_from_base * before.between(&pose) * ERROR;
                }
                seen.push((PosedScan { odom_from_base, ..posed_scan }, measured, pose));
            }
            SimulatedMessage::Truth { .. } => {}
        }
        Ok(())
    })
    .unwrap();
    seen
}

fn live(seen: &[(PosedScan, Scan, Pose2)]) -> LiveMap {
    let config = Config::default();
    let mut map = LiveMap::new(&config.matching, &config.rejection, 0.05);
    for (posed_scan, measured, _) in seen {
        map.add(posed_scan.clone(), measured);
        while map.work(16) {}
    }
    map
}

fn cells(grid: &EvidenceGrid) -> OccupancyGrid {
    grid.to_map().unwrap().unwrap()
}

/// Fraction of the occupied cells of `a` that are next to an occupied cell of `b`.
fn agreement(a: &OccupancyGrid, b: &OccupancyGrid) -> f64 {
    let (mut near, mut all) = (0, 0);
    for (i, _) in a.cells().iter().enumerate().filter(|(_, cell)| **cell == Cell::Occupied) {
        all += 1;
        let place = b.coordinates(a.centre(i % a.width(), i / a.width()));
        let (x, y) = (place.x.floor() as i64, place.y.floor() as i64);
        let is_wall = |dx: i64, dy: i64| b.cell(x + dx, y + dy) == Some(Cell::Occupied);
        near += usize::from((-1..=1).any(|dx| (-1..=1).any(|dy| is_wall(dx, dy))));
    }
    near as f64 / f64::from(all.max(1))
}

#[test]
fn loop_closures_correct_the_map_while_the_odometry_drifts() {
    let seen = drive(60.0);
    let mut map = live(&seen);
    let (last, _, truth) = &seen[seen.len() - 1];
    let truth = seen[0].2.between(truth);
    let (drift, error) =
        (truth.between(&last.odom_from_base).distance(), truth.between(&(map.map_from_odom() * last.odom_from_base)));
    assert!(drift > 1.0, "{drift}");
    assert!(error.distance() < 0.1 && error.theta.abs() < 0.01, "{error:?}");
    assert!(map.mapper().progress().loops > 10);

    map.settle();
    let config = Config::default();
    let mut afterwards = Mapper::new(&config.matching, &config.rejection);
    for (posed_scan, _, _) in seen {
        afterwards.add(posed_scan);
    }
    afterwards.finish();
    let (live, afterwards) = (cells(map.grid()), cells(&afterwards.grid(0.05)));
    let parts = [agreement(&live, &afterwards), agreement(&afterwards, &live)];
    assert!(parts.iter().all(|part| *part > 0.97), "{parts:?}");
}

#[test]
fn data_per_place_is_limited_and_the_same_drive_makes_the_same_map() {
    let seen = drive(75.0);
    let (mut a, mut b) = (live(&seen), live(&seen));
    assert!(a.changed_grid().map(cells) == b.changed_grid().map(cells));
    assert!(a.changed_grid().is_none(), "nothing must have changed since");
    let keyframes = a.mapper().keyframes();
    let kept = keyframes.iter().filter(|keyframe| keyframe.view.is_some()).count();
    assert!(kept < keyframes.len() * 3 / 4, "{kept} of {}", keyframes.len());
    a.settle();
    // The dropped keyframes are not needed to extend the map from the file.
    let config = Config::default();
    let bytes = a.mapper().to_bytes();
    let mut read = Mapper::from_bytes(&bytes, &config.matching, &config.rejection).unwrap();
    assert_eq!(read.to_bytes(), bytes);
    assert!(cells(&read.grid(0.05)) == cells(a.grid()));
    read.finish();
}

#[test]
fn a_run_with_unknown_start_is_drawn_once_it_is_localized() {
    let mut seen = drive(75.0);
    let middle = seen.len() * 2 / 3;
    seen[middle].0.motion_status = MotionStatus::Start;
    let somewhere = Pose2::new(30.0, 12.0, 1.0) * seen[middle].0.odom_from_base.inverse();
    for (posed_scan, _, _) in &mut seen[middle..] {
        posed_scan.odom_from_base = somewhere * posed_scan.odom_from_base;
    }
    let map = live(&seen);
    assert_eq!(map.mapper().unplaced_runs(), 0);
    let (last, _, truth) = &seen[seen.len() - 1];
    let error = seen[0].2.between(truth).between(&(map.map_from_odom() * last.odom_from_base));
    assert!(error.distance() < 0.15, "{error:?}");
}

#[test]
fn saving_writes_all_files_or_leaves_them_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let map = OccupancyGrid::new(2, 0.05, Pose2::IDENTITY, vec![Cell::Free, Cell::Occupied, Cell::Unknown, Cell::Free]).unwrap();
    let paths = MapPaths::new(&folder.path().join("hall"));
    let save = |graph: &[u8]| {
        let mut files = MapFiles::create(paths.clone())?;
        files.write(&map, graph)?;
        files.commit()
    };
    save(b"graph").unwrap();
    assert_eq!(map_file::read(&paths.yaml).unwrap(), map);
    assert_eq!(fs::read(&paths.graph).unwrap(), b"graph");
    let centre = map.centre(1, 0);
    assert!((centre - Point::new(0.075, 0.025)).norm() < 1e-9);
    let before = fs::read(&paths.image).unwrap();
    drop(MapFiles::create(paths.clone()).unwrap());
    assert_eq!((fs::read(&paths.image).unwrap(), fs::read_dir(folder.path()).unwrap().count()), (before, 3));
    // A full disk.
    #[cfg(target_os = "linux")]
    {
        fs::remove_file(&paths.graph).unwrap();
        std::os::unix::fs::symlink("/dev/full", &paths.graph).unwrap();
        let problem = save(b"graph").unwrap_err().to_string();
        assert!(problem.contains("hall.graph") && problem.contains("No space left"), "{problem}");
        assert_eq!(map_file::read(&paths.yaml).unwrap(), map);
    }
    let nowhere = MapFiles::create(MapPaths::new(&folder.path().join("no/such"))).unwrap_err().to_string();
    assert!(nowhere.contains("no/such.yaml"), "{nowhere}");
}
