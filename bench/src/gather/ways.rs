//! Ways to make a tile small: ours, and those it was chosen over.

use std::time::Instant;

use anyhow::{Result, ensure};
use memsavvy::gather::codec::{Coding, Encoder, decode};
use memsavvy::gather::head::{Head, Heads};
use memsavvy::gather::place;
use rt_core::TileId;

use super::frames::Frames;
use crate::spread::Spread;

/// A way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    /// What runs: the better of the two predictions, and a Rice code.
    Ours,
    /// The same without the last frame's pixels.
    Spatial,
    /// lz4 of the pixels.
    Lz4,
    /// lz4 of what each pixel is off from the one on its left, or above at the left edge.
    NearLz4,
    /// lz4 of the difference to the last frame.
    DeltaLz4,
    /// All pixels as they are, changed or not.
    Raw,
}

/// Ours, and those it was chosen over.
pub(crate) const WAYS: [Way; 5] = [Way::Ours, Way::Spatial, Way::Lz4, Way::NearLz4, Way::DeltaLz4];

/// What a way costs.
#[derive(Debug)]
pub(crate) struct Cost {
    /// Bytes of a frame after the first, the mean.
    pub(crate) bytes: u64,
    /// Microseconds to make a changed tile small, a median over rounds; of ours only.
    pub(crate) encode_us: f64,
    /// Microseconds to take a changed tile apart and put it in place.
    pub(crate) place_us: f64,
}

/// A tile on its way.
struct Sent {
    at: [usize; 2],
    size: [usize; 2],
    coding: Coding,
    bytes: Vec<u8>,
}

impl Way {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Ours => "ours",
            Self::Spatial => "no last frame",
            Self::Lz4 => "lz4",
            Self::NearLz4 => "near",
            Self::DeltaLz4 => "delta",
            Self::Raw => "raw",
        }
    }

    /// Bytes that the pixels of a changed tile take.
    fn bytes(self, width: usize, pixels: &[u8], before: &[u8], encoder: &mut Encoder) -> Result<usize> {
        let before = match self {
            Self::Ours => Some(before),
            Self::Spatial => None,
            Self::Lz4 => return lz4(pixels),
            Self::Raw => return Ok(pixels.len()),
            Self::NearLz4 => {
                let near = |index: usize| match index {
                    0 => pixels[0],
                    index if index % width == 0 => pixels[index].wrapping_sub(pixels[index - width]),
                    index => pixels[index].wrapping_sub(pixels[index - 1]),
                };
                return lz4(&(0..pixels.len()).map(near).collect::<Vec<u8>>());
            }
            Self::DeltaLz4 => {
                let off = pixels.iter().zip(before).map(|(pixel, before)| pixel.wrapping_sub(*before));
                return lz4(&off.collect::<Vec<u8>>());
            }
        };
        let mut bytes = Vec::new();
        let coding = encoder.encode(width, pixels, before, &mut bytes);
        let mut back = before.map_or_else(|| vec![0; pixels.len()], <[u8]>::to_vec);
        decode(coding, width, &bytes, &mut back)?;
        ensure!(back == pixels, "a tile did not come back as it was");
        Ok(bytes.len())
    }
}

/// Bytes of what lz4 makes of some, or they themselves.
fn lz4(bytes: &[u8]) -> Result<usize> {
    let small = lz4_flex::block::compress(bytes);
    ensure!(lz4_flex::block::decompress(&small, bytes.len())? == bytes, "lz4 lost something");
    Ok(small.len().min(bytes.len()))
}

impl Cost {
    /// What a way costs on frames cut into tiles of that edge.
    pub(crate) fn of(way: Way, frames: &Frames, edge: usize, rounds: usize) -> Result<Self> {
        let later = 1..frames.pictures.len();
        let each = later.clone().map(|frame| Self::bytes_of_frame(way, frames, edge, frame));
        let bytes = each.sum::<Result<u64>>()? / later.len().max(1) as u64;
        let timed = (0..if way == Way::Ours { rounds } else { 0 }).map(|_| round(frames, edge));
        let (encode, place): (Vec<f64>, Vec<f64>) = timed.collect::<Result<Vec<_>>>()?.into_iter().unzip();
        Ok(Self { bytes, encode_us: Spread::of(&encode).median, place_us: Spread::of(&place).median })
    }

    /// Bytes of one frame, heads of tiles included.
    pub(crate) fn bytes_of_frame(way: Way, frames: &Frames, edge: usize, frame: usize) -> Result<u64> {
        let (mut now, mut before, mut encoder) = (Vec::new(), Vec::new(), Encoder::default());
        let (mut heads, mut written) = (Heads::default(), Vec::new());
        let mut bytes = 0;
        for ((id, (at, size)), counts) in (0..).zip(frames.tiles(edge)).zip(frames.counts(frame, edge)) {
            frames.cut(frame, at, size, &mut now);
            frames.cut(frame - 1, at, size, &mut before);
            let is_same = now == before && way != Way::Raw;
            let length = if is_same { 0 } else { way.bytes(size[0], &now, &before, &mut encoder)? };
            let coding = if is_same { Coding::Same } else { Coding::Spatial };
            let head = Head { id: TileId(id), counts: *counts, coding, length: u16::try_from(length)? };
            heads.write(&head, &mut written);
            bytes += length as u64;
        }
        Ok(bytes + written.len() as u64)
    }
}

/// Microseconds that a tile takes to be made small, and to be put in place, over all frames.
fn round(frames: &Frames, edge: usize) -> Result<(f64, f64)> {
    let (mut encoder, mut scratch, mut picture) =
        (Encoder::default(), Vec::new(), frames.pictures[0].clone());
    let (mut encode_s, mut place_s, mut count) = (0.0, 0.0, 0_u32);
    for frame in 1..frames.pictures.len() {
        let cut: Vec<_> = frames
            .tiles(edge)
            .map(|(at, size)| {
                let [mut now, mut before] = [Vec::new(), Vec::new()];
                frames.cut(frame, at, size, &mut now);
                frames.cut(frame - 1, at, size, &mut before);
                (at, size, now, before)
            })
            .collect();
        let mut sent = Vec::with_capacity(cut.len());
        let start = Instant::now();
        for (at, size, now, before) in &cut {
            let mut bytes = Vec::with_capacity(now.len());
            let coding = encoder.encode(size[0], now, Some(before), &mut bytes);
            sent.push(Sent { at: *at, size: *size, coding, bytes });
        }
        encode_s += start.elapsed().as_secs_f64();
        let start = Instant::now();
        for Sent { at, size, coding, bytes } in &sent {
            place((*coding, bytes), (&mut picture, frames.size), *at, *size, &mut scratch)?;
        }
        place_s += start.elapsed().as_secs_f64();
        ensure!(picture == frames.pictures[frame], "SAME_IMAGE: tiles were not put where they belong");
        count += u32::try_from(sent.len())?;
    }
    Ok((encode_s * 1e6 / f64::from(count), place_s * 1e6 / f64::from(count)))
}
