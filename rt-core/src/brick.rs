//! The samples of a brick.

use crate::volume::{BRICK_EDGE, SampleKind, bits};

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

    /// The samples at or above an isovalue: for each z a bit `x + 8 y` each.
    pub(crate) fn inside(&self, isovalue: f32) -> [u64; BRICK_EDGE] {
        let mut bytes = [0_u8; SAMPLES];
        match self {
            Self::U8(samples) => mark(&mut bytes, samples, |&sample| f32::from(sample) >= isovalue),
            Self::U16(samples) => {
                mark(&mut bytes, samples, |&sample| f32::from(u16::from_le_bytes(sample)) >= isovalue);
            }
            Self::F32(samples) => mark(&mut bytes, samples, |&sample| f32::from_le_bytes(sample) >= isovalue),
        }
        let mut inside = [0; BRICK_EDGE];
        for (slice, bytes) in inside.iter_mut().zip(bytes.chunks_exact(64)) {
            *slice = bits(bytes);
        }
        inside
    }

    /// All samples, as numbers.
    #[inline(always)]
    pub(crate) fn samples(&self, to: &mut [f32; SAMPLES]) {
        match self {
            Self::U8(samples) => copy(to, samples, |&sample| f32::from(sample)),
            Self::U16(samples) => copy(to, samples, |&sample| f32::from(u16::from_le_bytes(sample))),
            Self::F32(samples) => copy(to, samples, |&sample| f32::from_le_bytes(sample)),
        }
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

/// Writes 1 where something is true, else 0.
#[inline(always)]
fn mark<T>(bytes: &mut [u8; SAMPLES], of: &[T; SAMPLES], is: impl Fn(&T) -> bool) {
    bytes.iter_mut().zip(of).for_each(|(byte, of)| *byte = u8::from(is(of)));
}

#[inline(always)]
fn copy<T>(to: &mut [f32; SAMPLES], from: &[T; SAMPLES], number: impl Fn(&T) -> f32) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to = number(from));
}

pub(crate) const SAMPLES: usize = crate::volume::BRICK_SAMPLES;

/// From a sample to those of the same cell.
pub(crate) const CORNERS: [usize; 8] =
    [0, 1, BRICK_EDGE, BRICK_EDGE + 1, 64, 65, 64 + BRICK_EDGE, 65 + BRICK_EDGE];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_those_of_the_bytes() {
        for seed in [0_u64, u64::MAX, 0x9e37_79b9_7f4a_7c15, 1, 1 << 63, 0x0180_0000_ffff_0001] {
            let bytes: [u8; 64] = core::array::from_fn(|i| u8::from(seed >> i & 1 != 0));
            assert_eq!(bits(&bytes), seed);
        }
    }

    #[test]
    fn the_samples_inside_are_those_at_or_above_the_isovalue() {
        let samples: [u8; 512] = core::array::from_fn(|i| u8::try_from(i * 7 % 251).expect("small"));
        let inside = Brick::U8(&samples).inside(100.0);
        for (i, sample) in samples.iter().enumerate() {
            assert_eq!(inside[i / 64] >> (i % 64) & 1 != 0, *sample >= 100, "{i}");
        }
    }
}
