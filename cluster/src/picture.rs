//! Pixels to PNG, and their hash.

use std::io::Write;
use std::path::Path;

use anyhow::Result;
use xxhash_rust::xxh3::Xxh3;

use crate::output::write_whole;
use crate::size::PictureSize;

/// A picture of grey bytes, row by row from the upper left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    size: PictureSize,
    pixels: Vec<u8>,
}

impl Picture {
    /// A black picture.
    pub(crate) fn new(size: PictureSize) -> Self {
        Self { size, pixels: vec![0; size.width as usize * size.height as usize] }
    }

    pub(crate) fn pixels_mut(&mut self) -> &mut [u8] {
        &mut self.pixels
    }

    pub(crate) const fn size(&self) -> PictureSize {
        self.size
    }

    /// A grey byte for each pixel, row by row from the upper left.
    #[must_use]
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// Hash of size and pixels, in hexadecimal.
    #[must_use]
    pub fn hash(&self) -> String {
        let mut hash = Xxh3::new();
        hash.update(&self.size.width.to_le_bytes());
        hash.update(&self.size.height.to_le_bytes());
        hash.update(&self.pixels);
        format!("{:016x}", hash.digest())
    }

    /// Writes it as PNG. The file is there whole or not at all.
    pub(crate) fn write(&self, path: &Path) -> Result<()> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.size.width, self.size.height);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.write_header()?.write_image_data(&self.pixels)?;
        write_whole(path, |file| Ok(file.write_all(&bytes)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hash_tells_pixels_and_sizes_apart() {
        let flat = Picture::new(PictureSize { width: 8, height: 2 });
        let tall = Picture::new(PictureSize { width: 2, height: 8 });
        let mut other = flat.clone();
        other.pixels[5] = 1;
        assert!(flat.hash() != tall.hash() && flat.hash() != other.hash());
        assert_eq!(flat.hash(), flat.clone().hash());
    }
}
