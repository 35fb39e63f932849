//! Processes that die, or close the segment.

use std::env;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::FileExt;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::Duration;

use anytime_scan_matcher::shared_memory::{Client, Problem, Responder};

use super::node::{TIMEOUT, assert_whole, estimate, file_of, unique};

const ROLE: &str = "ANYTIME_TEST_ROLE";
const NAME: &str = "ANYTIME_TEST_SEGMENT";

/// This test program as another process, in one of the roles below.
struct Peer(Child);

impl Peer {
    /// Starts it and waits until it is ready.
    fn start(role: &str, name: &str) -> Self {
        let mut child = Command::new(env::current_exe().unwrap())
            .args(["shared_memory::peers::role", "--exact", "--nocapture"])
            .env(ROLE, role)
            .env(NAME, name)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut errors = BufReader::new(child.stderr.take().unwrap()).lines();
        assert!(errors.any(|line| line.unwrap().contains("ready")), "{role} did not start");
        Self(child)
    }

    fn id(&self) -> u32 {
        self.0.id()
    }
}

/// Kills the process with SIGKILL, which no handler can catch.
impl Drop for Peer {
    fn drop(&mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

/// Not a test: the work of the other processes until they are killed.
#[test]
fn role() {
    let Ok(role) = env::var(ROLE) else { return };
    let name = env::var(NAME).unwrap();
    match role.as_str() {
        "idle node" => {
            let _responder = Responder::create(&name).unwrap();
            wait_for_death();
        }
        "busy node" => {
            let responder = Responder::create(&name).unwrap();
            eprintln!("ready");
            (1..=u32::MAX).for_each(|number| assert_eq!(responder.publish(&estimate(number)), number));
        }
        "controller" => {
            Client::open(&name).unwrap().request();
            wait_for_death();
        }
        other => panic!("{other} is not a role"),
    }
}

fn wait_for_death() {
    eprintln!("ready");
    thread::sleep(2 * TIMEOUT);
}

#[test]
fn the_segment_of_a_dead_node_is_taken_over_and_that_of_a_living_one_is_not() {
    let name = unique("stale");
    let node = Peer::start("idle node", &name);
    let client = Client::open(&name).unwrap();
    let refused = Responder::create(&name).unwrap_err();
    assert!(matches!(refused.problem, Problem::InUse { owner } if owner == node.id()), "{refused}");
    let dead = node.id();
    drop(node);
    for error in [Client::open(&name).unwrap_err(), client.wait_for_completion(0, TIMEOUT).unwrap_err()] {
        assert!(matches!(error.problem, Problem::OwnerDied { owner } if owner == dead), "{error}");
    }
    let successor = Responder::create(&name).unwrap();
    successor.publish(&estimate(1));
    assert_eq!(Client::open(&name).unwrap().latest().unwrap().unwrap().number, 1);
    let old = client.wait_for_completion(0, TIMEOUT).unwrap_err();
    assert!(matches!(old.problem, Problem::OwnerDied { .. }), "a client of the dead node must open again: {old}");
}

#[test]
fn only_one_of_many_successors_takes_over() {
    let name = unique("successors");
    for _ in 0..5 {
        drop(Peer::start("idle node", &name));
        let outcomes: Vec<_> = thread::scope(|scope| {
            let rivals: Vec<_> = (0..4).map(|_| scope.spawn(|| Responder::create(&name))).collect();
            rivals.into_iter().map(|rival| rival.join().unwrap()).collect()
        });
        assert_eq!(outcomes.iter().filter(|outcome| outcome.is_ok()).count(), 1, "{outcomes:?}");
        Client::open(&name).unwrap();
    }
}

/// The errors that end waits when the node ends.
fn end_of_wait(name: &str, end_node: impl FnOnce()) -> Vec<Problem> {
    let client = Client::open(name).unwrap();
    let completed = client.counts().completed;
    thread::scope(|scope| {
        let answer = scope.spawn(|| client.wait_for_answer(client.request(), TIMEOUT).unwrap_err().problem);
        let edge = scope.spawn(|| client.wait_for_completion(completed, TIMEOUT).unwrap_err().problem);
        thread::sleep(Duration::from_millis(20)); // by now they most likely sleep; the result must be right either way
        end_node();
        vec![answer.join().unwrap(), edge.join().unwrap()]
    })
}

#[test]
fn a_closed_segment_ends_every_wait_and_frees_the_name() {
    let name = unique("closed");
    let responder = Responder::create(&name).unwrap();
    responder.begin(); // requests remain unanswered
    for problem in end_of_wait(&name, || drop(responder)) {
        assert!(matches!(problem, Problem::Closed), "{problem}");
    }
    assert!(matches!(Client::open(&name).unwrap_err().problem, Problem::NotFound));
}

#[test]
fn a_dead_node_ends_a_wait() {
    let name = unique("killed");
    let node = Peer::start("idle node", &name);
    let client = Client::open(&name).unwrap();
    let error = thread::scope(|scope| {
        let edge = scope.spawn(|| client.wait_for_completion(0, TIMEOUT).unwrap_err());
        thread::sleep(Duration::from_millis(20));
        drop(node);
        edge.join().unwrap()
    });
    assert!(matches!(error.problem, Problem::OwnerDied { .. }), "{error}");
    drop(Responder::create(&name));
}

#[test]
fn a_controller_that_dies_leaves_the_others_unharmed() {
    let responder = Responder::create(&unique("controller")).unwrap();
    responder.begin();
    drop(Peer::start("controller", responder.name()));
    assert!(responder.is_requested());
    responder.publish(&estimate(1));
    let client = Client::open(responder.name()).unwrap();
    assert_eq!(client.wait_for_answer(client.request(), TIMEOUT).unwrap().unwrap().number, 1);
    assert_eq!((client.counts().requested, client.counts().acknowledged), (2, 2));
}

/// Puts the sequence lock into the state of an unfinished write.
fn corrupt_sequence(name: &str) {
    let file = std::fs::OpenOptions::new().write(true).open(file_of(name)).unwrap();
    file.write_all_at(&3_u32.to_ne_bytes(), 384).unwrap();
}

#[test]
fn a_node_that_dies_while_it_writes_is_an_error() {
    let name = unique("torn");
    let node = Peer::start("idle node", &name);
    let client = Client::open(&name).unwrap();
    corrupt_sequence(&name);
    let error = client.latest().unwrap_err();
    assert!(matches!(error.problem, Problem::HalfWritten), "it lives: {error}");
    drop(node);
    let error = client.latest().unwrap_err();
    assert!(matches!(error.problem, Problem::OwnerDied { .. }), "{error}");
    drop(Responder::create(&name));
}

#[test]
fn a_node_killed_at_any_moment_leaves_whole_estimates_or_an_error() {
    let name = unique("moment");
    for round in 0..20 {
        let node = Peer::start("busy node", &name);
        let client = Client::open(&name).unwrap();
        thread::sleep(Duration::from_micros(137 * round));
        drop(node);
        match client.latest() {
            Ok(Some(completed)) => {
                assert_whole(&completed);
                // At most the increment of the count is missing.
                assert!(completed.number - client.counts().completed <= 1);
            }
            Ok(None) => assert_eq!(client.counts().completed, 0),
            Err(error) => assert!(matches!(error.problem, Problem::OwnerDied { .. }), "{error}"),
        }
    }
    drop(Responder::create(&name));
}
