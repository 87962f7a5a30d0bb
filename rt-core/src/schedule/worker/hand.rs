//! The tiles that a node has in hand, and what it knows of all others.

use crate::schedule::message::Gift;
use crate::schedule::mutants::{self, Mutant};
use crate::schedule::page_map::PageMap;
use crate::tile::TileId;

/// What a node knows of one tile. Opaque; start with [`TileEntry::EMPTY`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TileEntry {
    pub(super) state: TileState,
    /// To whom it was given.
    pub(super) to: u16,
    /// What it takes here to draw it, in microseconds: measured and smoothed, or a guess; 0 before the first.
    pub(super) cost_us: u32,
    pub(super) is_measured: bool,
    /// It came from another node in this frame, with its cost.
    pub(super) is_gift: bool,
    pub(super) map: PageMap,
}

/// Where a tile of this frame is, as one node sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TileState {
    /// With somebody else, or drawn.
    Elsewhere,
    /// In hand, to be drawn.
    Queued,
    /// A thread draws it.
    Drawing,
    /// Drawn; the display has not said that it has it. It is to be sent, for the first time or again, when `is_due`.
    Drawn {
        /// Whether it is to be sent now.
        is_due: bool,
    },
    /// Given away; the thief has not said that it has it.
    Given,
    /// The display has it from here.
    Shown,
}

/// Tiles in drawing order, of which some are queued.
#[derive(Debug)]
pub(super) struct Hand<'s> {
    pub(super) tiles: &'s mut [TileEntry],
    /// All tiles, along the curve.
    order: &'s mut [u32],
    is_backwards: bool,
    /// No tile before this place of the order is queued.
    cursor: usize,
    pub(super) queued: u32,
    /// What the queued tiles will take.
    pub(super) queued_us: u64,
    /// A tile that takes at least so long is drawn first; `u32::MAX` for none.
    dear_us: u32,
    dear: u32,
    /// What a tile takes that nobody has measured.
    mean_us: u32,
}

impl<'s> Hand<'s> {
    pub(super) fn new(tiles: &'s mut [TileEntry], order: &'s mut [u32]) -> Self {
        tiles.fill(TileEntry::EMPTY);
        Self {
            tiles,
            order,
            is_backwards: false,
            cursor: 0,
            queued: 0,
            queued_us: 0,
            dear_us: u32::MAX,
            dear: 0,
            mean_us: MEAN_US,
        }
    }

    pub(super) fn into_storage(self) -> (&'s mut [TileEntry], &'s mut [u32]) {
        (self.tiles, self.order)
    }

    /// Puts away what is queued, and everything if a new frame begins. Odd frames are drawn backwards.
    pub(super) fn clear(&mut self, frame: u32, is_new_frame: bool, dear_us: u32) {
        for tile in self.tiles.iter_mut() {
            tile.is_gift &= !is_new_frame;
            if mutants::is_on(Mutant::KeepOldHand) && tile.state == TileState::Queued {
                continue;
            }
            if is_new_frame || matches!(tile.state, TileState::Queued | TileState::Given) {
                tile.state = TileState::Elsewhere;
            }
        }
        self.is_backwards = !frame.is_multiple_of(2);
        (self.queued, self.queued_us, self.dear, self.dear_us) = (0, 0, 0, dear_us);
        self.cursor = 0;
    }

    pub(super) fn entry(&mut self, tile: TileId) -> Option<&mut TileEntry> {
        self.tiles.get_mut(tile.0 as usize)
    }

    /// Puts a tile into the queue that is not there.
    pub(super) fn queue(&mut self, tile: TileId) {
        let mean_us = self.mean_us;
        let Some(entry) = self.entry(tile) else { return };
        entry.state = TileState::Queued;
        if entry.cost_us == 0 {
            entry.cost_us = mean_us;
        }
        let cost_us = entry.cost_us;
        self.queued += 1;
        self.queued_us += u64::from(cost_us);
        self.dear += u32::from(cost_us >= self.dear_us);
        self.cursor = 0;
    }

    /// Puts a tile into the queue that came from another node, and what that one knew of it.
    pub(super) fn queue_gift(&mut self, gift: &Gift) {
        let Some(entry) = self.entry(gift.tile) else { return };
        if gift.cost_us > 0 {
            (entry.cost_us, entry.is_measured, entry.map) = (gift.cost_us, true, gift.map);
            entry.is_gift = true;
        }
        self.queue(gift.tile);
    }

    /// Takes a queued tile out of the queue.
    pub(super) fn unqueue(&mut self, tile: TileId, state: TileState) {
        let dear_us = self.dear_us;
        let Some(entry) = self.entry(tile) else { return };
        debug_assert_eq!(entry.state, TileState::Queued, "{tile:?}");
        entry.state = state;
        let cost_us = entry.cost_us;
        self.queued -= 1;
        self.queued_us -= u64::from(cost_us);
        self.dear -= u32::from(cost_us >= dear_us);
    }

    /// The queued tile to draw next: a dear one if there is one, else the first of the order.
    pub(super) fn next(&mut self) -> Option<TileId> {
        if self.queued == 0 {
            return None;
        }
        if self.dear > 0 {
            let dear_us = self.dear_us;
            let is_dear = |hand: &Self, tile: TileId| hand.tiles[tile.0 as usize].cost_us >= dear_us;
            return self.queued_tiles(false).find(|tile| is_dear(self, *tile));
        }
        while self.cursor < self.order.len() {
            let tile = self.at(self.cursor);
            if self.is_queued(tile) {
                return Some(tile);
            }
            self.cursor += 1;
        }
        None
    }

    /// The queued tiles in the order in which they will be drawn, or the last first.
    pub(super) fn queued_tiles(&self, is_last_first: bool) -> impl Iterator<Item = TileId> {
        let (start, end) = (self.cursor, self.order.len());
        let places =
            (start..end).map(move |place| if is_last_first { start + end - 1 - place } else { place });
        places.map(|place| self.at(place)).filter(|tile| self.is_queued(*tile))
    }

    pub(super) fn tiles_in_order(&self) -> impl Iterator<Item = TileId> {
        (0..self.order.len()).map(|place| self.at(place))
    }

    /// Notes what a tile took, and which pages.
    pub(super) fn measure(&mut self, tile: TileId, cost_us: u32, map: PageMap) {
        let cost_us = cost_us.max(1);
        let Some(entry) = self.tiles.get_mut(tile.0 as usize) else { return };
        entry.cost_us = if entry.is_measured { entry.cost_us.midpoint(cost_us).max(1) } else { cost_us };
        entry.is_measured = true;
        entry.map = map;
        // An eighth of what is new, so that one tile does not stand for all.
        self.mean_us = (self.mean_us - self.mean_us / 8).saturating_add(cost_us / 8).max(1);
    }

    fn at(&self, place: usize) -> TileId {
        let place = if self.is_backwards { self.order.len() - 1 - place } else { place };
        TileId(self.order[place])
    }

    fn is_queued(&self, tile: TileId) -> bool {
        self.tiles.get(tile.0 as usize).is_some_and(|entry| entry.state == TileState::Queued)
    }
}

impl TileEntry {
    /// A tile of which nothing is known.
    pub const EMPTY: Self = Self {
        state: TileState::Elsewhere,
        to: 0,
        cost_us: 0,
        is_measured: false,
        is_gift: false,
        map: PageMap::EMPTY,
    };
}

/// What a tile is thought to take before any was drawn.
const MEAN_US: u32 = 1000;
