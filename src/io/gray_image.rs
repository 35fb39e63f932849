//! Greyscale images: PNG, and PGM (netpbm), plain (`P2`) and raw (`P5`).

use std::fs;
use std::io::{self, BufWriter, Cursor, Write};
use std::path::Path;

const PNG_SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";

/// A greyscale image. Pixels are stored row by row from the top left; 0 is black, 255 white.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GrayImage {
    width: usize,
    pixels: Vec<u8>,
}

impl GrayImage {
    /// An image of the given width. `None` unless `pixels` fill at least one row, and all rows completely.
    pub fn new(width: usize, pixels: Vec<u8>) -> Option<Self> {
        (width > 0 && !pixels.is_empty() && pixels.len().is_multiple_of(width)).then_some(Self { width, pixels })
    }

    /// Width, pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height, pixels.
    pub fn height(&self) -> usize {
        self.pixels.len() / self.width
    }

    /// The rows from top to bottom.
    pub fn rows(&self) -> impl DoubleEndedIterator<Item = &[u8]> {
        self.pixels.chunks_exact(self.width)
    }

    /// Reads a PNG or PGM file; the content decides which it is. Colours are averaged as in `map_server`; transparency is
    /// ignored.
    pub fn read(path: &Path) -> Result<Self, String> {
        Self::decode(&fs::read(path).map_err(|error| error.to_string())?)
    }

    /// Decodes the content of a PNG or PGM file.
    pub fn decode(bytes: &[u8]) -> Result<Self, String> {
        match bytes {
            [b'P', b'2' | b'5', ..] => decode_pgm(bytes),
            _ if bytes.starts_with(PNG_SIGNATURE) => decode_png(bytes).map_err(|error| error.to_string()),
            _ => Err("it is neither a PNG nor a PGM file".into()),
        }
    }

    /// Writes a PNG file.
    pub fn write_png(&self, writer: impl Write) -> io::Result<()> {
        write_png(writer, self.width, &self.pixels, None)
    }
}

/// Writes a PNG file of pixels stored row by row from the top left: shades of grey, or indices of a palette, which has red, green
/// and blue of each colour.
pub fn write_png(writer: impl Write, width: usize, pixels: &[u8], palette: Option<Vec<u8>>) -> io::Result<()> {
    let size = |pixels: usize| u32::try_from(pixels).map_err(io::Error::other);
    let mut encoder = png::Encoder::new(BufWriter::new(writer), size(width)?, size(pixels.len() / width)?);
    encoder.set_depth(png::BitDepth::Eight);
    match palette {
        Some(palette) => {
            encoder.set_color(png::ColorType::Indexed);
            encoder.set_palette(palette);
        }
        None => encoder.set_color(png::ColorType::Grayscale),
    }
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    Ok(writer.finish()?)
}

fn decode_png(bytes: &[u8]) -> Result<GrayImage, png::DecodingError> {
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    // Palettes and samples of fewer bits are expanded to bytes; of 16 bits, the upper 8 are kept.
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
    let mut reader = decoder.read_info()?;
    let mut buffer = vec![0; reader.output_buffer_size().ok_or(png::DecodingError::LimitsExceeded)?];
    let frame = reader.next_frame(&mut buffer)?;
    buffer.truncate(frame.buffer_size());
    let colours = if frame.color_type.samples() < 3 { 1 } else { 3 };
    let mean = |pixel: &[u8]| {
        let sum: usize = pixel[..colours].iter().map(|&sample| usize::from(sample)).sum();
        u8::try_from(sum / colours).unwrap_or(u8::MAX)
    };
    let pixels = buffer.chunks_exact(frame.color_type.samples()).map(mean).collect();
    Ok(GrayImage { width: frame.width as usize, pixels }) // a PNG is never empty
}

/// Decodes a PGM file, see <https://netpbm.sourceforge.net/doc/pgm.html>. Comments go from `#` to the end of the line.
fn decode_pgm(bytes: &[u8]) -> Result<GrayImage, String> {
    let mut position = 2;
    let mut number = |name: &str| number(bytes, &mut position).ok_or_else(|| format!("this PGM file has no {name}"));
    let (width, height) = (number("width")?, number("height")?);
    let white = number("maximum value")?;
    let count = width.checked_mul(height).filter(|&count| count > 0 && (1..=0xffff).contains(&white));
    let count =
        count.ok_or_else(|| format!("a PGM file cannot have {width} x {height} pixels with a maximum value of {white}"))?;
    let shade = |value: usize| u8::try_from((value.min(white) * 255 + white / 2) / white).unwrap_or(u8::MAX);
    let pixels: Vec<u8> = if bytes[1] == b'2' {
        (0..count).map_while(|_| number("pixel").ok()).map(shade).collect()
    } else {
        let raster = bytes.get(position + 1..).unwrap_or_default(); // preceded by a single white space
        let sample = if white < 256 { 1 } else { 2 };
        let values =
            raster.chunks_exact(sample).map(|bytes| bytes.iter().fold(0, |value, &byte| 256 * value + usize::from(byte)));
        values.take(count).map(shade).collect()
    };
    if pixels.len() < count {
        return Err(format!("the file has only {} of {width} x {height} pixels", pixels.len()));
    }
    Ok(GrayImage { width, pixels })
}

/// Reads the next number of a PGM file; skips white space and comments before it.
fn number(bytes: &[u8], position: &mut usize) -> Option<usize> {
    loop {
        match bytes.get(*position)? {
            b'#' => *position += bytes[*position..].iter().position(|&byte| byte == b'\n')?,
            space if space.is_ascii_whitespace() => *position += 1,
            _ => break,
        }
    }
    let text = &bytes[*position..];
    let digits = text.iter().position(|byte| !byte.is_ascii_digit()).unwrap_or(text.len());
    *position += digits;
    std::str::from_utf8(&text[..digits]).ok()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image() -> GrayImage {
        GrayImage::new(3, vec![0, 100, 205, 254, 255, 1]).unwrap()
    }

    #[test]
    fn a_written_image_is_read_back_unchanged() {
        let mut png = Vec::new();
        image().write_png(&mut png).unwrap();
        let pgm = [&b"P5\n3 2\n255\n"[..], &image().pixels].concat();
        assert_eq!(GrayImage::decode(&pgm).unwrap(), image());
        assert_eq!(GrayImage::decode(&png).unwrap(), image());
        assert_eq!((image().width(), image().height()), (3, 2));
    }

    #[test]
    fn pgm_is_read_with_comments_as_text_and_with_two_byte_samples() {
        assert_eq!(GrayImage::decode(b"P2 # plain\n3 2 # size\n255\n0 100 205\n254 255 1").unwrap(), image());
        let wide = GrayImage::decode(b"P5\n#\n2 1\n65535\n\x00\x00\xff\xff").unwrap();
        assert_eq!(wide, GrayImage::new(2, vec![0, 255]).unwrap());
        let coarse = GrayImage::decode(b"P5 2 1 15\n\x00\x0f").unwrap();
        assert_eq!(coarse, GrayImage::new(2, vec![0, 255]).unwrap());
    }

    #[test]
    fn errors_of_invalid_images_say_what_is_wrong() {
        for (bytes, problem) in [
            (&b"P5 3 2 255\n12345"[..], "5 of 3 x 2"),
            (b"P2 3 2 255\n1 2 x", "2 of 3 x 2"),
            (b"P5 3 2", "no maximum value"),
            (b"P5 0 2 255\n", "0 x 2"),
            (b"P5 4294967296 4294967296 255\n", "cannot have"),
            (b"GIF89a", "neither"),
            (b"\x89PNG\r\n\x1a\n", "expected"),
        ] {
            let found = GrayImage::decode(bytes).unwrap_err().to_lowercase();
            assert!(found.contains(problem) || problem == "expected", "{found}");
        }
    }
}
