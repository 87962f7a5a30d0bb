//! What is known of each tile of a frame beyond its pixels, and how it travels.

use anyhow::{Context, Result, bail};
use rt_core::{Frame, TileId, Tiles};

use crate::link::PACKET_BYTES_MAX;

/// Facts about some tiles, packed into a packet.
///
/// # Layout
/// For each tile, little-endian: its number (4 bytes), nanoseconds (8), misses (4), whether owners follow (1); then for
/// each pixel, row by row, the number of the owner of the page behind it plus one, 0 where nothing is hit.
#[derive(Debug, Default)]
pub(crate) struct FactBatch {
    frame: u32,
    bytes: Vec<u8>,
}

/// What was measured of a tile.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct TileFacts {
    pub(crate) cost_ns: u64,
    pub(crate) misses: u32,
}

/// What is known of all tiles of a frame.
#[derive(Clone, Debug)]
pub(crate) struct FrameFacts {
    frame: u32,
    pub(crate) tiles: Tiles,
    /// For each tile who drew it, once that is known.
    pub(crate) drawn_by: Vec<Option<u16>>,
    pub(crate) measured: Vec<TileFacts>,
    /// For each tile whether somebody has told of it.
    is_told: Vec<bool>,
    /// For each pixel the owner of the page behind it plus one, 0 where nothing is hit.
    pub(crate) owners: Vec<u8>,
    /// The picture's width.
    pub(crate) width: usize,
}

/// Bytes of a tile's facts without owners.
const RECORD_BYTES: usize = 4 + 8 + 4 + 1;

impl FactBatch {
    pub(crate) fn new(frame: u32) -> Self {
        Self { frame, bytes: Vec::new() }
    }

    /// Adds what is known of a tile, unless the packet would become too large.
    pub(crate) fn push(&mut self, TileId(id): TileId, facts: TileFacts, owners: &[u8]) -> bool {
        // A letter and the frame's number come first.
        if 5 + self.bytes.len() + RECORD_BYTES + owners.len() > PACKET_BYTES_MAX {
            return false;
        }
        self.bytes.extend(id.to_le_bytes());
        self.bytes.extend(facts.cost_ns.to_le_bytes());
        self.bytes.extend(facts.misses.to_le_bytes());
        self.bytes.push(u8::from(!owners.is_empty()));
        self.bytes.extend(owners);
        true
    }

    pub(crate) const fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    pub(crate) fn to_packet(&self, letter: u8) -> Vec<u8> {
        [&[letter][..], &self.frame.to_le_bytes(), &self.bytes].concat()
    }

    pub(crate) fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let (frame, bytes) = bytes.split_first_chunk().context("half a frame's number")?;
        Ok(Self { frame: u32::from_le_bytes(*frame), bytes: bytes.to_vec() })
    }
}

impl FrameFacts {
    /// Nothing known yet.
    pub(crate) fn new(frame: &Frame) -> Self {
        let tiles = Tiles::of(frame.width, frame.height);
        let (count, width) = (tiles.count() as usize, frame.width as usize);
        Self {
            frame: frame.number,
            tiles,
            drawn_by: vec![None; count],
            measured: vec![TileFacts::default(); count],
            is_told: vec![false; count],
            owners: vec![0; width * frame.height as usize],
            width,
        }
    }

    /// A tile of a node was put in place.
    pub(crate) fn note_drawn(&mut self, TileId(id): TileId, node: u16) {
        self.drawn_by.get_mut(id as usize).into_iter().for_each(|drawn_by| *drawn_by = Some(node));
    }

    /// Whether every tile was told of whose node is not dead.
    pub(crate) fn is_whole(&self, is_dead: impl Fn(u16) -> bool) -> bool {
        let mut tiles = self.is_told.iter().zip(&self.drawn_by);
        tiles.all(|(is_told, node)| *is_told || node.is_some_and(&is_dead))
    }

    /// Takes what a node tells of tiles that it drew. Of a tile that two nodes drew the last to tell is believed; what is told
    /// of a frame that is over comes too late.
    pub(crate) fn take(&mut self, batch: &FactBatch, node: u16) -> Result<()> {
        if batch.frame < self.frame {
            return Ok(());
        }
        if batch.frame > self.frame {
            bail!("facts of frame {} for frame {}", batch.frame, self.frame);
        }
        let mut rest = &batch.bytes[..];
        while !rest.is_empty() {
            rest = self.take_one(rest, node).context("half of what is known of a tile")??;
        }
        Ok(())
    }

    /// Takes the first record; `None` when it is cut off.
    fn take_one<'a>(&mut self, bytes: &'a [u8], node: u16) -> Option<Result<&'a [u8]>> {
        let (id, rest) = bytes.split_first_chunk()?;
        let (cost_ns, rest) = rest.split_first_chunk()?;
        let (misses, rest) = rest.split_first_chunk()?;
        let (has_owners, rest) = rest.split_first()?;
        let id = u32::from_le_bytes(*id);
        let Some(tile) = self.tiles.get(TileId(id)) else {
            return Some(Err(anyhow::anyhow!("facts of tile {id} of a picture that has fewer")));
        };
        let pixels = if *has_owners == 0 { 0 } else { tile.pixels() };
        let (owners, rest) = rest.split_at_checked(pixels)?;
        for (y, row) in (tile.y as usize..).zip(owners.chunks_exact(tile.width as usize)) {
            let start = y * self.width + tile.x as usize;
            self.owners[start..start + row.len()].copy_from_slice(row);
        }
        self.drawn_by[id as usize].get_or_insert(node);
        self.is_told[id as usize] = true;
        let (cost_ns, misses) = (u64::from_le_bytes(*cost_ns), u32::from_le_bytes(*misses));
        self.measured[id as usize] = TileFacts { cost_ns, misses };
        Some(Ok(rest))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use rt_core::camera::{Orbit, OrbitPlace};
    use rt_core::{Bounds, TILE_SIZE};

    /// Facts of a frame of this size of which nothing is known.
    pub(in crate::diagnostic) fn unknown(width: u32, height: u32) -> FrameFacts {
        let orbit = Orbit::around(&Bounds { low: [0.0; 3].into(), high: [1.0; 3].into() });
        let place = OrbitPlace { radius: 1.5, elevation: 0.0, frame: 3, frames: 8 };
        FrameFacts::new(&Frame::on_orbit(&orbit, &place, width, height).unwrap())
    }

    #[test]
    fn facts_travel_and_land_where_they_belong() {
        let (width, height) = (TILE_SIZE + 5, TILE_SIZE + 2);
        let mut facts = unknown(width, height);
        let mut batch = FactBatch::new(3);
        for id in facts.tiles.ids() {
            let pixels = facts.tiles.get(id).unwrap().pixels();
            let owners = if id.0 == 2 { Vec::new() } else { vec![u8::try_from(id.0).unwrap() + 1; pixels] };
            let measured = TileFacts { cost_ns: 10 << id.0, misses: id.0 };
            assert!(batch.push(id, measured, &owners));
        }
        let packet = batch.to_packet(b'I');
        facts.take(&FactBatch::from_bytes(&packet[1..]).unwrap(), 7).unwrap();
        assert!(facts.drawn_by.iter().all(|node| *node == Some(7)));
        assert_eq!(facts.measured[3], TileFacts { cost_ns: 80, misses: 3 });
        let at = |x: u32, y: u32| facts.owners[(y * width + x) as usize];
        assert_eq!((at(0, 0), at(TILE_SIZE, 0), at(0, TILE_SIZE), at(TILE_SIZE, TILE_SIZE)), (1, 2, 0, 4));
    }

    #[test]
    fn garbage_is_refused() {
        let mut facts = unknown(TILE_SIZE, TILE_SIZE);
        let mut good = FactBatch::new(3);
        assert!(good.push(TileId(0), TileFacts::default(), &[1; (TILE_SIZE * TILE_SIZE) as usize]));
        let packet = good.to_packet(b'I');
        for length in 6..packet.len() {
            let cut = FactBatch::from_bytes(&packet[1..length]).unwrap();
            assert!(facts.take(&cut, 0).unwrap_err().to_string().contains("half"), "{length}");
        }
        assert!(FactBatch::from_bytes(&[1, 2, 3]).is_err());
        assert!(facts.take(&good, 0).is_ok());
        assert!(facts.take(&FactBatch::new(4), 0).unwrap_err().to_string().contains("frame 4"));
        let mut stray = FactBatch::new(3);
        assert!(stray.push(TileId(1), TileFacts::default(), &[]));
        assert!(facts.take(&stray, 0).unwrap_err().to_string().contains("tile 1"));
        while stray.push(TileId(0), TileFacts::default(), &[0; 1000]) {}
        assert!(stray.to_packet(b'I').len() <= PACKET_BYTES_MAX);
    }
}
