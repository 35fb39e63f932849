//! Records: the building blocks of a bag, inside and outside its chunks. A record is a header of named fields followed by data,
//! each preceded by its length. All numbers are little-endian.

use std::borrow::Cow;

use crate::time::Stamp;

/// First line of every bag of this format.
pub(super) const MAGIC: &[u8] = b"#ROSBAG V2.0\n";

/// Record types: values of the header field `op`.
pub(super) mod op {
    pub(in super::super) const MESSAGE: u8 = 0x02;
    pub(in super::super) const BAG_HEADER: u8 = 0x03;
    pub(in super::super) const INDEX: u8 = 0x04;
    pub(in super::super) const CHUNK: u8 = 0x05;
    pub(in super::super) const CHUNK_INFO: u8 = 0x06;
    pub(in super::super) const CONNECTION: u8 = 0x07;
}

/// Splits off a block that is preceded by its 32-bit length; returns the block and the remaining bytes. `None` if the bytes end
/// before the block does.
pub(super) fn split_block(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (len, rest) = bytes.split_first_chunk::<4>()?;
    rest.split_at_checked(usize::try_from(u32::from_le_bytes(*len)).ok()?)
}

/// The named fields of a header.
#[derive(Clone, Copy)]
pub(super) struct Fields<'a>(pub(super) &'a [u8]);

impl<'a> Fields<'a> {
    pub(super) fn bytes(self, name: &str) -> Result<&'a [u8], String> {
        let mut rest = self.0;
        while !rest.is_empty() {
            let (field, after) = split_block(rest).ok_or("a header field is longer than its header")?;
            if let Some(value) = field.strip_prefix(name.as_bytes()).and_then(|field| field.strip_prefix(b"=")) {
                return Ok(value);
            }
            rest = after;
        }
        Err(format!("a record header has no field `{name}`"))
    }

    fn array<const N: usize>(self, name: &str) -> Result<[u8; N], String> {
        let value = self.bytes(name)?;
        value.try_into().map_err(|_| format!("the header field `{name}` has {} bytes, not {N}", value.len()))
    }

    pub(super) fn op(self) -> Result<u8, String> {
        self.array("op").map(|[op]| op)
    }

    pub(super) fn u32(self, name: &str) -> Result<u32, String> {
        self.array(name).map(u32::from_le_bytes)
    }

    pub(super) fn u64(self, name: &str) -> Result<u64, String> {
        self.array(name).map(u64::from_le_bytes)
    }

    pub(super) fn stamp(self, name: &str) -> Result<Stamp, String> {
        self.array(name).map(stamp_from_bytes)
    }

    /// A field as text. Invalid UTF-8 is replaced: comments in old message definitions contain other encodings.
    pub(super) fn text(self, name: &str) -> Result<Cow<'a, str>, String> {
        self.bytes(name).map(String::from_utf8_lossy)
    }
}

/// Appends the header of a record: its length, then its fields.
pub(super) fn push_header(out: &mut Vec<u8>, fields: &[(&str, &[u8])]) {
    let field_len = |(name, value): &(&str, &[u8])| name.len() + 1 + value.len();
    push_len(out, fields.iter().map(|field| 4 + field_len(field)).sum());
    for field in fields {
        push_len(out, field_len(field));
        out.extend_from_slice(field.0.as_bytes());
        out.push(b'=');
        out.extend_from_slice(field.1);
    }
}

/// Appends a complete record.
pub(super) fn push_record(out: &mut Vec<u8>, fields: &[(&str, &[u8])], data: &[u8]) {
    push_header(out, fields);
    push_len(out, data.len());
    out.extend_from_slice(data);
}

fn push_len(out: &mut Vec<u8>, len: usize) {
    // The writer keeps messages, and therefore chunks, below this limit.
    out.extend_from_slice(&u32::try_from(len).unwrap_or(u32::MAX).to_le_bytes());
}

pub(super) fn stamp_from_bytes(bytes: [u8; 8]) -> Stamp {
    let [s0, s1, s2, s3, n0, n1, n2, n3] = bytes;
    Stamp::from_ros(u32::from_le_bytes([s0, s1, s2, s3]), u32::from_le_bytes([n0, n1, n2, n3]))
}

pub(super) fn stamp_to_bytes(stamp: Stamp) -> [u8; 8] {
    let (seconds, nanoseconds) = stamp.to_ros();
    let ([s0, s1, s2, s3], [n0, n1, n2, n3]) = (seconds.to_le_bytes(), nanoseconds.to_le_bytes());
    [s0, s1, s2, s3, n0, n1, n2, n3]
}
