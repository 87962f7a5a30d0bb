//! What the last frame tells of this one, and which tiles are being drawn.

use dsm_core::id::PageId;
use dsm_core::node::{EVICT_BATCH_MAX, Node};
use dsm_core::page_sets::{PageSetStorage, PageSets, SetEntry, TileEntry};
use dsm_core::page_state::PageState;

use crate::lent::Lent;

/// The page sets of the last frame's tiles, and the tiles that threads are busy with.
#[derive(Debug)]
pub(crate) struct Foresight {
    /// Declared, and so dropped, before the storage it works in.
    sets: PageSets<'static>,
    _storage: (Lent<SetEntry>, Lent<TileEntry>, Lent<u32>),
    /// Places of the tiles that are being drawn.
    under_way: Vec<u32>,
    frame_start: u32,
    /// The place of the first tile under way when one was last begun.
    now: u32,
}

/// Pages to bring before a tile starts, at most a batch of victims.
pub(crate) type Ahead = heapless::Vec<PageId, { EVICT_BATCH_MAX as usize }>;

/// Tiles that are remembered: a picture of 3840 x 2160 has 32,400.
const TILES_MAX: usize = 32 << 10;

/// Pages of tiles that are remembered of a frame. With the tiles, a node takes 1.7 MB for its memory of the last frame.
const ENTRIES_MAX: usize = 64 << 10;

impl Foresight {
    /// Knows nothing yet. Takes 4 bytes for each page of the address space, besides what is the same for all scenes.
    pub(crate) fn new(page_count: u32) -> Self {
        // SAFETY: `sets` is declared before the storage.
        let (entries, lent_entries) = unsafe { Lent::lend(vec![SetEntry::EMPTY; 2 * ENTRIES_MAX]) };
        // SAFETY: as above.
        let (tiles, lent_tiles) = unsafe { Lent::lend(vec![TileEntry::EMPTY; TILES_MAX]) };
        // SAFETY: as above.
        let (next_uses, lent_uses) = unsafe { Lent::lend(vec![0; page_count as usize]) };
        let sets = PageSets::new(PageSetStorage { entries, tiles, next_uses });
        let storage = (lent_entries, lent_tiles, lent_uses);
        Self { sets, _storage: storage, under_way: Vec::new(), frame_start: 0, now: 0 }
    }

    pub(crate) fn begin_frame(&mut self, order: &[u32], node: &mut Node<'static>) {
        self.frame_start = self.sets.frame_end();
        self.now = self.frame_start;
        self.sets.begin_frame(order, |page, next_use| node.handle_forecast(page, next_use));
        self.tell_time(node);
    }

    /// A tile comes from another node, where it touched these pages in the last frame.
    pub(crate) fn adopt_tile(&mut self, tile: u32, pages: &[PageId], node: &mut Node<'static>) {
        self.sets.adopt_tile(tile, pages, |page, next_use| node.handle_forecast(page, next_use));
    }

    /// The pages that a tile touched in the last frame.
    pub(crate) fn pages_of(&self, tile: u32) -> impl Iterator<Item = PageId> {
        self.sets.pages_of(tile)
    }

    pub(crate) fn begin_tile(&mut self, tile: u32, node: &mut Node<'static>) {
        // A tile of a frame that is over has no place in this one.
        if self.sets.is_placed(tile) {
            self.under_way.push(self.sets.place_of(tile));
        }
        self.tell_time(node);
    }

    /// Pages that `tile` touched in the last frame and that are absent now, as many as `pages` has room for.
    pub(crate) fn absent_pages_of(&self, tile: u32, node: &Node<'static>, pages: &mut Ahead) {
        let absent = |page: &PageId| node.table().state(*page) == Some(PageState::Absent);
        for page in self.sets.pages_of(tile).filter(absent) {
            if pages.push(page).is_err() {
                return;
            }
        }
    }

    pub(crate) fn end_tile(&mut self, tile: u32, pages: &[PageId], node: &mut Node<'static>) {
        let place = self.sets.place_of(tile);
        self.under_way.retain(|other| *other != place);
        self.sets.finish_tile(tile, pages, |page, next_use| node.handle_forecast(page, next_use));
    }

    /// The first tile that is still being drawn is the present: its pages are not of the past.
    fn tell_time(&mut self, node: &mut Node<'static>) {
        let places = self.under_way.iter().copied();
        self.now = places.min_by_key(|place| place.wrapping_sub(self.frame_start)).unwrap_or(self.now);
        node.handle_clock(self.now, self.sets.frame_end());
    }
}
