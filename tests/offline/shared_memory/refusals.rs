//! Files under the name of a segment that are not valid segments.

use std::fs;
use std::os::unix::fs::PermissionsExt;

use anytime_scan_matcher::shared_memory::layout::{MAGIC, SIZE, VERSION};
use anytime_scan_matcher::shared_memory::{Client, Problem, Responder};

use super::node::{file_of, unique};

fn segment(magic: u64, version: u32, size: u32) -> Vec<u8> {
    let mut bytes = [&magic.to_ne_bytes()[..], &version.to_ne_bytes(), &size.to_ne_bytes()].concat();
    bytes.resize(SIZE as usize, 0);
    bytes
}

/// The error of a client for a file with these bytes; a node replaces such a file in any case.
fn refusal(test: &str, bytes: &[u8]) -> Problem {
    let name = unique(test);
    fs::write(file_of(&name), bytes).unwrap();
    let error = Client::open(&name).unwrap_err();
    assert!(error.to_string().contains(&name), "{error}");
    let responder = Responder::create(&name).unwrap();
    Client::open(responder.name()).unwrap();
    error.problem
}

#[test]
fn a_client_rejects_invalid_segments() {
    let whole = segment(MAGIC, VERSION, SIZE);
    let problem = refusal("unserved", &whole);
    assert!(matches!(problem, Problem::OwnerDied { .. }), "{problem}");
    for length in [0, 1, whole.len() - 1] {
        let problem = refusal("truncated", &whole[..length]);
        assert!(matches!(problem, Problem::WrongSize { .. }), "{problem}");
    }
    let problem = refusal("too_long", &[&whole[..], &[0]].concat());
    assert!(matches!(problem, Problem::WrongSize { found: 513, expected: SIZE }), "{problem}");
    let problem = refusal("magic", &segment(MAGIC + 1, VERSION, SIZE));
    assert!(matches!(problem, Problem::WrongMagic { .. }), "{problem}");
    let problem = refusal("version", &segment(MAGIC, VERSION + 1, SIZE));
    assert!(matches!(problem, Problem::WrongVersion { found, expected: VERSION } if found == VERSION + 1), "{problem}");
    let problem = refusal("size", &segment(MAGIC, VERSION, SIZE + 8));
    assert!(matches!(problem, Problem::WrongSize { found: 520, expected: SIZE }), "{problem}");
}

#[test]
fn names_are_checked_and_a_missing_segment_has_its_own_remedy() {
    for name in ["", "/", "/a/b", "../tmp/x", "/..", "/a\0b", &format!("/{}", "x".repeat(300))] {
        for problem in [Client::open(name).unwrap_err().problem, Responder::create(name).unwrap_err().problem] {
            assert!(matches!(problem, Problem::BadName), "{name:?}: {problem}");
        }
    }
    let absent = Client::open(&unique("absent")).unwrap_err();
    assert!(matches!(absent.problem, Problem::NotFound), "{absent}");
}

#[test]
fn the_segment_is_private_to_its_user_and_removed_with_its_owner() {
    let name = unique("mode");
    fs::write(file_of(&name), "").unwrap();
    fs::set_permissions(file_of(&name), fs::Permissions::from_mode(0o666)).unwrap();
    let responder = Responder::create(&name).unwrap();
    assert_eq!(fs::metadata(file_of(&name)).unwrap().permissions().mode() & 0o777, 0o600);
    drop(responder);
    assert!(!file_of(&name).exists());
}

#[test]
fn a_segment_taken_over_by_another_node_is_left_alone() {
    let name = unique("usurped");
    let first = Responder::create(&name).unwrap();
    fs::remove_file(file_of(&name)).unwrap();
    let second = Responder::create(&name).unwrap();
    drop(first);
    Client::open(second.name()).unwrap();
}
