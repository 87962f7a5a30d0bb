//! The pixels of a tile, made small without loss.
//!
//! # How it goes
//! Each pixel is predicted, and only how far it is off is written. There are two predictions, and a tile takes the one
//! that is less off in sum:
//! - *spatial*: from the pixels to the left `a`, above `b` and above to the left `c`, as `a + b - c`, but not beyond `a`
//!   and `b` (the median predictor of JPEG-LS, Weinberger, Seroussi and Sapiro, 2000);
//! - *temporal*: the same pixel of the last frame, where both sides have it.
//!
//! What is off, modulo 256, is folded (0, -1, 1, -2 become 0, 1, 2, 3) and written in blocks of 32 values by a Rice code:
//! the low `k` bits as they are, the rest in unary. `k` is 4 bits before each block, 15 where all 32 are zero.
//!
//! # What was tried
//! `bench -- gather` compares it with lz4 on the pixels, on what is off, and on the difference to the last frame.

use core::fmt;

/// How the pixels of a tile are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coding {
    /// Not at all: they are those of the last frame.
    Same,
    /// As they are.
    Raw,
    /// As differences from the pixels around.
    Spatial,
    /// As differences from the last frame.
    Temporal,
}

/// Why bytes were refused as the pixels of a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum CodecError {
    /// They end before the tile does.
    CutOff,
    /// They go on behind the tile's end.
    TooLong,
    /// A block begins with a number that is no parameter.
    Block(u8),
}

/// Makes tiles small. Keeps its scratch memory from tile to tile.
#[derive(Debug, Default)]
pub struct Encoder {
    spatial: Vec<u8>,
    temporal: Vec<u8>,
}

/// Values that share a parameter.
const BLOCK: usize = 32;

/// In place of a parameter: all values of the block are zero.
const ALL_ZERO: u8 = 15;

/// The largest parameter.
const K_MAX: u8 = 7;

/// A longer unary part is given up, and the value follows as it is.
const UNARY_MAX: u32 = 12;

/// What the first pixel is predicted as: the background.
const FIRST: u8 = 51;

impl Encoder {
    /// Adds the pixels of a tile with rows of `width` to `out`. `before` are those of the last frame, if the other side
    /// has them too.
    pub fn encode(
        &mut self,
        width: usize,
        pixels: &[u8],
        before: Option<&[u8]>,
        out: &mut Vec<u8>,
    ) -> Coding {
        if before == Some(pixels) {
            return Coding::Same;
        }
        let start = out.len();
        fold_spatial(width, pixels, &mut self.spatial);
        let (mut coding, mut off) = (Coding::Spatial, &self.spatial);
        if let Some(before) = before {
            self.temporal.clear();
            let difference = |(pixel, before): (&u8, &u8)| fold(pixel.wrapping_sub(*before));
            self.temporal.extend(pixels.iter().zip(before).map(difference));
            if sum(&self.temporal) < sum(&self.spatial) {
                (coding, off) = (Coding::Temporal, &self.temporal);
            }
        }
        write_blocks(off, out);
        if out.len() - start < pixels.len() {
            return coding;
        }
        out.truncate(start);
        out.extend(pixels);
        Coding::Raw
    }
}

/// Puts the pixels of a tile with rows of `width` back together. `pixels` holds those of the last frame before.
///
/// # Errors
/// The bytes are not those of such a tile. What `pixels` then holds is nothing to be shown.
pub fn decode(coding: Coding, width: usize, bytes: &[u8], pixels: &mut [u8]) -> Result<(), CodecError> {
    match coding {
        Coding::Same if bytes.is_empty() => Ok(()),
        Coding::Same => Err(CodecError::TooLong),
        Coding::Raw if bytes.len() < pixels.len() => Err(CodecError::CutOff),
        Coding::Raw if bytes.len() > pixels.len() => Err(CodecError::TooLong),
        Coding::Raw => {
            pixels.copy_from_slice(bytes);
            Ok(())
        }
        Coding::Spatial => {
            read_blocks(bytes, pixels, |_, off| off)?;
            unfold_spatial(width, pixels);
            Ok(())
        }
        Coding::Temporal => read_blocks(bytes, pixels, |before, off| before.wrapping_add(unfold(off))),
    }
}

/// Small numbers of either sign become small ones.
const fn fold(difference: u8) -> u8 {
    let signed = difference.cast_signed();
    ((signed << 1) ^ (signed >> 7)).cast_unsigned()
}

const fn unfold(folded: u8) -> u8 {
    (folded >> 1) ^ (folded & 1).wrapping_neg()
}

/// The pixel that is likely with `left`, `above` and `corner` around it.
#[inline(always)]
fn predict(left: u8, above: u8, corner: u8) -> u8 {
    let [left, above, corner] = [left, above, corner].map(i16::from);
    let likely = (left + above - corner).clamp(left.min(above), left.max(above));
    // Between two bytes.
    likely.cast_unsigned().to_le_bytes()[0]
}

/// How far each pixel is off, folded.
fn fold_spatial(width: usize, pixels: &[u8], folded: &mut Vec<u8>) {
    folded.clear();
    let mut above: &[u8] = &[];
    for row in pixels.chunks_exact(width) {
        let first = above.first().copied().unwrap_or(FIRST);
        folded.push(fold(row[0].wrapping_sub(first)));
        if above.is_empty() {
            folded.extend(row.windows(2).map(|two| fold(two[1].wrapping_sub(two[0]))));
        } else {
            let around = row.windows(2).zip(above.windows(2));
            folded
                .extend(around.map(|(here, up)| fold(here[1].wrapping_sub(predict(here[0], up[1], up[0])))));
        }
        above = row;
    }
}

/// Turns what each pixel is off by into the pixel, in place.
fn unfold_spatial(width: usize, pixels: &mut [u8]) {
    let (first, mut rest) = pixels.split_at_mut(width.min(pixels.len()));
    let mut left = FIRST;
    for pixel in &mut *first {
        *pixel = left.wrapping_add(unfold(*pixel));
        left = *pixel;
    }
    let mut above: &mut [u8] = first;
    while rest.len() >= width {
        let (row, after) = rest.split_at_mut(width);
        let (mut left, mut corner) = (above[0], above[0]);
        for (pixel, above) in row.iter_mut().zip(&*above) {
            *pixel = predict(left, *above, corner).wrapping_add(unfold(*pixel));
            (left, corner) = (*pixel, *above);
        }
        (above, rest) = (row, after);
    }
}

fn sum(values: &[u8]) -> u32 {
    values.iter().map(|value| u32::from(*value)).sum()
}

fn write_blocks(values: &[u8], out: &mut Vec<u8>) {
    let mut writer = BitWriter { out, bits: 0, count: 0 };
    for block in values.chunks(BLOCK) {
        let sum = sum(block);
        if sum == 0 {
            writer.put(ALL_ZERO.into(), 4);
            continue;
        }
        let count = u32::try_from(block.len()).unwrap_or(u32::MAX);
        // About as many bits as the block takes with each parameter.
        let bits = |k: &u8| count * u32::from(k + 1) + (sum >> k);
        let k = (0..=K_MAX).min_by_key(bits).unwrap_or(0);
        writer.put(k.into(), 4);
        block.iter().for_each(|value| writer.put_rice(*value, k.into()));
    }
    writer.finish();
}

/// Bits, the lowest of each byte first.
struct BitWriter<'a> {
    out: &'a mut Vec<u8>,
    bits: u64,
    count: u32,
}

impl BitWriter<'_> {
    /// Adds the low `count` bits of `bits`, which has no others; at most 32.
    #[inline(always)]
    fn put(&mut self, bits: u64, count: u32) {
        self.bits |= bits << self.count;
        self.count += count;
        if self.count >= 32 {
            self.out.extend(&self.bits.to_le_bytes()[..4]);
            self.bits >>= 32;
            self.count -= 32;
        }
    }

    #[inline(always)]
    fn put_rice(&mut self, value: u8, k: u32) {
        let (value, unary) = (u64::from(value), u32::from(value) >> k);
        if unary < UNARY_MAX {
            let low = value & ((1 << k) - 1);
            self.put(((1 << unary) - 1) | (low << (unary + 1)), unary + 1 + k);
        } else {
            self.put(((1 << UNARY_MAX) - 1) | (value << UNARY_MAX), UNARY_MAX + 8);
        }
    }

    fn finish(self) {
        self.out.extend(&self.bits.to_le_bytes()[..self.count.div_ceil(8) as usize]);
    }
}

/// Reads as many values as there are pixels, and makes each pixel of what it was and the value.
fn read_blocks(bytes: &[u8], pixels: &mut [u8], pixel: impl Fn(u8, u8) -> u8) -> Result<(), CodecError> {
    let mut reader = BitReader { rest: bytes, bits: 0, count: 0 };
    for block in pixels.chunks_mut(BLOCK) {
        reader.fill();
        match reader.take(4)? {
            ALL_ZERO => block.iter_mut().for_each(|old| *old = pixel(*old, 0)),
            k @ 0..=K_MAX => {
                for old in block {
                    reader.fill();
                    *old = pixel(*old, reader.take_rice(k.into())?);
                }
            }
            other => return Err(CodecError::Block(other)),
        }
    }
    reader.finish()
}

/// Bits that are not yet read.
struct BitReader<'a> {
    rest: &'a [u8],
    /// The next bits; those beyond `count` are zero, or what `rest` begins with.
    bits: u64,
    count: u32,
}

impl BitReader<'_> {
    /// Makes at least 32 bits ready, or all that are left.
    #[inline(always)]
    fn fill(&mut self) {
        if self.count >= 32 {
            return;
        }
        if let Some(next) = self.rest.first_chunk() {
            self.bits |= u64::from_le_bytes(*next) << self.count;
            let whole = (63 - self.count) / 8;
            self.rest = &self.rest[whole as usize..];
            self.count += whole * 8;
            return;
        }
        while let Some((byte, rest)) = self.rest.split_first().filter(|_| self.count <= 56) {
            self.bits |= u64::from(*byte) << self.count;
            (self.rest, self.count) = (rest, self.count + 8);
        }
    }

    /// The next bits, at most 8.
    #[inline(always)]
    fn take(&mut self, count: u32) -> Result<u8, CodecError> {
        self.skip(count).map(|bits| (bits & ((1 << count) - 1)).to_le_bytes()[0])
    }

    #[inline(always)]
    fn take_rice(&mut self, k: u32) -> Result<u8, CodecError> {
        let unary = self.bits.trailing_ones();
        if unary >= UNARY_MAX {
            return self.skip(UNARY_MAX + 8).map(|bits| (bits >> UNARY_MAX).to_le_bytes()[0]);
        }
        let bits = self.skip(unary + 1 + k)?;
        let low = (bits >> (unary + 1)) & ((1 << k) - 1);
        // More than a byte only in bytes that no encoder wrote; then whatever comes out is as wrong as the rest.
        Ok(((u64::from(unary) << k) | low).to_le_bytes()[0])
    }

    /// Gives back all bits that are ready, and forgets the first `count`.
    #[inline(always)]
    fn skip(&mut self, count: u32) -> Result<u64, CodecError> {
        let bits = self.bits;
        self.count = self.count.checked_sub(count).ok_or(CodecError::CutOff)?;
        self.bits >>= count;
        Ok(bits)
    }

    /// Whether nothing is left but what fills the last byte.
    fn finish(self) -> Result<(), CodecError> {
        if self.rest.is_empty() && self.count < 8 { Ok(()) } else { Err(CodecError::TooLong) }
    }
}

impl fmt::Display for CodecError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::CutOff => write!(f, "its pixels are cut off"),
            Self::TooLong => write!(f, "it has more pixels than the tile"),
            Self::Block(got) => write!(f, "its pixels have a block of parameter {got}"),
        }
    }
}

impl core::error::Error for CodecError {}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers without much order.
    fn noise(seed: u32, count: usize) -> Vec<u8> {
        let mut state = seed.wrapping_mul(2_654_435_761) | 1;
        let mut next = || {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            (state >> 24).to_le_bytes()[0]
        };
        (0..count).map(|_| next()).collect()
    }

    fn pictures(width: usize, height: usize) -> Vec<Vec<u8>> {
        let at = |f: &dyn Fn(usize, usize) -> usize| {
            (0..width * height).map(|i| f(i % width, i / width).to_le_bytes()[0]).collect::<Vec<u8>>()
        };
        vec![
            vec![51; width * height],
            vec![255; width * height],
            at(&|x, y| x * 3 + y),
            at(&|x, y| if x > y { 20 } else { 200 }),
            at(&|x, y| (x * y) ^ (x >> 1)),
            noise(1, width * height),
            noise(2, width * height).iter().map(|one| 100 + (one & 7)).collect(),
        ]
    }

    #[test]
    fn every_tile_comes_back_as_it_was() {
        let mut encoder = Encoder::default();
        let mut seen = [0; 4];
        for (width, height) in [(32, 32), (8, 8), (1, 1), (1, 32), (32, 1), (5, 7), (31, 29)] {
            let pictures = pictures(width, height);
            for pixels in &pictures {
                for before in pictures.iter().map(Some).chain([None]) {
                    let mut bytes = vec![7];
                    let coding = encoder.encode(width, pixels, before.map(Vec::as_slice), &mut bytes);
                    assert!(bytes.len() <= 1 + pixels.len());
                    let mut back = before.cloned().unwrap_or_else(|| vec![0; pixels.len()]);
                    decode(coding, width, &bytes[1..], &mut back).unwrap();
                    assert_eq!(&back, pixels, "{width}x{height} {coding:?}");
                    seen[coding as usize] += 1;
                }
            }
        }
        assert!(seen.iter().all(|count| *count > 0), "{seen:?}");
    }

    #[test]
    fn differences_of_either_sign_survive_folding() {
        for difference in 0..=255 {
            assert_eq!(unfold(fold(difference)), difference);
        }
        assert_eq!([0, 255, 1, 254].map(fold), [0, 1, 2, 3]);
    }

    #[test]
    fn even_tiles_take_next_to_nothing() {
        let mut bytes = Vec::new();
        let mut encoder = Encoder::default();
        assert_eq!(encoder.encode(32, &[51; 1024], None, &mut bytes), Coding::Spatial);
        assert_eq!(bytes.len(), 16);
        let before = vec![9; 1024];
        assert_eq!(encoder.encode(32, &before, Some(&before), &mut bytes), Coding::Same);
        assert_eq!(bytes.len(), 16);
    }

    #[test]
    fn bytes_that_are_none_are_refused() {
        let pixels: Vec<u8> = noise(3, 1024).iter().map(|one| one & 15).collect();
        let mut bytes = Vec::new();
        let coding = Encoder::default().encode(32, &pixels, None, &mut bytes);
        assert_eq!(coding, Coding::Spatial);
        let read = |coding, bytes: &[u8]| decode(coding, 32, bytes, &mut [0; 1024]);
        for length in 0..bytes.len() {
            assert_eq!(read(coding, &bytes[..length]), Err(CodecError::CutOff), "{length}");
        }
        assert_eq!(read(coding, &[&bytes[..], &[0]].concat()), Err(CodecError::TooLong));
        assert_eq!(read(Coding::Raw, &[0; 1023]), Err(CodecError::CutOff));
        assert_eq!(read(Coding::Raw, &[0; 1025]), Err(CodecError::TooLong));
        assert_eq!(read(Coding::Same, &[0]), Err(CodecError::TooLong));
        assert_eq!(read(Coding::Temporal, &[8]), Err(CodecError::Block(8)));
        // Whatever comes, an answer.
        for seed in 0..2000 {
            let garbage = noise(seed, 1 + seed as usize % 1500);
            let _ = (read(Coding::Spatial, &garbage), read(Coding::Temporal, &garbage));
        }
    }
}
