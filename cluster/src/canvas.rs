//! A frame that is being put together from the tiles of all nodes.

use anyhow::Result;
use rt_core::schedule::Ledger;
use rt_core::schedule::ledger::Arrival;
use rt_core::{Frame, Tiles};

use crate::control::{Drawn, TileBatch};
use crate::picture::Picture;
use crate::size::PictureSize;

/// A frame that is being put together. The ledger knows whose the tiles are and which have come.
#[derive(Debug)]
pub(crate) struct Canvas {
    frame: Frame,
    tiles: Tiles,
    picture: Picture,
    counts: Drawn,
}

impl Canvas {
    /// An empty picture.
    pub(crate) fn new(frame: Frame) -> Self {
        Self {
            frame,
            tiles: Tiles::of(frame.width, frame.height),
            picture: Picture::new(PictureSize { width: frame.width, height: frame.height }),
            counts: Drawn { frame: frame.number, ..Drawn::default() },
        }
    }

    pub(crate) const fn frame(&self) -> Frame {
        self.frame
    }

    /// Number of tiles.
    pub(crate) const fn tile_count(&self) -> u32 {
        self.tiles.count()
    }

    pub(crate) fn into_parts(self) -> (Picture, Drawn) {
        (self.picture, self.counts)
    }

    /// Puts tiles of a node in place, each once. What comes a second time, or of a frame that is over, was drawn twice
    /// because somebody died, and is dropped.
    pub(crate) fn put(&mut self, node: u16, batch: &TileBatch, ledger: &mut Ledger<'_>) -> Result<()> {
        for tile in batch.tiles(self.tiles) {
            let tile = tile?;
            if ledger.handle_drawn(node, batch.frame(), tile.id) == Arrival::First {
                self.picture.put(tile.tile, tile.pixels);
                self.counts.add(&tile.counts);
            }
        }
        Ok(())
    }
}
