//! Who draws what of a frame, and who is not done yet.

use anyhow::{Context, Result};
use rt_core::schedule::Static;
use rt_core::{Frame, TileId, Tiles};

/// A frame that is being drawn.
///
/// It is whole when every tile is in place, which the displays know, and every living node has said that it has drawn all
/// that it was given.
#[derive(Debug)]
pub(crate) struct Canvas {
    frame: Frame,
    tiles: Tiles,
    /// The node that draws each tile.
    drawn_by: Vec<u32>,
    /// How often each node has yet to say that it is done.
    owed: Vec<u32>,
}

impl Canvas {
    /// A frame of which nothing is drawn, its tiles dealt to `nodes` nodes as they deal them themselves.
    pub(crate) fn new(frame: Frame, nodes: usize) -> Self {
        let tiles = Tiles::of(frame.width, frame.height);
        let schedule = Static::new(tiles, u32::try_from(nodes).unwrap_or(u32::MAX));
        let drawn_by: Vec<u32> = tiles.ids().map(|tile| schedule.node_of(tile)).collect();
        Self { frame, tiles, drawn_by, owed: vec![0; nodes] }
    }

    pub(crate) const fn frame(&self) -> Frame {
        self.frame
    }

    /// Whether all have drawn what they were given.
    pub(crate) fn is_done(&self) -> bool {
        self.owed.iter().all(|owed| *owed == 0)
    }

    /// The tiles of which `is_there` does not hold and that would come from nodes of which `is_dead` holds.
    pub(crate) fn missing_of(
        &self,
        is_dead: impl Fn(usize) -> bool,
        is_there: impl Fn(TileId) -> bool,
    ) -> Vec<TileId> {
        let is_missing = |tile: &TileId| is_dead(self.drawn_by[tile.0 as usize] as usize) && !is_there(*tile);
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
}
