//! A volume in a file, of whatever format.

use super::bytes::Bytes;
use super::error::VolumeError;
use super::sample::Endian;
use super::shape::VolumeShape;
use super::{VolumeSource, run};

/// A volume in a file whose header was read.
#[derive(Debug)]
pub struct FileVolume {
    shape: VolumeShape,
    endian: Endian,
    bytes: Bytes,
    /// Bytes on their way to numbers.
    buffer: Vec<u8>,
}

impl FileVolume {
    pub(super) fn new(shape: VolumeShape, endian: Endian, bytes: Bytes) -> Self {
        Self { shape, endian, bytes, buffer: vec![0; BUFFER_BYTES] }
    }
}

impl VolumeSource for FileVolume {
    fn shape(&self) -> &VolumeShape {
        &self.shape
    }

    fn read_samples(&mut self, first: u64, samples: &mut [f32]) -> Result<(), VolumeError> {
        run::check(&self.shape, first, samples.len());
        let length = self.shape.sample.bytes();
        let mut offset = first * length as u64;
        for samples in samples.chunks_mut(BUFFER_BYTES / length) {
            let bytes = &mut self.buffer[..samples.len() * length];
            self.bytes.read_at(offset, bytes)?;
            self.shape.sample.decode(self.endian, bytes, samples);
            offset += bytes.len() as u64;
        }
        Ok(())
    }
}

/// A multiple of the length of every sample.
const BUFFER_BYTES: usize = 1 << 16;
