//! Bags: written messages are read back, rosbag agrees, and damage is tolerated and reported.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use anytime_scan_matcher::io::bag::summary::BagSummary;
use anytime_scan_matcher::io::bag::{Bag, BagError, BagMessage, BagWriter, Compression};
use anytime_scan_matcher::messages::geometry_msgs::TransformStamped;
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use anytime_scan_matcher::messages::std_msgs::Header;
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;
use anytime_scan_matcher::messages::{self, Message};
use anytime_scan_matcher::time::Stamp;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::common::program::success;
use crate::common::shared;
use crate::common::skipped::skip;

const START: u32 = 1_700_000_000;

fn scan(stamp: Stamp, beams: u16) -> LaserScan {
    LaserScan {
        header: Header { seq: 0, stamp: stamp.into(), frame_id: "laser".into() },
        angle_min: -1.0,
        angle_max: -1.0 + 0.01 * f32::from(beams - 1),
        angle_increment: 0.01,
        range_max: 30.0,
        ranges: (0..beams).map(|i| 2.0 + f32::from(i % 17) / (1.0 + f32::from(i))).collect(),
        ..LaserScan::default()
    }
}

fn odometry(stamp: Stamp) -> Odometry {
    let mut odometry = Odometry { child_frame_id: "base_link".into(), ..Odometry::default() };
    odometry.header = Header { seq: 0, stamp: stamp.into(), frame_id: "odom".into() };
    odometry.pose.pose.orientation.w = 1.0;
    odometry
}

fn tf_static(stamp: Stamp) -> TFMessage {
    let header = Header { seq: 0, stamp: stamp.into(), frame_id: "base_link".into() };
    TFMessage { transforms: vec![TransformStamped { header, child_frame_id: "laser".into(), ..TransformStamped::default() }] }
}

/// Scans at 40 Hz, odometry at 50 Hz, interleaved as by a recorder; one mount pose.
fn write_drive(writer: &mut BagWriter, scans: u32, beams: u16) {
    writer.write_latched("/tf_static", Stamp::from_ros(START, 0), &tf_static(Stamp::from_ros(START, 0))).unwrap();
    for i in 0..scans {
        let stamp = Stamp::from_ros(START, 1).offset_by(f64::from(i) * 0.025);
        writer.write("/scan", stamp, &scan(stamp, beams)).unwrap();
        let stamp = Stamp::from_ros(START, 1).offset_by(f64::from(i) * 0.02);
        writer.write("/odom", stamp, &odometry(stamp)).unwrap();
    }
}

fn write_bag(path: &Path, compression: Compression, scans: u32, beams: u16) {
    let mut writer = BagWriter::create(path, compression).unwrap();
    write_drive(&mut writer, scans, beams);
    writer.finish().unwrap();
}

/// Time, topic and bytes of every message.
fn read_all(bag: &Bag) -> Vec<(Stamp, String, Vec<u8>)> {
    bag.messages(None).map(|message| message.unwrap()).map(|m| (m.time, m.connection.topic.clone(), m.data)).collect()
}

fn scratch() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

#[test]
fn every_compression_returns_the_messages_in_time_order() {
    let dir = scratch();
    for &compression in Compression::ALL {
        let path = dir.path().join("a.bag");
        write_bag(&path, compression, 1000, 1081);
        let bag = Bag::open(&path).unwrap();
        assert_eq!(*bag.problems(), []);
        assert!(bag.compressions()[0].1 > 1, "several chunks");
        assert_eq!(bag.compressions(), [(compression, bag.compressions()[0].1)]);
        assert_eq!((bag.message_count(None), bag.message_count(Some(&["/scan"]))), (2001, 1000));
        let all = read_all(&bag);
        assert_eq!(all.len(), 2001);
        assert!(all.is_sorted_by_key(|(time, ..)| *time));
        for (i, message) in bag.messages(Some(&["/scan"])).enumerate() {
            let message = message.unwrap();
            let stamp = Stamp::from_ros(START, 1).offset_by(i as f64 * 0.025);
            assert_eq!((message.time, message.decode::<LaserScan>().unwrap()), (stamp, scan(stamp, 1081)));
        }
    }
}

/// What rosbag itself reads from a bag: time in ns, topic, type and CRC-32 of each message, sorted. `None` if rosbag is not installed.
fn listing_of_rosbag(path: &Path) -> Option<Vec<String>> {
    const SCRIPT: &str = "
import sys, zlib, rosbag
for topic, (kind, data, md5, position, message), time in rosbag.Bag(sys.argv[1]).read_messages(raw=True):
    message().deserialize(data)
    print(time.to_nsec(), topic, kind, zlib.crc32(data))";
    let python = |script| Command::new("/usr/bin/python3").args(["-c", script]).arg(path).output().ok();
    if !python("import rosbag").is_some_and(|output| output.status.success()) {
        skip("/usr/bin/python3 has no rosbag module");
        return None;
    }
    let output = python(SCRIPT)?;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let mut lines: Vec<String> = String::from_utf8(output.stdout).unwrap().lines().map(Into::into).collect();
    lines.sort();
    Some(lines)
}

fn listing(bag: &Bag) -> Vec<String> {
    let line = |m: BagMessage| {
        let crc = crc32(&m.data);
        format!("{} {} {} {crc}", m.time.nanoseconds(), m.connection.topic, m.connection.message_type)
    };
    let mut lines: Vec<String> = bag.messages(None).map(|message| line(message.unwrap())).collect();
    lines.sort();
    lines
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes
        .iter()
        .fold(!0, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ (0xEDB8_8320 & (crc & 1).wrapping_neg())))
}

#[test]
fn rosbag_reads_the_same_from_the_bags_written_here() {
    let dir = scratch();
    for &compression in Compression::ALL {
        let path = dir.path().join(format!("{}.bag", compression.name()));
        write_bag(&path, compression, 400, 1081);
        let Some(expected) = listing_of_rosbag(&path) else { return };
        assert_eq!(expected.len(), 801);
        assert_eq!(listing(&Bag::open(&path).unwrap()), expected);
        for tool in [["info"].as_slice(), &["check"], &["decompress", "-q"], &["reindex", "-q"]] {
            let output = Command::new("rosbag").args(tool).arg(&path).output().unwrap();
            assert!(output.status.success(), "rosbag {tool:?}: {}", String::from_utf8_lossy(&output.stderr));
        }
        assert_eq!(listing(&Bag::open(&path).unwrap()), expected, "after rosbag worked on the file");
    }
}

/// The real logs beside the checkout, if available.
fn real_bags() -> Vec<(PathBuf, u64, u64, Compression)> {
    let bags = [
        ("fr079/fr079.bag", 4934, 8951, Compression::Lz4),
        ("aces/aces.bag", 7374, 7375, Compression::None),
        ("intel/intel.bag", 13631, 13631, Compression::Bz2),
    ];
    let Some(folder) = shared("data") else { return Vec::new() };
    bags.map(|(path, scans, odometry, compression)| (folder.join(path), scans, odometry, compression)).into()
}

#[test]
fn real_logs_read_as_rosbag_reads_them() {
    for (path, scans, odometry, compression) in real_bags() {
        let bag = Bag::open(&path).unwrap();
        assert_eq!(*bag.problems(), []);
        assert_eq!(bag.compressions()[0].0, compression);
        assert_eq!(bag.message_count(Some(&["/scan"])), scans);
        assert_eq!(bag.message_count(Some(&["/odom"])), odometry);
        let times: Vec<Stamp> = bag.messages(None).map(|message| message.unwrap().time).collect();
        assert!(times.is_sorted());
        for message in bag.messages(Some(&["/scan"])) {
            message.unwrap().decode::<LaserScan>().unwrap();
        }
        if let Some(expected) = listing_of_rosbag(&path) {
            assert_eq!(listing(&bag), expected);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Messages of any size at any time on any of three topics are read back by time; equal times in the order of writing.
    #[test]
    fn round_trip(
        compression in proptest::sample::select(Compression::ALL),
        messages in proptest::collection::vec((0..3_usize, 1..50_u32, 1..9000_u16), 0..200),
    ) {
        let dir = scratch();
        let path = dir.path().join("a.bag");
        let mut writer = BagWriter::create(&path, compression).unwrap();
        let mut expected = Vec::new();
        for &(topic, seconds, beams) in &messages {
            let topic = ["/scan", "/front/scan", "/rear/scan"][topic];
            let stamp = Stamp::from_ros(seconds, 7);
            let message = scan(stamp, beams);
            writer.write(topic, stamp, &message).unwrap();
            expected.push((stamp, topic.to_string(), messages::encode(&message).unwrap()));
        }
        writer.finish().unwrap();
        expected.sort_by_key(|(stamp, ..)| *stamp);
        let bag = Bag::open(&path).unwrap();
        prop_assert_eq!(&*bag.problems(), &[]);
        prop_assert_eq!(bag.message_count(None), expected.len() as u64);
        prop_assert!(read_all(&bag) == expected);
    }
}

#[test]
fn the_same_messages_give_the_same_bytes() {
    let dir = scratch();
    let write = |name| {
        write_bag(&dir.path().join(name), Compression::Lz4, 300, 541);
        fs::read(dir.path().join(name)).unwrap()
    };
    assert!(write("a.bag") == write("b.bag"));
}

#[test]
fn topics_and_types_are_recorded() {
    let dir = scratch();
    let path = dir.path().join("a.bag");
    write_bag(&path, Compression::None, 10, 100);
    let bag = Bag::open(&path).unwrap();
    let latching: BTreeMap<&str, bool> = bag.connections().iter().map(|c| (c.topic.as_str(), c.latching)).collect();
    assert_eq!(latching, BTreeMap::from([("/odom", false), ("/scan", false), ("/tf_static", true)]));
    let scan = bag.connections().iter().find(|c| c.topic == "/scan").unwrap();
    assert_eq!((scan.message_type.as_str(), scan.md5.as_str()), (LaserScan::TYPE, LaserScan::definition().md5.as_str()));
    assert_eq!(scan.definition, LaserScan::definition().text);
    assert_eq!(bag.topics_of::<LaserScan>(), ["/scan"]);
    assert_eq!(bag.span(), Some((Stamp::from_ros(START, 0), Stamp::from_ros(START, 1).offset_by(9.0 * 0.025))));
}

#[test]
fn an_unfinished_bag_returns_all_its_messages() {
    let dir = scratch();
    for &compression in Compression::ALL {
        let (whole, left) = (dir.path().join("whole.bag"), dir.path().join("left.bag"));
        write_bag(&whole, compression, 400, 1081);
        write_drive(&mut BagWriter::create(&left, compression).unwrap(), 400, 1081);
        let bag = Bag::open(&left).unwrap();
        assert!(read_all(&bag) == read_all(&Bag::open(&whole).unwrap()));
        let problem = bag.problems()[0].to_string();
        assert!(problem.contains("was not closed") && problem.contains("rosbag reindex"), "{problem}");
    }
}

/// `rosbag record` fills in the lengths of a chunk when it is full. If it is killed, the lengths of the last chunk are zero.
#[test]
fn the_unfinished_last_chunk_is_read() {
    let dir = scratch();
    let path = dir.path().join("a.bag");
    for (compression, readable) in [(Compression::None, 40..=40), (Compression::Lz4, 20..=40), (Compression::Bz2, 0..=40)] {
        write_bag(&path, compression, 20, 1081);
        let whole = read_all(&Bag::open(&path).unwrap());
        let mut bytes = fs::read(&path).unwrap();
        let header = position(&bytes, b"index_pos=", 0) + 10;
        bytes[header..header + 8].fill(0);
        let size = position(&bytes, b"size=", 4117) + 5;
        let packed = u32::from_le_bytes(bytes[size + 4..size + 8].try_into().unwrap()) as usize;
        bytes[size..size + 8].fill(0);
        bytes.truncate(size + 8 + packed - 100);
        fs::write(&path, bytes).unwrap();
        let bag = Bag::open(&path).unwrap();
        let found = read_all(&bag);
        assert!(readable.contains(&found.len()), "{}: {} messages", compression.name(), found.len());
        assert!(found.iter().all(|message| whole.contains(message)));
        assert!(bag.problems().iter().any(|problem| problem.what.contains("ends inside a chunk") && problem.bytes_lost > 0));
    }
}

fn position(bytes: &[u8], pattern: &[u8], from: usize) -> usize {
    from + bytes[from..].windows(pattern.len()).position(|window| window == pattern).unwrap()
}

#[test]
fn a_truncated_bag_returns_the_rest_and_reports_the_loss() {
    let dir = scratch();
    let (path, cut) = (dir.path().join("a.bag"), dir.path().join("cut.bag"));
    let mut random = Pcg64::seed_from_u64(1);
    let kinds = Compression::ALL.iter().flat_map(|&compression| [(compression, 400, 1081, 12), (compression, 15, 30, 400)]);
    for (compression, scans, beams, cuts) in kinds {
        write_bag(&path, compression, scans, beams);
        let bytes = fs::read(&path).unwrap();
        let whole = read_all(&Bag::open(&path).unwrap());
        for _ in 0..cuts {
            let len = random.random_range(13..bytes.len());
            fs::write(&cut, &bytes[..len]).unwrap();
            let bag = Bag::open(&cut).unwrap();
            let found = read_all(&bag);
            assert!(found.is_sorted_by_key(|(time, ..)| *time));
            let mut rest = whole.iter();
            assert!(found.iter().all(|message| rest.any(|other| other == message)), "a message that was never written");
            assert_ne!(*bag.problems(), [], "cut at {len} of {}: not reported", bytes.len());
            if compression == Compression::None && bytes.len() < 100_000 {
                let complete = whole.iter().filter(|(_, _, data)| position(&bytes, data, 0) + data.len() <= len).count();
                assert_eq!(found.len(), complete, "cut at {len}");
            }
        }
    }
}

#[test]
fn damaged_bytes_never_panic() {
    let dir = scratch();
    let (path, damaged) = (dir.path().join("a.bag"), dir.path().join("damaged.bag"));
    let mut random = Pcg64::seed_from_u64(2);
    for &compression in Compression::ALL {
        write_bag(&path, compression, 3, 20);
        let bytes = fs::read(&path).unwrap();
        fs::copy(&path, &damaged).unwrap();
        // The padding of the bag header does not matter.
        let interesting: Vec<usize> = (0..100).chain(4110..bytes.len()).collect();
        for _ in 0..7000 {
            let mut bytes = bytes.clone();
            for _ in 0..random.random_range(1..5) {
                let at = interesting[random.random_range(0..interesting.len())];
                bytes[at] = if random.random() { random.random() } else { bytes[at] ^ (1 << random.random_range(0..8)) };
            }
            // Overwrite in place: truncating a file first makes some file systems wait for the disk.
            fs::OpenOptions::new().write(true).open(&damaged).unwrap().write_all(&bytes).unwrap();
            let Ok(bag) = Bag::open(&damaged) else { continue };
            for message in bag.messages(None) {
                let message = message.unwrap();
                let _ = (message.decode::<LaserScan>(), message.decode::<Odometry>(), message.decode::<TFMessage>());
            }
        }
    }
}

#[test]
fn a_damaged_chunk_is_skipped_and_reported() {
    let dir = scratch();
    let path = dir.path().join("a.bag");
    write_bag(&path, Compression::Lz4, 400, 1081);
    let whole = Bag::open(&path).unwrap().message_count(None);
    let mut bytes = fs::read(&path).unwrap();
    bytes[60_000..60_010].fill(0x55);
    fs::write(&path, &bytes).unwrap();
    let bag = Bag::open(&path).unwrap();
    let found = read_all(&bag).len() as u64;
    assert!(0 < found && found < whole);
    let problem = bag.problems()[0].to_string();
    assert!(problem.contains("at byte 4117") && problem.contains("damaged lz4 chunk"), "{problem}");
}

/// A chunk and a header that claim 4 GiB, in a file of a few KiB.
#[test]
fn absurd_lengths_are_reported_and_take_no_memory() {
    let dir = scratch();
    let path = dir.path().join("a.bag");
    write_bag(&path, Compression::Bz2, 3, 20);
    let bytes = fs::read(&path).unwrap();
    let size = position(&bytes, b"size=", 4117) + 5;
    for (at, reported) in [(size, "a chunk is too large"), (4117, "at most"), (13, "at most")] {
        let mut bytes = bytes.clone();
        bytes[at..at + 4].fill(0xff);
        fs::write(&path, &bytes).unwrap();
        let bag = Bag::open(&path).unwrap();
        assert_eq!(bag.messages(None).count(), 0);
        assert!(bag.problems().iter().any(|problem| problem.what.contains(reported)), "{:?}", bag.problems());
    }
}

/// All positions of a pattern.
fn positions(bytes: &[u8], pattern: &[u8]) -> Vec<usize> {
    (0..bytes.len().saturating_sub(pattern.len())).filter(|&at| bytes[at..].starts_with(pattern)).collect()
}

/// Changes each index record of a bag; `change` gets the positions of its count and of the length of its data.
fn with_index_records(path: &Path, mut change: impl FnMut(&mut [u8], usize)) {
    let mut bytes = fs::read(path).unwrap();
    for at in positions(&bytes, b"op=\x04") {
        change(&mut bytes, at);
    }
    fs::write(path, bytes).unwrap();
}

/// For an index record with `op=` at this position: the positions of its count and of the length of its data.
fn index_fields(bytes: &[u8], op: usize) -> (usize, usize) {
    let count = position(bytes, b"count=", op) + 6;
    (count, count + 4)
}

/// The recorder of 2010 wrote a length of 20 bytes for each entry of 12 bytes.
#[test]
fn index_records_are_read_by_their_count() {
    let dir = scratch();
    let path = dir.path().join("a.bag");
    write_bag(&path, Compression::None, 1000, 541);
    let whole = read_all(&Bag::open(&path).unwrap());
    with_index_records(&path, |bytes, op| {
        let (count, len) = index_fields(bytes, op);
        let count = u32::from_le_bytes(bytes[count..count + 4].try_into().unwrap());
        bytes[len..len + 4].copy_from_slice(&(20 * count).to_le_bytes());
    });
    let bag = Bag::open(&path).unwrap();
    assert!(bag.compressions()[0].1 > 1, "several chunks");
    assert_eq!(*bag.problems(), []);
    assert_eq!(bag.message_count(None), 2001);
    assert!(read_all(&bag) == whole);
}

#[test]
fn a_damaged_index_loses_no_chunk() {
    let dir = scratch();
    let path = dir.path().join("a.bag");
    let damages: [fn(&mut [u8], usize); 4] = [
        // Another version, an unknown connection, a wrong count, and a length that points outside the file.
        |bytes, op| bytes[position(bytes, b"ver=", op) + 4] = 9,
        |bytes, op| bytes[position(bytes, b"conn=", op)] = b'x',
        |bytes, op| bytes[index_fields(bytes, op).0] ^= 1,
        |bytes, op| {
            let (count, len) = index_fields(bytes, op);
            (bytes[count], bytes[len]) = (bytes[count] ^ 1, bytes[len] ^ 5);
        },
    ];
    for (i, damage) in damages.into_iter().enumerate() {
        write_bag(&path, Compression::None, 1000, 541);
        let whole = read_all(&Bag::open(&path).unwrap());
        with_index_records(&path, damage);
        let bag = Bag::open(&path).unwrap();
        assert!(read_all(&bag) == whole, "damage {i}: {:?}", bag.problems());
        assert_eq!(bag.message_count(None), 2001, "damage {i}");
    }
}

#[test]
fn a_connection_without_a_checksum_loses_nothing() {
    let dir = scratch();
    let path = dir.path().join("a.bag");
    write_bag(&path, Compression::None, 10, 100);
    let mut bytes = fs::read(&path).unwrap();
    for (from, to) in [(&b"md5sum="[..], &b"md5xxx="[..]), (b"type=tf2_msgs/TFMessage", b"type=xf2_msgs/TFMessage")] {
        for at in positions(&bytes, from) {
            bytes[at..at + from.len()].copy_from_slice(to);
        }
    }
    fs::write(&path, bytes).unwrap();
    let bag = Bag::open(&path).unwrap();
    assert_eq!((&*bag.problems(), bag.message_count(None)), (&[][..], 21));
    for message in bag.messages(Some(&["/scan"])) {
        message.unwrap().decode::<LaserScan>().unwrap();
    }
    // A type with another name is recognised by its definition.
    assert_eq!(bag.topics_of::<TFMessage>(), ["/tf_static"]);
    assert_eq!(bag.topics_of::<LaserScan>(), ["/scan"]);
}

#[test]
fn other_kinds_of_bags_are_identified_with_a_remedy() {
    let dir = scratch();
    let file = |name: &str, bytes: &[u8]| {
        fs::write(dir.path().join(name), bytes).unwrap();
        dir.path().join(name)
    };
    let reported = |path: &Path| Bag::open(path).err().unwrap().to_string();
    let old = reported(&file("old.bag", b"#ROSRECORD V1.2\n\x1e\0\0\0"));
    assert!(old.contains("version 1.2;") && old.contains("`rosbag fix"), "{old}");
    if let Some(path) = shared("cases/rosrecord_v1.2_as_published.bag") {
        assert!(reported(&path).contains("version 1.2; convert it to version 2.0 with `rosbag fix"));
    }
    let sqlite = reported(&file("a.db3", b"SQLite format 3\0 and so on"));
    let mcap = reported(&file("a.bag", b"\x89MCAP0\r\n"));
    file("metadata.yaml", b"rosbag2_bagfile_information:\n");
    let contents = reported(&dir.path().join("metadata.yaml"));
    let folder = reported(dir.path());
    for (reported, form) in [(sqlite, "SQLite"), (mcap, "MCAP"), (contents, "table of contents"), (folder, "metadata.yaml")] {
        assert!(reported.contains("ROS 2") && reported.contains(form) && reported.contains("rosbags-convert"), "{reported}");
    }
}

#[test]
fn files_that_are_not_bags_are_reported() {
    let dir = scratch();
    let path = dir.path().join("a.bag");
    let reported = |path: &Path| Bag::open(path).err().unwrap().to_string();
    let error_of = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        reported(&path)
    };
    assert!(error_of(b"").contains("a.bag is not a ROS 1 bag: it is empty"));
    assert!(error_of(b"#ROSBAG").contains("ends within its first line"));
    assert!(error_of(b"a text file, and not a short one").contains("does not begin with `#ROSBAG V2.0`"));
    assert!(error_of(b"SQLite format 3\0").contains("ROS 2"));
    assert!(error_of(b"#ROSBAG V1.2\n").contains("version 1.2"));
    assert!(reported(dir.path()).contains("it is a directory"));
    assert!(reported(&dir.path().join("none.bag")).contains("cannot open"));
}

#[test]
fn errors_for_missing_topics_and_wrong_types_list_the_alternatives() {
    let dir = scratch();
    let path = dir.path().join("a.bag");
    let mut writer = BagWriter::create(&path, Compression::None).unwrap();
    let stamp = Stamp::from_ros(START, 0);
    for topic in ["/base_scan", "/front/scan"] {
        writer.write(topic, stamp, &scan(stamp, 20)).unwrap();
    }
    writer.write("/odom", stamp, &odometry(stamp)).unwrap();
    writer.finish().unwrap();
    let bag = Bag::open(&path).unwrap();
    bag.expect_topic::<LaserScan>("/base_scan").unwrap();
    let reported = bag.expect_topic::<LaserScan>("/front/scn").unwrap_err().to_string();
    assert!(
        reported.ends_with("there is no topic /front/scn; topics with sensor_msgs/LaserScan: /front/scan, /base_scan"),
        "{reported}"
    );
    let reported = bag.expect_topic::<LaserScan>("/odom").unwrap_err().to_string();
    assert!(reported.ends_with("topic /odom carries nav_msgs/Odometry, but sensor_msgs/LaserScan is needed"), "{reported}");
    let reported = bag.expect_topic::<TFMessage>("/tf").unwrap_err().to_string();
    assert!(reported.ends_with("there is no topic /tf; no topic carries tf2_msgs/TFMessage"), "{reported}");
    let odometry = bag.messages(Some(&["/odom"])).next().unwrap().unwrap();
    assert!(matches!(odometry.decode::<LaserScan>(), Err(BagError::WrongType { .. })));
}

#[test]
fn messages_that_a_bag_cannot_store_are_rejected() {
    let dir = scratch();
    let path = dir.path().join("a.bag");
    let mut writer = BagWriter::create(&path, Compression::None).unwrap();
    let stamp = Stamp::from_ros(START, 0);
    for out_of_range in [Stamp::from_nanoseconds(0), Stamp::from_nanoseconds(-1), Stamp::from_nanoseconds(i64::MAX)] {
        assert!(matches!(writer.write("/scan", out_of_range, &scan(stamp, 20)), Err(BagError::Unwritable { .. })));
    }
    writer.write("/scan", stamp, &scan(stamp, 20)).unwrap();
    let reported = writer.write("/scan", stamp, &odometry(stamp)).unwrap_err().to_string();
    assert!(reported.ends_with("on /scan: the topic already carries sensor_msgs/LaserScan, not nav_msgs/Odometry"), "{reported}");
    writer.finish().unwrap();
    assert_eq!(Bag::open(&path).unwrap().message_count(None), 1);
}

fn decode_damaged<T: Message>(bytes: &[u8], random: &mut Pcg64) {
    for _ in 0..10_000 {
        let mut damaged = bytes.to_vec();
        for _ in 0..random.random_range(1..4) {
            let at = random.random_range(0..damaged.len());
            damaged[at] = random.random();
        }
        damaged.truncate(if random.random() { damaged.len() } else { random.random_range(0..=damaged.len()) });
        let _ = messages::decode::<T>(&damaged);
    }
}

#[test]
fn damaged_messages_never_panic_and_absurd_lengths_are_errors() {
    let mut random = Pcg64::seed_from_u64(3);
    let stamp = Stamp::from_ros(START, 0);
    let scan = messages::encode(&scan(stamp, 20)).unwrap();
    decode_damaged::<LaserScan>(&scan, &mut random);
    decode_damaged::<Odometry>(&messages::encode(&odometry(stamp)).unwrap(), &mut random);
    decode_damaged::<TFMessage>(&messages::encode(&tf_static(stamp)).unwrap(), &mut random);

    // The length of frame_id comes after seq and stamp, that of ranges after frame_id ("laser") and seven numbers.
    for length_at in [12, 16 + 5 + 7 * 4] {
        for absurd in [21, 1 << 16, u32::MAX] {
            let mut bytes = scan.clone();
            bytes[length_at..length_at + 4].copy_from_slice(&u32::to_le_bytes(absurd));
            assert!(messages::decode::<LaserScan>(&bytes).is_err());
        }
    }
    assert!(messages::decode::<LaserScan>(&scan[..scan.len() - 1]).is_err());
    assert!(messages::decode::<LaserScan>(&[scan.as_slice(), &[0]].concat()).is_err());
}

#[test]
fn the_summary_has_geometry_rates_and_problems() {
    let dir = scratch();
    let path = dir.path().join("a.bag");
    let mut writer = BagWriter::create(&path, Compression::Lz4).unwrap();
    write_drive(&mut writer, 100, 541);
    let late = Stamp::from_ros(START + 60, 0);
    let mut covered = scan(Stamp::from_ros(START, 5), 541);
    covered.ranges.fill(f32::NAN);
    writer.write("/scan", late, &covered).unwrap();
    let mut lost = odometry(late);
    lost.pose.pose.position.x = f64::NAN;
    writer.write("/odom", late, &lost).unwrap();
    writer.finish().unwrap();

    let summary = BagSummary::read(&Bag::open(&path).unwrap(), || ()).unwrap();
    assert_eq!(summary.messages, 203);
    let laser = &summary.lasers[0];
    assert_eq!((laser.beams, laser.usability.usable, laser.usability.unusable, laser.geometry_changes), (541, 100, 1, 0));
    assert!((laser.field_of_view_deg - 5.4_f64.to_degrees()).abs() < 1e-4 && laser.valid_percent > 99.9);
    let scans = summary.topics.iter().find(|topic| topic.topic == "/scan").unwrap();
    assert!((scans.rate_hz.unwrap() - 40.0).abs() < 1e-6 && scans.stamps_back == 1);
    let problems = summary.problems.join("\n");
    for reported in [
        "/scan: 1 of 101 stamps go back in time",
        "/odom: 1 gap, the longest 58.02 s",
        "/scan: 1 of 101 scans are unusable; the first: 0 of 541 rays have a measurement",
        "/odom: 1 poses are NaN or infinite",
    ] {
        assert!(problems.contains(reported), "{problems}");
    }
}

#[test]
fn info_prints_a_table_or_json() {
    let dir = scratch();
    let path = dir.path().join("a.bag");
    write_drive(&mut BagWriter::create(&path, Compression::Bz2).unwrap(), 50, 541);
    let info = |arguments: &[&str]| success(&[&["info", path.to_str().unwrap()], arguments].concat());
    let json: serde_json::Value = serde_json::from_str(&info(&["--json"])).unwrap();
    assert_eq!(json["messages"], 101);
    assert_eq!(json["lasers"][0]["beams"], 541);
    let table = info(&[]);
    for reported in ["sensor_msgs/LaserScan", "base_link", "was not closed", "rosbag reindex"] {
        assert!(table.contains(reported), "{table}");
    }
}
