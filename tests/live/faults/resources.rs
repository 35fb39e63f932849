//! Resources that the node uses, and its exposure to the network.

use std::collections::HashSet;
use std::fs;

use super::bench::Bench;

/// Local addresses, in the kernel's notation, of the sockets that a process listens on.
fn listening_addresses(process: u32) -> Vec<String> {
    let links = fs::read_dir(format!("/proc/{process}/fd")).unwrap().filter_map(|file| fs::read_link(file.unwrap().path()).ok());
    let own: HashSet<String> =
        links.filter_map(|link| Some(link.to_str()?.strip_prefix("socket:[")?.strip_suffix(']')?.to_owned())).collect();
    let tables: String =
        ["tcp", "tcp6"].map(|table| fs::read_to_string(format!("/proc/{process}/net/{table}")).unwrap()).concat();
    let listening = |line: &str| {
        let fields: Vec<&str> = line.split_whitespace().collect();
        let ours = fields.get(3) == Some(&"0A") && fields.get(9).is_some_and(|inode| own.contains(*inode));
        ours.then(|| fields[1].split(':').next().unwrap().to_owned())
    };
    tables.lines().filter_map(listening).collect()
}

#[test]
fn on_localhost_all_sockets_listen_on_the_loopback_interface() {
    let Some(bench) = Bench::start(181) else { return };
    let addresses = listening_addresses(bench.node.id());
    assert!(addresses.len() > 5, "the test looks at the wrong sockets: {addresses:?}");
    let loopback = ["0100007F", "00000000000000000000000001000000"];
    assert!(addresses.iter().all(|address| loopback.contains(&&**address)), "{addresses:?}");
}

#[test]
fn memory_threads_and_files_do_not_grow_during_a_drive() {
    let Some(mut bench) = Bench::start(1081) else { return };
    for _ in 0..100 {
        bench.step();
    }
    let before = bench.resources();
    for _ in 0..1000 {
        bench.check_step();
    }
    let after = bench.resources();
    eprintln!("{before:?}, 1000 scans later {after:?}");
    assert!(after.memory < 30_000 && after.memory < before.memory + 2_000, "{before:?} {after:?}");
    // A call to the master briefly uses a file.
    assert!(after.threads <= before.threads + 1 && after.files <= before.files + 2, "{before:?} {after:?}");
}
