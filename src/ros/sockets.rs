//! What rosrust leaves out about the sockets it publishes and serves by.
//!
//! It writes to one subscriber after the other and waits for each: one that does not read would keep all others waiting. It reads the
//! header of one new subscriber or caller after the other: one that sends none would keep all that come later waiting. And it leaves small
//! messages to lie until the last one is acknowledged, 40 ms later. It lends nobody its sockets; they are found among the files of
//! this process by their port. What is set for a socket that listens holds for those that it accepts.

use std::collections::HashSet;
use std::fs;
use std::time::Duration;

use socket2::SockRef;

/// A subscriber that does not read for so long is cut off; it may come back.
const WRITE_TIMEOUT: Duration = Duration::from_millis(100);
/// For the header of a new subscriber or caller.
const READ_TIMEOUT: Duration = Duration::from_secs(1);

/// Tunes all sockets of this process at these ports; those that cannot be tuned work as before.
pub(super) fn tune(ports: &HashSet<u16>) {
    let files = fs::read_dir("/proc/self/fd").into_iter().flatten().flatten();
    for descriptor in files.filter_map(|file| file.file_name().to_str()?.parse::<i32>().ok()) {
        // Of what is no socket, nothing can be asked or set.
        let socket = SockRef::from(&descriptor);
        let port = socket.local_addr().ok().and_then(|address| Some(address.as_socket()?.port()));
        if port.is_some_and(|port| ports.contains(&port)) {
            let _ = socket.set_nodelay(true);
            let _ = socket.set_write_timeout(Some(WRITE_TIMEOUT));
            let _ = socket.set_read_timeout(Some(READ_TIMEOUT));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{TcpListener, TcpStream};

    #[test]
    fn sockets_accepted_before_and_after_are_tuned_and_others_are_not() {
        let (listener, other) = (TcpListener::bind("localhost:0").unwrap(), TcpListener::bind("localhost:0").unwrap());
        let address = listener.local_addr().unwrap();
        let (_before, (earlier, _)) = (TcpStream::connect(address).unwrap(), listener.accept().unwrap());
        tune(&HashSet::from([address.port()]));
        let (_after, (later, _)) = (TcpStream::connect(address).unwrap(), listener.accept().unwrap());
        for socket in [earlier, later] {
            assert!(socket.nodelay().unwrap());
            assert_eq!(socket.write_timeout().unwrap(), Some(WRITE_TIMEOUT));
            assert_eq!(socket.read_timeout().unwrap(), Some(READ_TIMEOUT));
        }
        assert!(!SockRef::from(&other).nodelay().unwrap());
    }
}
