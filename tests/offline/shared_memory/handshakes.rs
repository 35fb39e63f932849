//! Requests and answers within one process, under random timing.

use std::collections::HashSet;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;
use std::thread;
use std::time::Duration;

use anytime_scan_matcher::shared_memory::{Client, Counts, Problem, Responder};
use rand::SeedableRng;
use rand_pcg::Pcg64;

use super::node::{TIMEOUT, assert_whole, estimate, pause_randomly, unique, work};

/// Stops the node when the controllers are done, even if one of them fails.
struct StopAtEnd<'a>(&'a AtomicBool);

impl Drop for StopAtEnd<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Makes `count` requests and checks each answer; returns the numbers of the answers.
fn make_requests(client: &Client, count: u32, seed: u64) -> Vec<u32> {
    let mut rng = Pcg64::seed_from_u64(seed);
    let ask_once = |_| {
        pause_randomly(&mut rng, 20);
        let completed_before = client.counts().completed;
        let request = client.request();
        let answer = client.wait_for_answer(request, TIMEOUT).unwrap();
        if let Some(answer) = answer {
            assert_whole(&answer);
        }
        // Never older than the newest estimate at the time of the request.
        assert!(answer.map_or(0, |answer| answer.number) >= completed_before);
        request.0
    };
    (0..count).map(ask_once).collect()
}

/// Counts edges until the node is closed.
fn count_edges(client: &Client) -> u32 {
    let (mut seen, mut edges) = (0, 0);
    loop {
        match client.wait_for_completion(seen, TIMEOUT) {
            Ok(completed) => {
                edges += completed.wrapping_sub(seen);
                seen = completed;
            }
            Err(error) if matches!(error.problem, Problem::Closed) => return edges,
            Err(error) => panic!("{error}"),
        }
    }
}

#[test]
fn no_request_of_100_000_is_lost_or_answered_twice() {
    const REQUESTS: u32 = 100_000;
    let responder = Responder::create(&unique("handshakes")).unwrap();
    let client = Client::open(responder.name()).unwrap();
    let stop = AtomicBool::new(false);
    let (numbers, published) = thread::scope(|scope| {
        let node = scope.spawn(|| work(&responder, 1, &stop));
        let end = StopAtEnd(&stop);
        let numbers = make_requests(&client, REQUESTS, 2);
        drop(end);
        (numbers, node.join().unwrap())
    });
    assert!(numbers.into_iter().eq(1..=REQUESTS));
    assert_eq!(client.counts(), Counts { acknowledged: REQUESTS, requested: REQUESTS, completed: published });
}

#[test]
fn several_controllers_share_the_count_and_every_edge_is_seen() {
    const CLIENTS: u32 = 4;
    const REQUESTS: u32 = 2_000;
    let name = unique("controllers");
    let responder = Responder::create(&name).unwrap();
    let stop = AtomicBool::new(false);
    let open = || Client::open(&name).unwrap();
    let (clients, counting): (Vec<_>, _) = ((0..CLIENTS).map(|_| open()).collect(), open());
    thread::scope(|scope| {
        let end = StopAtEnd(&stop);
        let node_stop = &stop;
        let node = scope.spawn(move || work(&responder, 3, node_stop)); // and closes the segment
        let edges = scope.spawn(|| count_edges(&counting));
        let asking: Vec<_> =
            clients.iter().zip(4..).map(|(client, seed)| scope.spawn(move || make_requests(client, REQUESTS, seed))).collect();
        let numbers: HashSet<u32> = asking.into_iter().flat_map(|client| client.join().unwrap()).collect();
        drop(end);
        let (requests, published) = (CLIENTS * REQUESTS, node.join().unwrap());
        assert_eq!(numbers, (1..=requests).collect());
        assert_eq!(counting.counts(), Counts { acknowledged: requests, requested: requests, completed: published });
        assert_eq!(edges.join().unwrap(), published);
    });
}

/// One scan and one request per round, with random timing: a request that were lost between the two answers would never be answered by a later
/// scan.
#[test]
fn no_request_is_lost_between_an_answer_and_idleness() {
    const ROUNDS: u32 = 30_000;
    let responder = Responder::create(&unique("rounds")).unwrap();
    let client = Client::open(responder.name()).unwrap();
    let (start, started) = sync_channel(0);
    thread::scope(|scope| {
        let responder = &responder;
        scope.spawn(move || {
            let mut rng = Pcg64::seed_from_u64(5);
            for number in started {
                responder.begin();
                pause_randomly(&mut rng, 20);
                responder.publish(&estimate(number));
            }
        });
        let mut rng = Pcg64::seed_from_u64(6);
        for round in 1..=ROUNDS {
            start.send(round).unwrap();
            pause_randomly(&mut rng, 40);
            let answer = client.wait_for_answer(client.request(), TIMEOUT).unwrap();
            assert!(answer.is_none_or(|answer| answer.number <= round), "an answer from the future");
            assert_eq!(client.counts().acknowledged, round);
        }
        drop(start);
    });
    assert_eq!(client.counts(), Counts { acknowledged: ROUNDS, requested: ROUNDS, completed: ROUNDS });
}

#[test]
fn an_idle_node_answers_every_request() {
    const REQUESTS: u32 = 10_000;
    let responder = Responder::create(&unique("idle")).unwrap();
    let clients = [(); 2].map(|()| Client::open(responder.name()).unwrap());
    thread::scope(|scope| {
        for (client, seed) in clients.iter().zip(7..) {
            scope.spawn(move || make_requests(client, REQUESTS, seed));
        }
    });
    assert_eq!(clients[0].counts(), Counts { acknowledged: 2 * REQUESTS, requested: 2 * REQUESTS, completed: 0 });
}

/// The request before each scan wakes the node's watcher, which may run only after the scan has begun.
#[test]
fn a_request_during_a_scan_is_not_answered_by_an_older_one() {
    const SCANS: u32 = 10_000;
    let responder = Responder::create(&unique("older")).unwrap();
    let client = Client::open(responder.name()).unwrap();
    let ((begin, begun), (answer, answered)) = (sync_channel(0), sync_channel(1));
    thread::scope(|scope| {
        let client = &client;
        scope.spawn(move || {
            for () in begun {
                answer.send(client.wait_for_answer(client.request(), TIMEOUT).unwrap()).unwrap();
            }
        });
        for scan in 1..=SCANS {
            client.request();
            responder.begin();
            begin.send(()).unwrap();
            while !responder.is_requested() {
                assert!(answered.try_recv().is_err(), "answered before scan {scan} was");
                thread::yield_now();
            }
            responder.publish(&estimate(scan));
            assert_eq!(answered.recv().unwrap().unwrap().number, scan);
        }
        drop(begin);
    });
    assert_eq!(client.counts(), Counts { acknowledged: 2 * SCANS, requested: 2 * SCANS, completed: SCANS });
}

#[test]
fn a_request_during_a_scan_waits_for_that_scan_but_an_earlier_one_does_not() {
    let responder = Responder::create(&unique("phases")).unwrap();
    let client = Client::open(responder.name()).unwrap();
    responder.publish(&estimate(1));
    let idle = client.wait_for_answer(client.request(), TIMEOUT).unwrap().unwrap();
    assert_eq!((idle.number, responder.is_requested()), (1, false));

    responder.begin();
    assert!(!responder.is_requested(), "there is no request for this scan yet");
    let request = client.request();
    assert!(responder.is_requested());
    let early = client.wait_for_answer(request, Duration::from_millis(20)).unwrap_err();
    assert!(matches!(early.problem, Problem::TimedOut { .. }), "{early}");
    assert_eq!(responder.publish(&estimate(2)), 2);
    assert!(!responder.is_requested());
    assert_eq!(client.wait_for_answer(request, TIMEOUT).unwrap().unwrap().number, 2);

    responder.begin();
    let late = client.request();
    responder.begin(); // the next scan: earlier requests are answered
    assert_eq!(client.wait_for_answer(late, TIMEOUT).unwrap().unwrap().number, 2);
    assert_eq!(client.counts(), Counts { acknowledged: 3, requested: 3, completed: 2 });
}
