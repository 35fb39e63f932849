//! The subscriber's side of TCPROS, <http://wiki.ros.org/ROS/TCPROS>: topic negotiation, connection headers and messages.
//!
//! Announced lengths are not trusted: memory grows with the bytes received, not with those announced.

use std::collections::HashMap;
use std::io::{self, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

use socket2::{SockRef, TcpKeepalive};
use thiserror::Error;
use xml_rpc::Url;

/// Maximum size of a message in bytes. A scan of a million beams takes a quarter of this.
const MAX_MESSAGE: u32 = 32 << 20;
/// Maximum size of a connection header in bytes. It contains the definition of the message.
const MAX_HEADER: u32 = 1 << 20;
/// Maximum memory allocated for a message before its bytes arrive.
const MAX_INITIAL_CAPACITY: usize = 1 << 16;
/// Timeout for connecting to a publisher and for receiving its header.
const TIMEOUT: Duration = Duration::from_secs(3);
/// Idle time after which TCP keepalive probes are sent.
const KEEPALIVE_IDLE: Duration = Duration::from_secs(5);
/// Time between two keepalive probes.
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(1);
/// Number of unanswered keepalive probes after which the connection is closed.
const KEEPALIVE_PROBES: u32 = 3;

/// Why a connection to a publisher could not be made, or has ended.
#[derive(Debug, Error)]
pub(super) enum LinkError {
    #[error("the master does not give its address ({0})")]
    Unknown(String),
    #[error("the call of its requestTopic failed ({0})")]
    Unreachable(String),
    #[error("the connection failed or was closed ({0})")]
    Socket(#[from] io::Error),
    #[error("malformed connection header ({0})")]
    BadHeader(&'static str),
    #[error("it refused the connection: {0}")]
    Refused(String),
    #[error("it announced a message of {0} bytes, more than the maximum of {MAX_MESSAGE}")]
    Oversized(u32),
}

/// Fields of a connection header.
pub(super) type Header = HashMap<String, String>;

/// Host and port at which the node with the XML-RPC address `uri` publishes `topic`.
pub(super) fn request_topic(uri: &str, caller: &str, topic: &str) -> Result<(String, u16), LinkError> {
    let failed = |problem: &dyn ToString| LinkError::Unreachable(problem.to_string());
    let uri: Url = uri.parse().map_err(|problem| failed(&problem))?;
    let request = (caller, topic, [["TCPROS"]]);
    let answer: Result<(i32, String, (String, String, u16)), _> =
        xml_rpc::call(&uri, "requestTopic", request).map_err(|problem| failed(&problem))?;
    let (_, _, (_, host, port)) = answer.map_err(|fault| failed(&fault.message))?;
    Ok((host, port))
}

/// Connects to a publisher of `topic`, whatever its message type. The returned header names the type.
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
    let keepalive =
        TcpKeepalive::new().with_time(KEEPALIVE_IDLE).with_interval(KEEPALIVE_INTERVAL).with_retries(KEEPALIVE_PROBES);
    SockRef::from(&stream).set_tcp_keepalive(&keepalive)?;
    Ok((stream, header))
}

/// Waits for a message and returns it in serialized form.
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

fn read_block(stream: &mut impl Read, max_length: u32) -> Result<Vec<u8>, LinkError> {
    let mut length = [0; 4];
    stream.read_exact(&mut length)?;
    let length = u32::from_le_bytes(length);
    if length > max_length {
        return Err(LinkError::Oversized(length));
    }
    let mut bytes = Vec::with_capacity(MAX_INITIAL_CAPACITY.min(length as usize));
    let read = stream.take(length.into()).read_to_end(&mut bytes)?;
    if read < length as usize { Err(io::Error::from(io::ErrorKind::UnexpectedEof).into()) } else { Ok(bytes) }
}

fn encode_header(fields: &[(&str, &str)]) -> Vec<u8> {
    // Names and types are far shorter than 2^32 bytes.
    #[allow(clippy::cast_possible_truncation)]
    let block = |bytes: Vec<u8>| [(bytes.len() as u32).to_le_bytes().to_vec(), bytes].concat();
    block(fields.iter().flat_map(|(name, value)| block(format!("{name}={value}").into_bytes())).collect())
}

fn parse_header(mut bytes: &[u8]) -> Result<Header, LinkError> {
    let mut header = Header::new();
    while !bytes.is_empty() {
        let (length, rest) = bytes.split_first_chunk().ok_or(LinkError::BadHeader("a length is truncated"))?;
        let field = rest.get(..u32::from_le_bytes(*length) as usize).ok_or(LinkError::BadHeader("a field is truncated"))?;
        bytes = &rest[field.len()..];
        let field = String::from_utf8_lossy(field);
        let (name, value) = field.split_once('=').ok_or(LinkError::BadHeader("a field has no '='"))?;
        header.insert(name.into(), value.into());
    }
    Ok(header)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_is_read_back_as_it_was_written() {
        let bytes = encode_header(&[("topic", "/scan"), ("odd", "a=b"), ("empty", "")]);
        let header = parse_header(&read_block(&mut &bytes[..], MAX_HEADER).unwrap()).unwrap();
        assert_eq!((header.len(), &*header["topic"], &*header["odd"], &*header["empty"]), (3, "/scan", "a=b", ""));
    }

    #[test]
    fn a_truncated_header_or_one_without_a_value_is_rejected() {
        let bytes = &encode_header(&[("topic", "/scan")])[4..];
        for end in 1..bytes.len() {
            assert!(matches!(parse_header(&bytes[..end]), Err(LinkError::BadHeader(_))), "{end}");
        }
        assert!(parse_header(&[1, 0, 0, 0, b'x']).is_err());
    }

    #[test]
    fn announced_lengths_allocate_no_memory() {
        let message = |length: u32, bytes: &[u8]| read_message(&mut &[&length.to_le_bytes()[..], bytes].concat()[..]);
        assert_eq!(message(3, b"abcd").unwrap(), b"abc");
        assert_eq!(message(0, b"").unwrap(), b"");
        assert!(matches!(message(MAX_MESSAGE, b"abc"), Err(LinkError::Socket(_))));
        assert!(matches!(message(MAX_MESSAGE + 1, b"abc"), Err(LinkError::Oversized(_))));
        let info = allocation_counter::measure(|| drop(message(MAX_MESSAGE, b"abc")));
        assert!(info.bytes_max < 10 * MAX_INITIAL_CAPACITY as u64, "{info:?}");
    }
}
