//! A frame that is being put together from the tiles of all nodes.

use anyhow::{Context, Result, bail};
use rt_core::schedule::Static;
use rt_core::{Frame, TileId, Tiles};

use crate::control::{Drawn, TileBatch};
use crate::picture::Picture;
use crate::size::PictureSize;

/// A frame that is being put together.
///
/// It is whole when every tile is in place and every living node has said that it has drawn all that it was given.
#[derive(Debug)]
pub(crate) struct Canvas {
    frame: Frame,
    tiles: Tiles,
    picture: Picture,
    missing: usize,
    is_there: Vec<bool>,
    /// The node that draws each tile.
    drawn_by: Vec<u32>,
    counts: Drawn,
    /// How often each node has yet to say that it is done.
    owed: Vec<u32>,
}

impl Canvas {
    /// An empty picture, its tiles dealt to `nodes` nodes as they deal them themselves.
    pub(crate) fn new(frame: Frame, nodes: usize) -> Self {
        let tiles = Tiles::of(frame.width, frame.height);
        let schedule = Static::new(tiles, u32::try_from(nodes).unwrap_or(u32::MAX));
        let drawn_by: Vec<u32> = tiles.ids().map(|tile| schedule.node_of(tile)).collect();
        Self {
            frame,
            tiles,
            picture: Picture::new(PictureSize { width: frame.width, height: frame.height }),
            missing: drawn_by.len(),
            is_there: vec![false; drawn_by.len()],
            drawn_by,
            counts: Drawn { frame: frame.number, ..Drawn::default() },
            owed: vec![0; nodes],
        }
    }

    pub(crate) const fn frame(&self) -> Frame {
        self.frame
    }

    /// Tiles that are in place.
    pub(crate) const fn present(&self) -> usize {
        self.is_there.len() - self.missing
    }

    pub(crate) fn is_whole(&self) -> bool {
        self.missing == 0 && self.owed.iter().all(|owed| *owed == 0)
    }

    pub(crate) fn into_parts(self) -> (Picture, Drawn) {
        (self.picture, self.counts)
    }

    /// The tiles that are not there and that would come from nodes of which `is_dead` holds.
    pub(crate) fn missing_of(&self, is_dead: impl Fn(usize) -> bool) -> Vec<TileId> {
        let is_missing = |tile: &TileId| {
            let place = tile.0 as usize;
            !self.is_there[place] && is_dead(self.drawn_by[place] as usize)
        };
        self.tiles.ids().filter(is_missing).collect()
    }

    /// Notes that `node` draws these tiles.
    pub(crate) fn deal(&mut self, tiles: &[TileId], node: usize) {
        for tile in tiles {
            self.drawn_by[tile.0 as usize] = u32::try_from(node).unwrap_or(u32::MAX);
        }
    }

    /// Notes that `node` will say so many times that it is done.
    pub(crate) fn owe(&mut self, node: usize, times: u32) {
        self.owed[node] += times;
    }

    /// Notes that `node` has said it once.
    pub(crate) fn settle(&mut self, node: usize, frame: u32) -> Result<()> {
        let owed = self.owed.get_mut(node).filter(|owed| **owed > 0 && frame == self.frame.number);
        *owed.with_context(|| format!("that frame {frame} is drawn, unasked"))? -= 1;
        Ok(())
    }

    /// Expects nothing more of a process that is dead.
    pub(crate) fn forgive(&mut self, process: usize) {
        self.owed.get_mut(process).into_iter().for_each(|owed| *owed = 0);
    }

    /// Puts tiles in place, each once.
    pub(crate) fn put(&mut self, batch: &TileBatch) -> Result<()> {
        if batch.drawn().frame != self.frame.number {
            bail!("tiles of frame {} for frame {}", batch.drawn().frame, self.frame.number);
        }
        for tile in batch.tiles(self.tiles) {
            let (id, tile, pixels) = tile?;
            if core::mem::replace(&mut self.is_there[id.0 as usize], true) {
                bail!("tile {} twice", id.0);
            }
            self.picture.put(tile, pixels);
            self.missing -= 1;
        }
        self.counts.merge(batch.drawn());
        Ok(())
    }
}
