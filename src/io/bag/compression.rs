//! Compression of chunks: none, bzip2 or LZ4.

use std::io::{self, Read, Write};

use lz4_flex::frame::{BlockMode, BlockSize, FrameDecoder, FrameEncoder, FrameInfo};

crate::choices! {
    /// Compression of the chunks of a bag.
    pub enum Compression {
        /// No compression: fastest to write.
        None = "none",
        /// Small but slow.
        Bz2 = "bz2",
        /// Fast, and almost as small as bz2.
        Lz4 = "lz4",
    }
}

impl Compression {
    pub(super) fn from_name(name: &[u8]) -> Option<Self> {
        Self::ALL.iter().copied().find(|compression| compression.name().as_bytes() == name)
    }

    pub(super) fn pack(self, bytes: &[u8]) -> io::Result<Vec<u8>> {
        match self {
            Self::None => Ok(bytes.to_vec()),
            Self::Bz2 => {
                let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::best());
                encoder.write_all(bytes)?;
                encoder.finish()
            }
            Self::Lz4 => {
                // The decoder of ROS accepts only independent blocks without block checksums.
                let frame =
                    FrameInfo::new().block_mode(BlockMode::Independent).block_size(BlockSize::Max64KB).content_checksum(true);
                let mut encoder = FrameEncoder::with_frame_info(frame, Vec::new());
                encoder.write_all(bytes)?;
                Ok(encoder.finish()?)
            }
        }
    }

    /// Decompresses at most `limit` bytes. If the compressed bytes are damaged or truncated, returns what was decompressed up to
    /// there, together with the error.
    pub(super) fn unpack(self, packed: Vec<u8>, limit: u64) -> (Vec<u8>, io::Result<()>) {
        let mut bytes = Vec::new();
        let outcome = match self {
            Self::None => return (packed, Ok(())),
            Self::Bz2 => bzip2::read::BzDecoder::new(packed.as_slice()).take(limit).read_to_end(&mut bytes),
            Self::Lz4 => FrameDecoder::new(packed.as_slice()).take(limit).read_to_end(&mut bytes),
        };
        (bytes, outcome.map(|_| ()))
    }
}
