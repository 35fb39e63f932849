//! Fuzzes the readers of files and messages with mutated valid input: errors are allowed, panics and excessive memory use are not.
//!
//! Every file under `tests/corpus/` is read unchanged and after random edits by proptest: 256 times in an ordinary run, longer with
//! `PROPTEST_CASES=100000 cargo test --test offline fuzz`. Inputs that once made a reader fail are kept there, beside the valid files.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use crate::common::Laser;
use anytime_scan_matcher::anytime::clock::VirtualClock;
use anytime_scan_matcher::app::sensed::SensorMessage;
use anytime_scan_matcher::app::{App, ScanProcessor as _, map_message};
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::bag::{Bag, BagWriter, Compression};
use anytime_scan_matcher::io::carmen::CarmenLog;
use anytime_scan_matcher::io::gray_image::GrayImage;
use anytime_scan_matcher::io::map_file;
use anytime_scan_matcher::messages::geometry_msgs::{PoseWithCovarianceStamped, Quaternion, TransformStamped, Twist};
use anytime_scan_matcher::messages::nav_msgs::{MapMetaData, OccupancyGrid, Odometry};
use anytime_scan_matcher::messages::own::Contract;
use anytime_scan_matcher::messages::sensor_msgs::{Imu, LaserScan, PointCloud2, PointField};
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;
use anytime_scan_matcher::messages::{decode, encode};
use anytime_scan_matcher::time::Stamp;
use proptest::prelude::*;
use tempfile::TempDir;

/// Maximum memory that a reader may allocate for some kilobytes of input, bytes.
const MOST_MEMORY: u64 = 64 << 20;
/// Strings that are inserted into text.
const WORDS: [&str; 16] =
    ["nan", "-inf", "1e999", "-1", "18446744073709551616", "0", ":", "[", "]", "{", "&a ", "*a", "\n", "\t", "-", "\u{fe0f}"];

fn corpus(folder: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus").join(folder);
    let mut files: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|file| file.unwrap().path()).collect();
    files.sort();
    files
}

/// One edit of some bytes.
#[derive(Clone, Debug)]
enum Edit {
    Flip(u8),
    Word(u32),
    Cut(u8),
    Repeat(u8),
    End,
    Text(usize),
}

fn edits() -> impl Strategy<Value = Vec<(Edit, u16)>> {
    let extremes = prop_oneof![any::<u32>(), Just(0), Just(u32::MAX), Just(1 << 31), Just(0x7fc0_0000), 0_u32..300];
    let edit = prop_oneof![
        any::<u8>().prop_map(Edit::Flip),
        extremes.prop_map(Edit::Word),
        any::<u8>().prop_map(Edit::Cut),
        any::<u8>().prop_map(Edit::Repeat),
        Just(Edit::End),
        (0..WORDS.len()).prop_map(Edit::Text),
    ];
    prop::collection::vec((edit, any::<u16>()), 1..6)
}

fn spoil(bytes: &[u8], edits: &[(Edit, u16)]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for (edit, place) in edits {
        let start = usize::from(*place) * bytes.len() / (usize::from(u16::MAX) + 1);
        let end_after = |length: &u8| (start + usize::from(*length)).min(bytes.len());
        match edit {
            Edit::Flip(bits) => bytes[start..].iter_mut().take(1).for_each(|byte| *byte ^= bits),
            Edit::Word(word) => bytes[start..].iter_mut().zip(word.to_le_bytes()).for_each(|(byte, new)| *byte = new),
            Edit::Cut(length) => drop(bytes.drain(start..end_after(length))),
            Edit::Repeat(length) => {
                let again = bytes[start..end_after(length)].to_vec();
                drop(bytes.splice(start..start, again));
            }
            Edit::End => bytes.truncate(start),
            Edit::Text(word) => drop(bytes.splice(start..start, WORDS[*word].bytes())),
        }
    }
    bytes
}

/// Whether these bytes can be read. Fails if the reader allocates more than `memory`.
fn check(read: impl Fn(&[u8]) -> bool, bytes: &[u8], memory: u64) -> bool {
    let mut readable = false;
    let info = allocation_counter::measure(|| readable = read(bytes));
    assert!(info.bytes_max < memory, "{} bytes for {}", info.bytes_max, bytes.len());
    readable
}

/// Reads the files of `folder`, then mutated ones.
fn fuzz(folder: &str, memory: u64, read: impl Fn(&[u8]) -> bool) {
    let files: Vec<Vec<u8>> = corpus(folder).iter().map(|path| fs::read(path).unwrap()).collect();
    assert!(
        files.iter().filter(|bytes| check(&read, bytes, memory)).count() == files.len(),
        "some files of {folder} are rejected"
    );
    proptest!(|(file in prop::sample::select(files), edits in edits())| {
        check(&read, &spoil(&file, &edits), memory);
    });
}

/// Gives these bytes to the application as every message type they decode to; returns whether it accepted any.
fn handle(app: &mut App, bytes: &[u8]) -> bool {
    let scan = decode(bytes).map(|message: LaserScan| app.on_scan(&message, Duration::ZERO));
    let cloud = decode(bytes).map(|message: PointCloud2| app.on_sensed(&SensorMessage::Cloud(message), Duration::ZERO));
    let malformed = app.counters().malformed_scans;
    let mut scans = 0;
    for mut estimate in [scan, cloud].into_iter().flatten() {
        assert!(estimate.registration.odom_from_base.is_finite());
        app.conclude(&mut estimate);
        scans += 1;
    }
    [
        malformed + scans > app.counters().malformed_scans,
        decode(bytes).is_ok_and(|message: Odometry| app.on_odometry(&message).is_ok()),
        decode(bytes).is_ok_and(|message: TFMessage| app.on_transforms(&message).is_ok()),
        decode(bytes).is_ok_and(|message: Imu| app.on_imu(&message).is_ok()),
        decode(bytes).is_ok_and(|message: Twist| app.on_velocity(&message).is_ok()),
        decode(bytes).is_ok_and(|message: Contract| app.on_contract(&message).is_ok()),
        decode(bytes).is_ok_and(|message: PoseWithCovarianceStamped| app.on_initial_pose(&message, Duration::ZERO).is_ok()),
        decode(bytes).is_ok_and(|message: OccupancyGrid| map_message::grid(&message).is_ok()),
    ]
    .contains(&true)
}

fn app() -> App {
    App::new(&Config::default(), Arc::new(VirtualClock::new(Duration::from_micros(1)))).unwrap()
}

#[test]
fn messages() {
    let good: Vec<Vec<u8>> = corpus("message").iter().map(|path| fs::read(path).unwrap()).collect();
    fuzz("message", MOST_MEMORY, |bytes| {
        let mut app = app();
        let before = good.iter().all(|message| handle(&mut app, message));
        let readable = handle(&mut app, bytes);
        assert!(before && good.iter().all(|message| handle(&mut app, message)));
        readable
    });
}

#[test]
fn bags() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("spoiled.bag");
    fuzz("bag", MOST_MEMORY, |bytes| {
        fs::write(&path, bytes).unwrap();
        let Ok(bag) = Bag::open(&path) else { return false };
        let mut app = app();
        bag.messages(None).flatten().filter(|message| handle(&mut app, &message.data)).count() == 9
    });
}

#[test]
fn carmen_logs() {
    fuzz("carmen", MOST_MEMORY, |bytes| {
        let log = CarmenLog::parse(&String::from_utf8_lossy(bytes), Path::new("spoiled.log"), None);
        log.is_ok_and(|log| {
            log.mount();
            log.damaged.is_empty()
        })
    });
}

#[test]
fn configurations() {
    fuzz("config", MOST_MEMORY, |bytes| {
        let mut config = Config::default();
        let set = config.set_yaml(&String::from_utf8_lossy(bytes), "spoiled.yaml").is_ok();
        set && App::new(&config, Arc::new(VirtualClock::new(Duration::from_micros(1)))).is_ok()
    });
}

/// A map is two files; the name of the image determines its format.
fn read_map(description: &[u8], image: &[u8]) -> bool {
    let dir = TempDir::new().unwrap();
    fs::write(dir.path().join("map.yaml"), description).unwrap();
    fs::write(dir.path().join("map.png"), image).unwrap();
    map_file::read(&dir.path().join("map.yaml")).is_ok()
}

#[test]
fn map_descriptions() {
    let image = fs::read(&corpus("map_image")[0]).unwrap();
    fuzz("map", MOST_MEMORY, |bytes| read_map(bytes, &image));
}

#[test]
fn map_images() {
    let description = fs::read(&corpus("map")[0]).unwrap();
    fuzz("map_image", 8 * MOST_MEMORY, |bytes| read_map(&description, bytes));
}

/// A ring of points around the laser.
fn cloud() -> PointCloud2 {
    let field = |name: &str, offset| PointField { name: name.into(), offset, datatype: PointField::FLOAT32, count: 1 };
    let point = |degrees: u16| {
        let (sin, cos) = f32::from(degrees).to_radians().sin_cos();
        [2.0 * cos, 3.0 * sin].map(f32::to_le_bytes)
    };
    let (width, point_step) = (60, 8);
    let mut cloud = PointCloud2 { height: 1, width, point_step, row_step: width * point_step, ..PointCloud2::default() };
    cloud.header.frame_id = "laser".into();
    cloud.fields = vec![field("x", 0), field("y", 4)];
    cloud.data = (0..60).flat_map(|number| point(6 * number)).flatten().collect();
    cloud
}

/// A map of 4 by 3 cells.
fn map() -> OccupancyGrid {
    let origin = Pose2::new(1.0, 2.0, 0.3).into();
    let info = MapMetaData { resolution: 0.05, width: 4, height: 3, origin, ..MapMetaData::default() };
    OccupancyGrid { info, data: vec![0, 0, 100, -1, 0, 0, 100, -1, 0, 0, 100, -1], ..OccupancyGrid::default() }
}

/// Writes the valid binary files: `cargo test --test offline fuzz -- --ignored`.
#[test]
#[ignore = "writes the corpus"]
fn write_the_corpus() {
    let folder = |name: &str| {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus").join(name);
        fs::create_dir_all(&folder).unwrap();
        folder
    };
    let at = |tenths: u32| Stamp::from_ros(100, tenths * 100_000_000);
    let scan =
        |tenths: u32| Laser::with_field_of_view(270.0, 91).message(at(tenths), Pose2::new(0.01 * f64::from(tenths), 0.0, 0.0));
    let mut odometry = Odometry::default();
    (odometry.header.stamp, odometry.pose.pose.orientation.w) = (at(0).into(), 1.0);
    let mut transform = TransformStamped { child_frame_id: "laser".into(), ..TransformStamped::default() };
    (transform.header.frame_id, transform.transform.rotation.w) = ("base_link".into(), 1.0);
    let transforms = TFMessage { transforms: vec![transform] };
    let mut initial = PoseWithCovarianceStamped::default();
    initial.pose.pose.orientation.w = 1.0;
    for (name, bytes) in [
        ("scan", encode(&scan(0))),
        ("odometry", encode(&odometry)),
        ("tf", encode(&transforms)),
        ("contract", encode(&Contract::default())),
        ("initial_pose", encode(&initial)),
        ("cloud", encode(&cloud())),
        ("imu", encode(&Imu { orientation: Quaternion::from_yaw(0.3), ..Imu::default() })),
        ("velocity", encode(&Twist::default())),
        ("map", encode(&map())),
    ] {
        fs::write(folder("message").join(name), bytes.unwrap()).unwrap();
    }
    for (name, compression) in [("none", Compression::None), ("bz2", Compression::Bz2), ("lz4", Compression::Lz4)] {
        let mut writer = BagWriter::create(folder("bag").join(name).with_extension("bag"), compression).unwrap();
        writer.write("/tf", at(0), &transforms).unwrap();
        for tenths in 0..4 {
            writer.write("/odom", at(tenths), &odometry).unwrap();
            writer.write("/scan", at(tenths), &scan(tenths)).unwrap();
        }
        writer.finish().unwrap();
    }
    let shade = |i: usize| if (i % 16).is_multiple_of(5) || i / 16 == 3 { 0 } else { 254 };
    let pixels: Vec<u8> = (0..16 * 12).map(shade).collect();
    let image = GrayImage::new(16, pixels.clone()).unwrap();
    let file = |name: &str| fs::File::create(folder("map_image").join(name)).unwrap();
    image.write_png(file("map.png")).unwrap();
    file("map.pgm").write_all(&[&b"P5\n16 12\n255\n"[..], &pixels].concat()).unwrap();
}
