//! Parcels: tiles of one frame on their way from a thread that drew them to a display.
//!
//! # Layout
//! What was counted while they were drawn; then for each tile its number (4 bytes), the coding and the length of its
//! bytes (2 bits above 14 bits), little-endian, and the bytes.

use anyhow::{Context, Result, bail};
use rt_core::{TILE_SIZE, TileCounts, TileId};

use super::codec::Coding;
use crate::control::Drawn;

/// Bytes of the largest parcel; well below a node's credit, so that there is always one under way while the next is
/// filled.
pub(crate) const PARCEL_BYTES_MAX: usize = 32 << 10;

/// Tiles of one frame, packed, and what was counted while they were drawn.
#[derive(Debug, Default)]
pub(crate) struct Parcel {
    drawn: Drawn,
    tiles: u16,
    bytes: Vec<u8>,
}

/// A tile in a parcel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Packed<'a> {
    pub(crate) id: TileId,
    pub(crate) coding: Coding,
    pub(crate) bytes: &'a [u8],
}

/// Bytes before those of a tile's pixels.
const HEAD_BYTES: usize = 4 + 2;

/// Bits of a length.
const LENGTH_BITS: u32 = 14;

const _: () = assert!(TILE_SIZE * TILE_SIZE < 1 << LENGTH_BITS);

impl Parcel {
    /// An empty one for a frame.
    pub(crate) fn new(frame: u32) -> Self {
        Self { drawn: Drawn { frame, ..Drawn::default() }, ..Self::default() }
    }

    /// Adds a tile and what was counted for it, unless there is no room.
    pub(crate) fn push(&mut self, tile: Packed<'_>, counts: &TileCounts) -> bool {
        if Drawn::BYTES + self.bytes.len() + HEAD_BYTES + tile.bytes.len() > PARCEL_BYTES_MAX {
            return false;
        }
        let length = u16::try_from(tile.bytes.len()).unwrap_or(u16::MAX);
        self.bytes.extend(tile.id.0.to_le_bytes());
        self.bytes.extend((length | (tile.coding as u16) << LENGTH_BITS).to_le_bytes());
        self.bytes.extend(tile.bytes);
        self.drawn.add(counts);
        self.tiles += 1;
        true
    }

    pub(crate) const fn tiles(&self) -> u16 {
        self.tiles
    }

    pub(crate) fn to_packet(&self) -> Vec<u8> {
        [&self.drawn.to_bytes()[..], &self.bytes].concat()
    }
}

/// What was counted while the tiles of a packet were drawn, and the tiles.
pub(crate) fn open(packet: &[u8]) -> Result<(Drawn, impl Iterator<Item = Result<Packed<'_>>>)> {
    let (drawn, mut rest) = packet.split_first_chunk().context("half a parcel of tiles")?;
    let tiles = core::iter::from_fn(move || {
        if rest.is_empty() {
            return None;
        }
        let taken = take_tile(rest);
        rest = taken.as_ref().map_or(&[][..], |(_, rest)| rest);
        Some(taken.map(|(tile, _)| tile))
    });
    Ok((Drawn::from_bytes(drawn), tiles))
}

fn take_tile(bytes: &[u8]) -> Result<(Packed<'_>, &[u8])> {
    let (id, rest) = bytes.split_first_chunk().context("half a tile's number")?;
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
    Ok((Packed { id, coding, bytes }, rest))
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
            coding: codings[id as usize % 4],
            bytes: if id.is_multiple_of(4) { &[] } else { &bytes[..1024 - id as usize] },
        };
        let mut parcel = Parcel::new(7);
        let pushed = (0..1000).take_while(|id| parcel.push(packed(*id), &COUNTS)).count();
        let packet = parcel.to_packet();
        assert!(pushed > 30 && pushed == usize::from(parcel.tiles()) && packet.len() <= PARCEL_BYTES_MAX);
        let (drawn, tiles) = open(&packet).unwrap();
        let n = pushed as u64;
        let (primary_rays, hits, shadow_rays, lit, damaged) = (n, 2 * n, 3 * n, 4 * n, 5 * n);
        assert_eq!(drawn, Drawn { frame: 7, primary_rays, hits, shadow_rays, lit, damaged });
        let tiles: Vec<_> = tiles.map(Result::unwrap).collect();
        assert_eq!(tiles, (0..1000).take(pushed).map(packed).collect::<Vec<_>>());
    }

    #[test]
    fn half_a_parcel_is_an_error() {
        let mut parcel = Parcel::new(7);
        assert!(parcel.push(Packed { id: TileId(3), coding: Coding::Raw, bytes: &[1; 9] }, &COUNTS));
        let packet = parcel.to_packet();
        assert!(open(&packet[..Drawn::BYTES - 1]).is_err());
        for length in Drawn::BYTES + 1..packet.len() {
            let (_, mut tiles) = open(&packet[..length]).unwrap();
            assert!(tiles.next().unwrap().is_err() && tiles.next().is_none(), "{length}");
        }
    }
}
