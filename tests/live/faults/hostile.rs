//! Invalid and absurd messages, with limited memory.

use std::io::Write;
use std::time::Instant;

use anytime_scan_matcher::messages::geometry_msgs::TransformStamped;
use anytime_scan_matcher::messages::own::Contract;
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;
use anytime_scan_matcher::messages::{Message, Time, decode, encode};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rosrust::RosMsg as _;
use rosrust_msg::diagnostic_msgs::DiagnosticArray;

use super::bench::{Bench, send};
use crate::common::drive::{self, EndlessScan, at, header};
use crate::common::wire::{Listener, Publisher, frame};

/// Address space of the node, kB.
const LIMIT: u32 = 512 * 1024;

/// Mutates the bytes of a message.
fn mutate(mut bytes: Vec<u8>, rng: &mut Pcg64) -> Vec<u8> {
    let place = rng.random_range(0..bytes.len());
    let word = |value: u32, bytes: &mut Vec<u8>| {
        let start = place.min(bytes.len() - 4);
        bytes[start..start + 4].copy_from_slice(&value.to_le_bytes());
    };
    match rng.random_range(0..6) {
        0 => bytes.truncate(place),
        1 => bytes.extend((0..place % 64).map(|_| rng.random::<u8>())),
        2 => word([0, u32::MAX, 1 << 31, 1 << 24, 0x7f80_0000][place % 5], &mut bytes),
        3 => bytes[place..].chunks_exact_mut(4).for_each(|four| four.copy_from_slice(&f32::NAN.to_le_bytes())),
        4 => word(rng.random(), &mut bytes),
        _ => (0..=place % 20).for_each(|_| {
            let place = rng.random_range(0..bytes.len());
            bytes[place] ^= 1 << rng.random_range(0..8);
        }),
    }
    bytes
}

/// Sends `count` mutations of `message`; returns how many of them are invalid.
fn flood<T: Message>(bench: &Bench, topic: &'static str, message: &T, count: u32) -> u32 {
    let mut stream = Publisher::new::<T>(&bench.graph, &format!("/mad{}", topic.replace('/', "_")), topic).link();
    let (good, mut rng) = (encode(message).unwrap(), Pcg64::seed_from_u64(topic.len() as u64));
    let mut bad = 0;
    for _ in 0..count {
        let bytes = mutate(good.clone(), &mut rng);
        bad += u32::from(decode::<T>(&bytes).is_err());
        stream.write_all(&frame(&bytes)).unwrap();
    }
    bad
}

fn transform() -> TFMessage {
    let mut transform =
        TransformStamped { header: header(0.0, "base_link"), child_frame_id: "laser".into(), ..Default::default() };
    transform.transform.rotation.w = 1.0;
    TFMessage { transforms: vec![transform] }
}

/// The number of messages that the node has rejected.
fn refused(diagnostics: &mut Listener) -> u32 {
    let array = DiagnosticArray::decode(&diagnostics.next_bytes().unwrap()[..]).unwrap();
    array.status[0].values.iter().find(|entry| entry.key == "messages refused").unwrap().value.parse().unwrap()
}

#[test]
fn twenty_thousand_mutated_messages_do_not_affect_the_next_valid_one() {
    let Some(mut bench) = Bench::start_with_limit(181, LIMIT) else { return };
    bench.step();
    let mut diagnostics = Listener::new(&bench.graph, "/diagnostics");
    let (start, each) = (Instant::now(), 5000);
    let scan = bench.next_scan();
    let bad = flood(&bench, "/scan", &scan, each);
    let contract = Contract { header: header(0.0, ""), ..Contract::default() };
    let bad_events = flood(&bench, "/odom", &drive::odometry(0.0), each)
        + flood(&bench, "/icp_contract", &contract, each)
        + flood(&bench, "/tf", &transform(), each);
    assert!(bad > 1000 && bad_events > 3000, "{bad} {bad_events}");
    send(&mut Publisher::new::<Contract>(&bench.graph, "/sane", "/icp_contract").link(), &contract);
    std::thread::sleep(std::time::Duration::from_secs(1)); // the contract uses another connection

    let (_, report) = bench.step();
    assert!(bench.node.is_running(), "{report:?}: {}", bench.node.log());
    assert!((0..30).any(|_| refused(&mut diagnostics) > 1000), "{}", bench.node.log());
    let seconds = usize::try_from(start.elapsed().as_secs()).unwrap() + 2;
    for topic in ["scan", "odom", "icp_contract", "/tf"] {
        let logged = bench.node.log().matches(&format!("/scan_matcher: {topic}: message from")).count();
        // For scans, other warnings may have come first.
        let least = usize::from(topic != "scan");
        assert!((least..=seconds).contains(&logged), "{topic}: {logged} times in {seconds} s");
    }
    // Odometry and scans may have moved the estimate anywhere; from here on it matches again.
    assert!((0..40).any(|_| bench.step().1.ok), "{}", bench.node.log());
    eprintln!("{:?}", bench.resources());
}

#[test]
fn absurd_lengths_only_close_the_connection() {
    let Some(mut bench) = Bench::start_with_limit(181, LIMIT) else { return };
    bench.step();
    for length in [u32::MAX, 1 << 31, (32 << 20) + 1] {
        bench.scans.write_all(&length.to_le_bytes()).unwrap();
        bench.scans = bench.lidar.link();
        bench.check_step();
    }
    bench.node.expect_log(&format!("it announced a message of {} bytes", u32::MAX));
    send(&mut bench.scans, &EndlessScan::new(1, 0.1));
    bench.node.expect_log("scan: message from /lidar rejected"); // before a newer one replaces it
    bench.check_step();
    let mut diagnostics = Listener::new(&bench.graph, "/diagnostics");
    assert_eq!((0..5).map(|_| refused(&mut diagnostics)).max(), Some(4));
}

#[test]
fn odd_scans_and_stamps_are_answered_and_the_next_valid_scan_is_matched() {
    let Some(mut bench) = Bench::start_with_limit(181, LIMIT) else { return };
    bench.step();
    let good = bench.next_scan();
    let with_ranges = |ranges: Vec<f32>, stamp: f64| LaserScan { ranges, header: header(stamp, "laser"), ..good.clone() };
    let million = {
        let increment = good.angle_increment * 180.0 / 1e6;
        LaserScan { angle_increment: increment, ..with_ranges(vec![2.0; 1_000_000], 0.05) }
    };
    for odd in [
        with_ranges(Vec::new(), 0.03),
        with_ranges(vec![f32::NAN; 181], 0.031),
        with_ranges(vec![f32::INFINITY; 181], 0.032),
        with_ranges(vec![-1.0; 181], 0.033),
        with_ranges(vec![f32::MAX; 181], 0.034),
        LaserScan { angle_increment: f32::NAN, ..with_ranges(good.ranges.clone(), 0.035) },
        LaserScan { angle_min: f32::MAX, ..with_ranges(good.ranges.clone(), 0.036) },
        LaserScan { time_increment: 1e30, scan_time: f32::NAN, ..with_ranges(good.ranges.clone(), 0.037) },
        million,
    ] {
        let start = Instant::now();
        let (pose, report) = bench.answer(&odd);
        assert!(pose.is_finite(), "{pose:?}");
        eprintln!("{} beams: {:?}, {}", odd.ranges.len(), start.elapsed(), report.reason);
    }
    for stamp in
        [Time { sec: 0, nsec: 0 }, Time { sec: u32::MAX, nsec: 999_999_999 }, at(-100.0).into(), at(1e6).into(), at(0.05).into()]
    {
        let mut scan = good.clone();
        scan.header.stamp = stamp;
        let (pose, _) = bench.answer(&scan);
        assert!(pose.is_finite(), "{pose:?}");
    }
    assert!((0..40).any(|_| bench.step().1.ok), "{}", bench.node.log());
    eprintln!("{:?}", bench.resources());
}
