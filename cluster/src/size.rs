//! How people write sizes: `16K`, `1.5G`, `40%`, `640x480`.

use core::fmt;
use core::str::FromStr;

/// A number of bytes, written with or without a unit: `4096`, `16K`, `1.5G`. Units are powers of 1024.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bytes(pub u64);

/// What a node may hold: so many bytes, or a share of the scene image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Memory {
    /// At most this many bytes.
    Bytes(u64),
    /// At most this part of the scene image, 1 being all of it.
    Share(f64),
}

/// The size of a picture in pixels, written `WIDTHxHEIGHT`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PictureSize {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// What was written is not such a size; the text says what one looks like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotASize(&'static str);

const BYTES: NotASize = NotASize("a number of bytes, as in 4096, 16K, 64M or 1.5G");
const MEMORY: NotASize = NotASize("a share of the scene image, as in 40%, or a number of bytes, as in 64M");
const PICTURE: NotASize = NotASize("WIDTHxHEIGHT in pixels, each from 1 to 16384, as in 512x512");

impl FromStr for Bytes {
    type Err = NotASize;

    fn from_str(text: &str) -> Result<Self, NotASize> {
        let text = text.trim();
        let text = text.strip_suffix(['B', 'b']).unwrap_or(text);
        let (number, unit) = match text.chars().last() {
            Some('K' | 'k') => (&text[..text.len() - 1], 1u64 << 10),
            Some('M' | 'm') => (&text[..text.len() - 1], 1 << 20),
            Some('G' | 'g') => (&text[..text.len() - 1], 1 << 30),
            Some('T' | 't') => (&text[..text.len() - 1], 1 << 40),
            _ => (text, 1),
        };
        let bytes = number.parse::<f64>().map_err(|_| BYTES)? * unit as f64;
        // Beyond 2^53 a number is not exact, and no memory is that large.
        if !(0.0..=9e15).contains(&bytes) || bytes.fract() != 0.0 {
            return Err(BYTES);
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "whole and in range")]
        Ok(Self(bytes as u64))
    }
}

impl FromStr for Memory {
    type Err = NotASize;

    fn from_str(text: &str) -> Result<Self, NotASize> {
        let Some(percent) = text.trim().strip_suffix('%') else {
            return text.parse::<Bytes>().map(|Bytes(bytes)| Self::Bytes(bytes)).map_err(|_| MEMORY);
        };
        match percent.trim().parse::<f64>() {
            Ok(percent) if percent > 0.0 && percent <= 100.0 => Ok(Self::Share(percent / 100.0)),
            _ => Err(MEMORY),
        }
    }
}

impl FromStr for PictureSize {
    type Err = NotASize;

    fn from_str(text: &str) -> Result<Self, NotASize> {
        let (width, height) = text.split_once(['x', 'X']).ok_or(PICTURE)?;
        let side = |text: &str| text.trim().parse().ok().filter(|side| (1..=16_384).contains(side));
        match (side(width), side(height)) {
            (Some(width), Some(height)) => Ok(Self { width, height }),
            _ => Err(PICTURE),
        }
    }
}

impl Memory {
    /// The number of bytes this is for a scene image of `image_bytes`.
    #[must_use]
    pub fn of(self, image_bytes: u64) -> u64 {
        match self {
            Self::Bytes(bytes) => bytes,
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "at most the image's bytes"
            )]
            Self::Share(share) => (image_bytes as f64 * share) as u64,
        }
    }
}

impl fmt::Display for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(bytes) = *self;
        let (unit, name) = match bytes {
            0..1024 => return write!(f, "{bytes} B"),
            1024..0x10_0000 => (1u64 << 10, "KB"),
            0x10_0000..0x4000_0000 => (1 << 20, "MB"),
            _ => (1 << 30, "GB"),
        };
        if bytes.is_multiple_of(unit) {
            return write!(f, "{} {name}", bytes / unit);
        }
        let value = bytes as f64 / unit as f64;
        write!(f, "{value:.*} {name}", if value < 10.0 { 2 } else { 1 })
    }
}

impl fmt::Display for PictureSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

impl fmt::Display for NotASize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "expected {}", self.0)
    }
}

impl core::error::Error for NotASize {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_have_units() {
        for (text, bytes) in
            [("0", 0), ("4096", 4096), ("16K", 16384), ("1.5G", 3 << 29), ("2mb", 2 << 20), ("1T", 1 << 40)]
        {
            assert_eq!(text.parse(), Ok(Bytes(bytes)), "{text}");
        }
        for text in ["", "K", "-1", "1.5", "1e400", "nan", "16Q", "0x10"] {
            assert!(text.parse::<Bytes>().is_err(), "{text}");
        }
    }

    #[test]
    fn memory_is_a_share_or_bytes() {
        assert_eq!("40%".parse(), Ok(Memory::Share(0.4)));
        assert_eq!(Memory::Share(0.4).of(1000), 400);
        assert_eq!("64M".parse(), Ok(Memory::Bytes(64 << 20)));
        for text in ["0%", "101%", "-3%", "%", "x%", "much"] {
            assert!(text.parse::<Memory>().is_err(), "{text}");
        }
    }

    #[test]
    fn pictures_have_two_sides() {
        assert_eq!("640x480".parse(), Ok(PictureSize { width: 640, height: 480 }));
        for text in ["640", "0x1", "1x16385", "1x", "axb", "1x2x3"] {
            assert!(text.parse::<PictureSize>().is_err(), "{text}");
        }
    }

    #[test]
    fn bytes_print_as_people_read_them() {
        let printed = [0, 1023, 16384, 1536, 20_000_000, 3 << 30].map(|bytes| Bytes(bytes).to_string());
        assert_eq!(printed, ["0 B", "1023 B", "16 KB", "1.50 KB", "19.1 MB", "3 GB"]);
    }
}
