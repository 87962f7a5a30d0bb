//! The samples of a brick.

use crate::volume::{BRICK_EDGE, SampleKind};

/// A brick, borrowed from its record.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Brick<'a> {
    U8(&'a [u8; SAMPLES]),
    U16(&'a [[u8; 2]; SAMPLES]),
    F32(&'a [[u8; 4]; SAMPLES]),
}

impl<'a> Brick<'a> {
    /// The brick in a record, or `None` when that is too short.
    #[inline]
    pub(crate) fn new(kind: SampleKind, record: &'a [u8]) -> Option<Self> {
        match kind {
            SampleKind::U8 => record.first_chunk().map(Self::U8),
            SampleKind::U16 => record.as_chunks().0.first_chunk().map(Self::U16),
            SampleKind::F32 => record.as_chunks().0.first_chunk().map(Self::F32),
        }
    }

    /// The samples at the corners of a voxel cell, which is named by its lowest: `x + 2 y + 4 z` is at `(x, y, z)`.
    #[inline]
    pub(crate) fn corners(&self, [x, y, z]: [i32; 3]) -> [f32; 8] {
        let lowest = (x + 8 * y + 64 * z).cast_unsigned() as usize;
        CORNERS.map(|corner| self.sample(lowest + corner))
    }

    #[inline]
    fn sample(&self, index: usize) -> f32 {
        let index = index % SAMPLES;
        match self {
            Self::U8(samples) => f32::from(samples[index]),
            Self::U16(samples) => f32::from(u16::from_le_bytes(samples[index])),
            Self::F32(samples) => f32::from_le_bytes(samples[index]),
        }
    }
}

const SAMPLES: usize = crate::volume::BRICK_SAMPLES;

/// From a sample to those of the same cell.
pub(crate) const CORNERS: [usize; 8] =
    [0, 1, BRICK_EDGE, BRICK_EDGE + 1, 64, 65, 64 + BRICK_EDGE, 65 + BRICK_EDGE];
