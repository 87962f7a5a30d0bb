//! Parcels: tiles of one frame on their way from a thread that drew them to a display.
//!
//! # Layout
//! The frame (4 bytes, little-endian); then for each tile its [head](super::head) and the bytes of its pixels.

use anyhow::{Context, Result, bail};
use rt_core::TileId;

use super::head::{Head, Heads};

/// Bytes of the largest parcel; well below a node's credit, so that there is always one under way while the next is
/// filled.
pub(crate) const PARCEL_BYTES_MAX: usize = 32 << 10;

/// Tiles of one frame, packed, each with what was counted while it was drawn.
#[derive(Debug, Default)]
pub(crate) struct Parcel {
    frame: u32,
    tiles: u16,
    heads: Heads,
    bytes: Vec<u8>,
}

/// A tile in a parcel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Packed<'a> {
    pub(crate) head: Head,
    /// As many as the head says.
    pub(crate) bytes: &'a [u8],
}

/// Bytes before the first tile.
const FRAME_BYTES: usize = 4;

impl Parcel {
    /// An empty one for a frame.
    pub(crate) fn new(frame: u32) -> Self {
        Self { frame, ..Self::default() }
    }

    /// Adds a tile, unless there is no room.
    pub(crate) fn push(&mut self, tile: &Packed<'_>) -> bool {
        let (length, mut heads) = (self.bytes.len(), self.heads);
        heads.write(&tile.head, &mut self.bytes);
        self.bytes.extend(tile.bytes);
        if FRAME_BYTES + self.bytes.len() > PARCEL_BYTES_MAX {
            self.bytes.truncate(length);
            return false;
        }
        self.heads = heads;
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
    let mut heads = Heads::default();
    let tiles = core::iter::from_fn(move || {
        if rest.is_empty() {
            return None;
        }
        let taken = take_tile(&mut heads, &mut rest);
        if taken.is_err() {
            rest = &[];
        }
        Some(taken)
    });
    Ok((u32::from_le_bytes(*frame), tiles))
}

fn take_tile<'a>(heads: &mut Heads, rest: &mut &'a [u8]) -> Result<Packed<'a>> {
    let head = heads.read(rest)?;
    let Head { id: TileId(id), length, .. } = head;
    let Some((bytes, after)) = rest.split_at_checked(length.into()) else {
        bail!("tile {id} of {length} bytes, of which {} are there", rest.len());
    };
    *rest = after;
    Ok(Packed { head, bytes })
}

#[cfg(test)]
mod tests {
    use rt_core::TileCounts;

    use super::super::codec::Coding;
    use super::*;

    const COUNTS: TileCounts = TileCounts { primary: 1, hits: 2, shadow: 3, lit: 4, damaged: 5, t_sum: 0.0 };

    #[test]
    fn tiles_travel_in_parcels_that_fit() {
        let codings = [Coding::Same, Coding::Raw, Coding::Spatial, Coding::Temporal];
        let bytes = [7; 1024];
        let packed = |id: u32| {
            let length = if id.is_multiple_of(4) { 0 } else { 1024 - u16::try_from(id).unwrap() };
            let coding = codings[id as usize % 4];
            let head = Head { id: TileId(id), counts: COUNTS, coding, length };
            Packed { head, bytes: &bytes[..length.into()] }
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
        let head = Head { id: TileId(3), counts: COUNTS, coding: Coding::Raw, length: 9 };
        assert!(parcel.push(&Packed { head, bytes: &[1; 9] }));
        let packet = parcel.to_packet();
        assert!(open(&packet[..FRAME_BYTES - 1]).is_err());
        for length in FRAME_BYTES + 1..packet.len() {
            let (_, mut tiles) = open(&packet[..length]).unwrap();
            assert!(tiles.next().unwrap().is_err() && tiles.next().is_none(), "{length}");
        }
    }
}
