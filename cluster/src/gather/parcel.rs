//! Parcels: tiles of one frame on their way from a thread that drew them to a display.
//!
//! # Layout
//! The frame (4 bytes); then for each tile its number (4 bytes), what was counted while it was drawn (5 times 2 bytes),
//! the coding and the length of its bytes (2 bits above 14 bits), little-endian, and the bytes.

use anyhow::{Context, Result, bail};
use rt_core::{TILE_SIZE, TileCounts, TileId};

use super::codec::Coding;

/// Bytes of the largest parcel; well below a node's credit, so that there is always one under way while the next is
/// filled.
pub(crate) const PARCEL_BYTES_MAX: usize = 32 << 10;

/// Tiles of one frame, packed, each with what was counted while it was drawn.
#[derive(Debug, Default)]
pub(crate) struct Parcel {
    frame: u32,
    tiles: u16,
    bytes: Vec<u8>,
}

/// A tile in a parcel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Packed<'a> {
    pub(crate) id: TileId,
    pub(crate) counts: TileCounts,
    pub(crate) coding: Coding,
    pub(crate) bytes: &'a [u8],
}

/// Bytes before those of a tile's pixels.
const HEAD_BYTES: usize = 4 + 5 * 2 + 2;

/// Bytes before the first tile.
const FRAME_BYTES: usize = 4;

/// Bits of a length.
const LENGTH_BITS: u32 = 14;

const _: () = assert!(TILE_SIZE * TILE_SIZE < 1 << LENGTH_BITS);

impl Parcel {
    /// An empty one for a frame.
    pub(crate) fn new(frame: u32) -> Self {
        Self { frame, ..Self::default() }
    }

    /// Adds a tile, unless there is no room.
    pub(crate) fn push(&mut self, tile: &Packed<'_>) -> bool {
        if FRAME_BYTES + self.bytes.len() + HEAD_BYTES + tile.bytes.len() > PARCEL_BYTES_MAX {
            return false;
        }
        let length = u16::try_from(tile.bytes.len()).unwrap_or(u16::MAX);
        self.bytes.extend(tile.id.0.to_le_bytes());
        // A tile has 1024 pixels, and each has a ray or two.
        let TileCounts { primary, hits, shadow, lit, damaged, .. } = tile.counts;
        for count in [primary, hits, shadow, lit, damaged] {
            self.bytes.extend(u16::try_from(count).unwrap_or(u16::MAX).to_le_bytes());
        }
        self.bytes.extend((length | (tile.coding as u16) << LENGTH_BITS).to_le_bytes());
        self.bytes.extend(tile.bytes);
        self.tiles += 1;
        true
    }

    pub(crate) const fn frame(&self) -> u32 {
        self.frame
    }

    pub(crate) const fn tiles(&self) -> u16 {
        self.tiles
    }

    pub(crate) fn to_packet(&self) -> Vec<u8> {
        [&self.frame.to_le_bytes()[..], &self.bytes].concat()
    }
}

/// The frame of a packet, and its tiles.
pub(crate) fn open(packet: &[u8]) -> Result<(u32, impl Iterator<Item = Result<Packed<'_>>>)> {
    let (frame, mut rest) = packet.split_first_chunk().context("half a parcel of tiles")?;
    let tiles = core::iter::from_fn(move || {
        if rest.is_empty() {
            return None;
        }
        let taken = take_tile(rest);
        rest = taken.as_ref().map_or(&[][..], |(_, rest)| rest);
        Some(taken.map(|(tile, _)| tile))
    });
    Ok((u32::from_le_bytes(*frame), tiles))
}

fn take_tile(bytes: &[u8]) -> Result<(Packed<'_>, &[u8])> {
    let (id, rest) = bytes.split_first_chunk().context("half a tile's number")?;
    let (counts, rest) = rest.split_first_chunk::<10>().context("half a tile's counts")?;
    let (head, rest) = rest.split_first_chunk().context("half a tile's length")?;
    let (id, head) = (TileId(u32::from_le_bytes(*id)), u16::from_le_bytes(*head));
    let length = usize::from(head & ((1 << LENGTH_BITS) - 1));
    let Some((bytes, rest)) = rest.split_at_checked(length) else {
        bail!("tile {} of {length} bytes, of which {} are there", id.0, rest.len());
    };
    let coding = match head >> LENGTH_BITS {
        0 => Coding::Same,
        1 => Coding::Raw,
        2 => Coding::Spatial,
        _ => Coding::Temporal,
    };
    Ok((Packed { id, counts: counts_of(counts), coding, bytes }, rest))
}

fn counts_of(bytes: &[u8; 10]) -> TileCounts {
    let mut counts = bytes.as_chunks::<2>().0.iter().map(|count| u64::from(u16::from_le_bytes(*count)));
    let mut next = || counts.next().unwrap_or_default();
    let (primary, hits, shadow, lit, damaged) = (next(), next(), next(), next(), next());
    TileCounts { primary, hits, shadow, lit, damaged, t_sum: 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COUNTS: TileCounts = TileCounts { primary: 1, hits: 2, shadow: 3, lit: 4, damaged: 5, t_sum: 0.0 };

    #[test]
    fn tiles_travel_in_parcels_that_fit() {
        let codings = [Coding::Same, Coding::Raw, Coding::Spatial, Coding::Temporal];
        let bytes = [7; 1024];
        let packed = |id: u32| Packed {
            id: TileId(id),
            counts: COUNTS,
            coding: codings[id as usize % 4],
            bytes: if id.is_multiple_of(4) { &[] } else { &bytes[..1024 - id as usize] },
        };
        let mut parcel = Parcel::new(7);
        let pushed = (0..1000).take_while(|id| parcel.push(&packed(*id))).count();
        let packet = parcel.to_packet();
        assert!(pushed > 30 && pushed == usize::from(parcel.tiles()) && packet.len() <= PARCEL_BYTES_MAX);
        let (frame, tiles) = open(&packet).unwrap();
        assert_eq!(frame, 7);
        let tiles: Vec<_> = tiles.map(Result::unwrap).collect();
        assert_eq!(tiles, (0..1000).take(pushed).map(packed).collect::<Vec<_>>());
    }

    #[test]
    fn half_a_parcel_is_an_error() {
        let mut parcel = Parcel::new(7);
        assert!(parcel.push(&Packed { id: TileId(3), counts: COUNTS, coding: Coding::Raw, bytes: &[1; 9] }));
        let packet = parcel.to_packet();
        assert!(open(&packet[..FRAME_BYTES - 1]).is_err());
        for length in FRAME_BYTES + 1..packet.len() {
            let (_, mut tiles) = open(&packet[..length]).unwrap();
            assert!(tiles.next().unwrap().is_err() && tiles.next().is_none(), "{length}");
        }
    }
}
