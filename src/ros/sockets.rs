//! Socket options that rosrust does not set for its publishers and services.
//!
//! rosrust writes to its subscribers one after the other, and a subscriber that does not read would block all others: hence the
//! write timeout. It reads the headers of new subscribers and callers one after the other, and one that sends none would block
//! all later ones: hence the read timeout. And it leaves Nagle's algorithm on, which holds small messages until the last one is
//! acknowledged, 40 ms later. rosrust does not expose its sockets; they are found by their port among the file descriptors of
//! this process. Accepted sockets inherit the options of the listening socket.

use std::collections::HashSet;
use std::fs;
use std::time::Duration;

use socket2::SockRef;

/// A subscriber that does not read for this long is disconnected. It may reconnect.
const WRITE_TIMEOUT: Duration = Duration::from_millis(100);
/// Timeout for the header of a new subscriber or caller.
const READ_TIMEOUT: Duration = Duration::from_secs(1);

/// Sets the options of all sockets of this process at these ports. Failures are ignored: such sockets work as before.
pub(super) fn tune(ports: &HashSet<u16>) {
    let files = fs::read_dir("/proc/self/fd").into_iter().flatten().flatten();
    for descriptor in files.filter_map(|file| file.file_name().to_str()?.parse::<i32>().ok()) {
        // On other kinds of files these calls fail and change nothing.
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
