//! Latency of an interrupt through shared memory: from the controller's request until it has read the answer.
//!
//! Criterion reports means over many requests. A controller depends on the quantiles of single requests, which are printed after each.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use std::hint;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anytime_scan_matcher::shared_memory::{Client, Responder, SharedEstimate};
use criterion::{Criterion, criterion_group, criterion_main};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Maximum number of slices of work on a scan: about the period of a 40 Hz laser.
const SLICES: u32 = 300;
/// Timeout for an answer.
const TIMEOUT: Duration = Duration::from_secs(10);

fn spin_for(time: Duration) {
    let start = Instant::now();
    while start.elapsed() < time {
        hint::spin_loop();
    }
}

/// Works on one scan after the other, and checks for requests after every slice.
fn work(responder: &Responder, slice: Duration, stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        responder.begin();
        for _ in 0..SLICES {
            spin_for(slice);
            if responder.is_requested() {
                break;
            }
        }
        responder.publish(&SharedEstimate::default());
    }
}

fn bench_requests(criterion: &mut Criterion, name: &str, slice: Option<Duration>) {
    let segment = format!("/anytime_scan_matcher_bench_{}", std::process::id());
    let responder = Responder::create(&segment).unwrap();
    responder.publish(&SharedEstimate::default());
    let client = Client::open(&segment).unwrap();
    let mut rng = Pcg64::seed_from_u64(15);
    let mut latencies = Vec::new();
    let stop = AtomicBool::new(false);
    thread::scope(|scope| {
        if let Some(slice) = slice {
            let (responder, stop) = (&responder, &stop);
            scope.spawn(move || work(responder, slice, stop));
        }
        criterion.bench_function(name, |bencher| {
            bencher.iter_custom(|iterations| {
                (0..iterations)
                    .map(|_| {
                        // At a random time within a slice, and not before the other side has gone to sleep.
                        thread::sleep(Duration::from_micros(rng.random_range(50..300)));
                        let start = Instant::now();
                        let request = client.request();
                        client.wait_for_answer(request, TIMEOUT).unwrap();
                        let latency = start.elapsed();
                        latencies.push(latency);
                        latency
                    })
                    .sum()
            });
        });
        stop.store(true, Ordering::Relaxed);
    });
    latencies.sort();
    let quantile = |percent: usize| latencies[(latencies.len() - 1) * percent / 100];
    let count = latencies.len();
    println!("{name}: {count} requests: median {:?}, p90 {:?}, p99 {:?}\n", quantile(50), quantile(90), quantile(99));
}

fn benches(criterion: &mut Criterion) {
    bench_requests(criterion, "interrupt/idle", None);
    for microseconds in [20, 80] {
        let name = format!("interrupt/slices_of_{microseconds}_us");
        bench_requests(criterion, &name, Some(Duration::from_micros(microseconds)));
    }
}

criterion_group! {
    name = all;
    config = Criterion::default().sample_size(50).measurement_time(Duration::from_secs(3)).warm_up_time(Duration::from_secs(1));
    targets = benches
}
criterion_main!(all);
