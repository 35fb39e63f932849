//! TCPROS as a subscriber speaks it: asking a publisher where it publishes, the headers of a connection, messages.
//!
//! <http://wiki.ros.org/ROS/TCPROS>. Nothing that the other side says is believed before it is seen: memory grows with the bytes that
//! come, not with those that are announced.

use std::collections::HashMap;
use std::io::{self, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

use socket2::{SockRef, TcpKeepalive};
use thiserror::Error;
use xml_rpc::Url;

/// Longer messages are mistakes: a scan of a million beams takes a quarter of this.
const MAX_MESSAGE: u32 = 32 << 20;
/// Longer headers are mistakes: they hold the definition of a message.
const MAX_HEADER: u32 = 1 << 20;
/// Memory taken for a message before any byte of it is here.
const ON_CREDIT: usize = 1 << 16;
/// For the other side to accept a connection, and for its header.
const TIMEOUT: Duration = Duration::from_secs(3);
/// A machine that is silent for so long is asked whether it is still there.
const SILENCE: Duration = Duration::from_secs(5);
const PROBE_PERIOD: Duration = Duration::from_secs(1);
const PROBES: u32 = 3;

/// Why there is no connection to a publisher, or no longer.
#[derive(Debug, Error)]
pub(super) enum LinkError {
    #[error("the master does not say where it is ({0})")]
    Unknown(String),
    #[error("it cannot be asked where it publishes ({0})")]
    Unreachable(String),
    #[error("{0}")]
    Socket(#[from] io::Error),
    #[error("malformed header ({0})")]
    BadHeader(&'static str),
    #[error("it refuses: {0}")]
    Refused(String),
    #[error("it announces a message of {0} bytes, and {MAX_MESSAGE} are the most there can be")]
    TooLong(u32),
}

/// Fields of a connection's header.
pub(super) type Header = HashMap<String, String>;

/// Host and port at which the node that answers at `uri` publishes `topic`.
pub(super) fn request_topic(uri: &str, caller: &str, topic: &str) -> Result<(String, u16), LinkError> {
    let failed = |problem: &dyn ToString| LinkError::Unreachable(problem.to_string());
    let uri: Url = uri.parse().map_err(|problem| failed(&problem))?;
    let request = (caller, topic, [["TCPROS"]]);
    let answer: Result<(i32, String, (String, String, u16)), _> =
        xml_rpc::call(&uri, "requestTopic", request).map_err(|problem| failed(&problem))?;
    let (_, _, (_, host, port)) = answer.map_err(|fault| failed(&fault.message))?;
    Ok((host, port))
}

/// Connects to a publisher of `topic`, of whatever type: its header says which.
pub(super) fn connect(address: &(String, u16), caller: &str, topic: &str) -> Result<(TcpStream, Header), LinkError> {
    let mut stream = open(address)?;
    stream.set_read_timeout(Some(TIMEOUT))?;
    stream.set_write_timeout(Some(TIMEOUT))?;
    let fields = [("callerid", caller), ("topic", topic), ("md5sum", "*"), ("type", "*"), ("tcp_nodelay", "1")];
    stream.write_all(&encode_header(&fields))?;
    let header = parse_header(&read_block(&mut stream, MAX_HEADER)?)?;
    if let Some(problem) = header.get("error") {
        return Err(LinkError::Refused(problem.clone()));
    }
    stream.set_read_timeout(None)?;
    let keepalive = TcpKeepalive::new().with_time(SILENCE).with_interval(PROBE_PERIOD).with_retries(PROBES);
    SockRef::from(&stream).set_tcp_keepalive(&keepalive)?;
    Ok((stream, header))
}

/// Waits for a message; its wire form.
pub(super) fn read_message(stream: &mut impl Read) -> Result<Vec<u8>, LinkError> {
    read_block(stream, MAX_MESSAGE)
}

fn open(address: &(String, u16)) -> Result<TcpStream, LinkError> {
    let mut problem = io::Error::from(io::ErrorKind::AddrNotAvailable);
    for address in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, TIMEOUT) {
            Ok(stream) => return Ok(stream),
            Err(error) => problem = error,
        }
    }
    Err(problem.into())
}

fn read_block(stream: &mut impl Read, longest: u32) -> Result<Vec<u8>, LinkError> {
    let mut length = [0; 4];
    stream.read_exact(&mut length)?;
    let length = u32::from_le_bytes(length);
    if length > longest {
        return Err(LinkError::TooLong(length));
    }
    let mut bytes = Vec::with_capacity(ON_CREDIT.min(length as usize));
    let read = stream.take(length.into()).read_to_end(&mut bytes)?;
    if read < length as usize { Err(io::Error::from(io::ErrorKind::UnexpectedEof).into()) } else { Ok(bytes) }
}

fn encode_header(fields: &[(&str, &str)]) -> Vec<u8> {
    // Names and types: far below 2^32 bytes.
    #[allow(clippy::cast_possible_truncation)]
    let block = |bytes: Vec<u8>| [(bytes.len() as u32).to_le_bytes().to_vec(), bytes].concat();
    block(fields.iter().flat_map(|(name, value)| block(format!("{name}={value}").into_bytes())).collect())
}

fn parse_header(mut bytes: &[u8]) -> Result<Header, LinkError> {
    let mut header = Header::new();
    while !bytes.is_empty() {
        let (length, rest) = bytes.split_first_chunk().ok_or(LinkError::BadHeader("a length is cut off"))?;
        let field = rest.get(..u32::from_le_bytes(*length) as usize).ok_or(LinkError::BadHeader("a field is cut off"))?;
        bytes = &rest[field.len()..];
        let field = String::from_utf8_lossy(field);
        let (name, value) = field.split_once('=').ok_or(LinkError::BadHeader("a field has no ="))?;
        header.insert(name.into(), value.into());
    }
    Ok(header)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_is_read_as_it_was_written() {
        let bytes = encode_header(&[("topic", "/scan"), ("odd", "a=b"), ("empty", "")]);
        let header = parse_header(&read_block(&mut &bytes[..], MAX_HEADER).unwrap()).unwrap();
        assert_eq!((header.len(), &*header["topic"], &*header["odd"], &*header["empty"]), (3, "/scan", "a=b", ""));
    }

    #[test]
    fn a_header_cut_off_anywhere_or_without_a_value_is_refused() {
        let bytes = &encode_header(&[("topic", "/scan")])[4..];
        for end in 1..bytes.len() {
            assert!(matches!(parse_header(&bytes[..end]), Err(LinkError::BadHeader(_))), "{end}");
        }
        assert!(parse_header(&[1, 0, 0, 0, b'x']).is_err());
    }

    #[test]
    fn announced_lengths_cost_nothing() {
        let message = |length: u32, bytes: &[u8]| read_message(&mut &[&length.to_le_bytes()[..], bytes].concat()[..]);
        assert_eq!(message(3, b"abcd").unwrap(), b"abc");
        assert_eq!(message(0, b"").unwrap(), b"");
        assert!(matches!(message(MAX_MESSAGE, b"abc"), Err(LinkError::Socket(_))));
        assert!(matches!(message(MAX_MESSAGE + 1, b"abc"), Err(LinkError::TooLong(_))));
        let info = allocation_counter::measure(|| drop(message(MAX_MESSAGE, b"abc")));
        assert!(info.bytes_max < 10 * ON_CREDIT as u64, "{info:?}");
    }
}
