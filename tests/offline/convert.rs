//! Conversion of CARMEN logs to bags: handwritten, damaged and real ones.

use std::fs;
use std::io::Write as _;
use std::path::Path;

use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::bag::Bag;
use anytime_scan_matcher::io::carmen::{CarmenLog, Mount};
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;
use anytime_scan_matcher::messages::{Message, Time};
use anytime_scan_matcher::scan::ScanConverter;
use proptest::prelude::*;

use crate::common::program::{self, success};

/// Converts the bytes of a log; returns the output of the program and the name of the bag.
fn converted(folder: &Path, log: &[u8], flags: &[&str]) -> (String, String) {
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    let (log_path, bag) = (path("in.clf"), path("out.bag"));
    fs::write(&log_path, log).unwrap();
    (success(&[&["convert", &log_path, &bag], flags].concat()), bag)
}

fn messages<T: Message>(bag: &str, topic: &str) -> Vec<T> {
    let bag = Bag::open(bag).unwrap();
    bag.messages(Some(&[topic])).map(|message| message.unwrap().decode().unwrap()).collect()
}

/// Twelve ranges to a wall 2 m away, the last one without a return.
const RANGES: &str = "2.0 2.0 2.0 2.0 2.0 2.0 2.0 2.0 2.0 2.0 2.5 81.83";

fn front_laser(pose: &str, time: &str) -> String {
    format!("FLASER 12 {RANGES} {pose} {time} host 0.1")
}

/// Everything that a log of this kind may contain, with the laser 0.2 m ahead of the robot's centre.
fn log() -> String {
    let lines = [
        "# message_name [message contents] ipc_timestamp ipc_hostname logger_timestamp".into(),
        "PARAM robot_frontlaser_offset 0.5 host 0".into(),
        "ODOM 0 0 0 0.1 0 0 99.5 host 0.0".into(),
        front_laser("0.2 0 0 0 0 0", "100.000000001"),
        "SYNC start 100 host 0.2".into(),
        String::new(),
        front_laser("1.0 0.2 1.5707963267948966 1.0 0.0 1.5707963267948966", "100.2"),
        front_laser("1.2 0 0 1.0 0 0", "100.4"),
        front_laser("1.2 0 0 1.0 0 0", "100.3"),
        front_laser("1.2 0 0 1.0 0 0", "101.0"),
    ];
    lines.join("\r\n")
}

#[test]
fn scans_odometry_and_mount_are_those_of_the_lines() {
    let folder = tempfile::tempdir().unwrap();
    let (reported, bag) = converted(folder.path(), log().as_bytes(), &[]);
    assert!(
        reported.contains("5 scans")
            && reported.contains("2 stamps corrected, by at most 0.060 s")
            && reported.contains("1 SYNC"),
        "{reported}"
    );
    let scans: Vec<LaserScan> = messages(&bag, "/scan");
    assert_eq!(scans[0].header.stamp, Time { sec: 100, nsec: 1 });
    assert_eq!(scans[0].header.frame_id, "laser");
    assert_eq!(scans[0].ranges.iter().map(ToString::to_string).collect::<Vec<_>>()[10..], ["2.5", "81.83"]);
    assert!((scans[0].angle_min.to_degrees() + 90.0).abs() < 1e-4 && (scans[0].angle_max.to_degrees() - 75.0).abs() < 1e-4);
    let checked = ScanConverter::default().convert(&scans[0], false).unwrap();
    assert_eq!(checked.valid_len(), 11, "81.83 m is not a valid range");
    let stamps: Vec<f64> =
        scans.iter().map(|scan| f64::from(scan.header.stamp.nsec) * 1e-9 + f64::from(scan.header.stamp.sec)).collect();
    let expected = [100.000_000_001, 100.2, 100.34, 100.36, 101.0];
    assert!(stamps.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{stamps:?}");

    let odometry: Vec<Odometry> = messages(&bag, "/odom");
    assert_eq!(odometry.len(), 5);
    assert_eq!((odometry[1].header.stamp, odometry[1].child_frame_id.as_str()), (scans[1].header.stamp, "base_link"));
    assert!((odometry[1].pose.pose.position.x - 1.0).abs() < 1e-9);
    assert!((odometry[1].pose.pose.orientation.yaw().to_degrees() - 90.0).abs() < 1e-9);
    let mount = &messages::<TFMessage>(&bag, "/tf_static")[0].transforms[0];
    assert_eq!((mount.header.frame_id.as_str(), mount.child_frame_id.as_str()), ("base_link", "laser"));
    assert!((mount.transform.translation.x - 0.2).abs() < 1e-9);
}

#[test]
fn robot_laser_lines_give_geometry_and_maximum_range() {
    let folder = tempfile::tempdir().unwrap();
    let line = |x: f64, time: f64| {
        format!("ROBOTLASER1 0 -1.0 2.2 0.2 50.0 0.01 0 12 {RANGES} 2 5 6 {x} 0 0.1 {x} 0 0 0.5 0.25 0 0 0 {time} host {time}")
    };
    // The same scans also as FLASER lines, as in some logs.
    let log =
        [line(0.0, 10.0), front_laser("0 0 0 0 0 0", "10.0"), line(0.1, 10.2), front_laser("0 0 0 0.1 0 0", "10.2")].join("\n");
    let (reported, bag) = converted(folder.path(), log.as_bytes(), &["--compression", "none"]);
    assert!(reported.contains("2 scans"), "{reported}");
    let scan = &messages::<LaserScan>(&bag, "/scan")[1];
    assert!(
        (scan.angle_min + 1.0).abs() < 1e-6 && (scan.angle_increment - 0.2).abs() < 1e-6 && scan.range_max < 50.0,
        "{scan:?}"
    );
    let odometry = &messages::<Odometry>(&bag, "/odom")[1];
    assert!((odometry.twist.twist.linear.x - 0.5).abs() + (odometry.twist.twist.angular.z - 0.25).abs() < 1e-12);
    assert_eq!(CarmenLog::parse(&log, Path::new("x"), None).unwrap().mount(), Mount::Scans(Pose2::new(0.0, 0.0, 0.1)));
}

#[test]
fn corrected_poses_give_no_mount_and_odom_lines_replace_missing_odometry() {
    let corrected = [front_laser("0 0 0 0 0 0", "1"), front_laser("0.9 0.1 0 1 0 0", "2")].join("\n");
    let parsed = |text: &str| CarmenLog::parse(text, Path::new("x"), None).unwrap();
    assert_eq!(parsed(&corrected).mount(), Mount::Inconsistent);
    let with_parameter = format!("PARAM robot_frontlaser_offset 0.3 host 0\n{corrected}");
    assert_eq!(parsed(&with_parameter).mount(), Mount::Parameter(Pose2::new(0.3, 0.0, 0.0)));

    let folder = tempfile::tempdir().unwrap();
    let still = [front_laser("0 0 0 0 0 0", "1"), "ODOM 1 0 0 0.5 0 0 1.5 host 1".into(), "ODOM 2 0 0 0.5 0 0 1.7 host 1".into()];
    let (_, bag) = converted(folder.path(), still.join("\n").as_bytes(), &[]);
    let odometry: Vec<Odometry> = messages(&bag, "/odom");
    assert_eq!(odometry.iter().map(|o| o.pose.pose.position.x.to_string()).collect::<Vec<_>>(), ["1", "2"]);
}

#[test]
fn fields_of_view_follow_carmen_by_default() {
    let scan = |beams: usize, view: Option<f64>| {
        let line = format!("FLASER {beams} {} 0 0 0 0 0 0 0.0 host 7.5", "1 ".repeat(beams));
        CarmenLog::parse(&line, Path::new("x"), view).unwrap().scans[0].clone()
    };
    for (beams, increment) in [(180, 1.0), (181, 1.0), (360, 0.5), (361, 0.5)] {
        let scan = scan(beams, None);
        assert!(
            (scan.angle_increment.to_degrees() - increment).abs() < 1e-9 && (scan.angle_min.to_degrees() + 90.0).abs() < 1e-9
        );
    }
    let wide = scan(271, Some(270.0_f64.to_radians()));
    assert!((wide.angle_increment.to_degrees() - 1.0).abs() < 1e-9 && (wide.angle_min.to_degrees() + 135.0).abs() < 1e-9);
    assert_eq!(wide.odometry.stamp.to_string(), "7.500000000", "if the sender's clock is 0, the logger's is used");
}

#[test]
fn damaged_lines_are_skipped_and_reported_and_other_files_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let good = front_laser("0 0 0 0 0 0", "1");
    let cut = &good[..40];
    let (reported, _) = converted(folder.path(), format!("{good}\nFLASER 12 1 2 x\n\u{1}\u{2}\n{cut}").as_bytes(), &[]);
    assert!(reported.contains("3 damaged lines skipped") && reported.contains("in.clf:2: a range is `x`"), "{reported}");

    let failure = |name: &str, text: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        program::failure(&["convert", path.to_str().unwrap(), folder.path().join("o.bag").to_str().unwrap()], 1)
    };
    assert!(failure("empty.clf", b"# nothing\n").contains("has no data"));
    let cut = failure("cut.clf", cut.as_bytes());
    assert!(cut.contains("cut.clf:1: the line ends before") && cut.contains("remove it"), "{cut}");
    let negative = failure("negative.clf", front_laser("0 0 0 0 0 0", "-3").as_bytes());
    assert!(negative.contains("the stamp is -3.0"), "{negative}");
    assert!(failure("a.bag", b"#ROSBAG V2.0\n\x01\x02 what").contains("is a bag already"));
    assert!(failure("broken.bz2", b"BZh9 this is no archive").contains("cannot read"));
    assert!(program::failure(&["convert", "no/such.clf", "x.bag"], 1).contains("no/such.clf"));
    program::failure(&["convert", "a.clf", "x.bag", "--fov", "0"], 2);
}

#[test]
fn compressed_logs_give_the_same_bag() {
    let folder = tempfile::tempdir().unwrap();
    let (_, plain) = converted(folder.path(), log().as_bytes(), &[]);
    let plain = fs::read(plain).unwrap();
    let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::best());
    encoder.write_all(log().as_bytes()).unwrap();
    let (_, packed) = converted(folder.path(), &encoder.finish().unwrap(), &[]);
    assert!(fs::read(packed).unwrap() == plain);
}

#[test]
fn gzip_logs_are_recognised_by_content() {
    let folder = tempfile::tempdir().unwrap();
    let (_, plain) = converted(folder.path(), log().as_bytes(), &[]);
    let plain = fs::read(plain).unwrap();
    let (_, packed) = converted(folder.path(), &gzip(log().as_bytes()), &[]);
    assert!(fs::read(packed).unwrap() == plain);
    if let Some(log) = crate::common::shared("cases/plain.log.gz") {
        let (reported, _) = converted(folder.path(), &fs::read(log).unwrap(), &[]);
        assert!(reported.contains("100 scans"), "{reported}");
    }
}

/// A gzip file of stored blocks (RFC 1951, 1952), made without the library that reads it.
fn gzip(bytes: &[u8]) -> Vec<u8> {
    let crc = !bytes.iter().fold(!0_u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ (0xEDB8_8320 & (crc & 1).wrapping_neg()))
    });
    let len = u16::try_from(bytes.len()).unwrap();
    let header = [0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 3, 1];
    let lengths = [len.to_le_bytes(), (!len).to_le_bytes()].concat();
    [&header[..], &lengths, bytes, &crc.to_le_bytes(), &u32::from(len).to_le_bytes()].concat()
}

#[test]
fn raw_laser_lines_are_scans_without_poses() {
    let folder = tempfile::tempdir().unwrap();
    let line = |time: f64| format!("RAWLASER1 0 -1.0 2.2 0.2 50.0 0.01 0 12 {RANGES} 0 {time} host {time}");
    let alone = [line(10.0), line(10.2)].join("\n");
    let (reported, bag) = converted(folder.path(), alone.as_bytes(), &[]);
    assert!(reported.contains("2 scans") && reported.contains("the scans carry no poses"), "{reported}");
    let scan = &messages::<LaserScan>(&bag, "/scan")[1];
    assert_eq!((scan.angle_min, scan.ranges.len(), scan.header.stamp), (-1.0, 12, Time { sec: 10, nsec: 200_000_000 }));
    assert!((scan.angle_increment - 0.2).abs() < 1e-6 && scan.range_max < 50.0, "{scan:?}");
    assert_eq!(messages::<Odometry>(&bag, "/odom").len(), 0, "without poses there must be no odometry");
    // ODOM lines are used; and if some scans have poses, those without are left out.
    let (_, bag) = converted(folder.path(), format!("{alone}\nODOM 1 0 0 0.5 0 0 10.1 host 1").as_bytes(), &[]);
    assert_eq!(messages::<Odometry>(&bag, "/odom").len(), 1);
    let (reported, _) = converted(folder.path(), format!("{alone}\n{}", front_laser("0 0 0 0 0 0", "1")).as_bytes(), &[]);
    assert!(reported.contains("1 scans") && reported.contains("2 RAWLASER1"), "{reported}");
    if let Some(log) = crate::common::shared("cases/rawlaser.log") {
        let (reported, bag) = converted(folder.path(), &fs::read(log).unwrap(), &[]);
        assert!(reported.contains("100 scans"), "{reported}");
        assert_eq!((messages::<LaserScan>(&bag, "/scan").len(), messages::<Odometry>(&bag, "/odom").len()), (100, 100));
    }
}

proptest! {
    /// Bytes of a log are overwritten, dropped and duplicated.
    #[test]
    fn no_mutation_panics(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0_u8..4), 1..20),
        word in prop::sample::select(vec!["nan", "inf", "-1", "1e308", "99999999999999999999", "", "-", "ODOM", "FLASER 10000"]),
    ) {
        let mut bytes = log().into_bytes();
        for (place, byte, kind) in changes {
            if bytes.is_empty() {
                break;
            }
            let at = place.index(bytes.len());
            match kind {
                0 => bytes[at] = byte,
                1 => drop(bytes.drain(at..(at + usize::from(byte)).min(bytes.len() - 1).max(at))),
                2 => bytes.extend_from_within(at..),
                _ => drop(bytes.splice(at..=at, word.bytes())),
            }
            bytes.truncate(20_000);
        }
        if let Ok(log) = CarmenLog::parse(&String::from_utf8_lossy(&bytes), Path::new("mutated.clf"), None) {
            let _ = log.mount();
            let stamps = log.scans.iter().map(|scan| scan.odometry.stamp);
            prop_assert!(stamps.is_sorted());
        }
    }
}

#[test]
fn the_intel_log_becomes_the_same_bag_as_by_another_converter() {
    let (Some(log), Some(theirs)) =
        (crate::common::shared("data/intel/intel.clf.bz2"), crate::common::shared("data/intel/intel.bag"))
    else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let ours = folder.path().join("intel.bag").to_str().unwrap().to_owned();
    success(&["convert", log.to_str().unwrap(), &ours]);
    let theirs = theirs.to_str().unwrap();
    let seconds = |time: Time| f64::from(time.sec) + 1e-9 * f64::from(time.nsec);

    let (scans, expected): (Vec<LaserScan>, Vec<LaserScan>) = (messages(&ours, "/scan"), messages(theirs, "/scan"));
    assert_eq!((scans.len(), expected.len()), (13_631, 13_631));
    let mut converter = ScanConverter::default();
    for (scan, expected) in scans.iter().zip(&expected) {
        assert!((seconds(scan.header.stamp) - seconds(expected.header.stamp)).abs() < 1e-6, "{:?}", scan.header);
        assert_eq!((&scan.ranges, scan.angle_min.to_bits()), (&expected.ranges, expected.angle_min.to_bits()));
        assert!((scan.angle_increment - expected.angle_increment).abs() + (scan.angle_max - expected.angle_max).abs() < 1e-6);
        let mut valid = |scan| converter.convert(scan, false).unwrap().valid_len();
        assert_eq!(valid(scan), valid(expected));
    }
    let (odometry, expected): (Vec<Odometry>, Vec<Odometry>) = (messages(&ours, "/odom"), messages(theirs, "/odom"));
    assert_eq!(odometry.len(), expected.len());
    for (odometry, expected) in odometry.iter().zip(&expected) {
        let (here, there) = (&odometry.pose.pose, &expected.pose.pose);
        assert!((here.position.x - there.position.x).abs() + (here.position.y - there.position.y).abs() < 1e-9);
        assert!((here.orientation.yaw() - there.orientation.yaw()).abs() < 1e-9);
        assert!((seconds(odometry.header.stamp) - seconds(expected.header.stamp)).abs() < 1e-6);
    }
}
