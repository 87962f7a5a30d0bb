//! Replaying a trace against a policy.

use dsm_core::id::PageId;
use dsm_core::node::NEIGHBOURS_MAX;
use dsm_core::page_sets::{PageSetStorage, PageSets, SetEntry, TileEntry};
use dsm_core::replacement::{Policy, PolicyKind, Replay, Touch};
use dsm_core::storage::SlotEntry;
use memsavvy::trace::{NodeFrame, Trace};
use rt_core::TileId;

/// Where a policy gets its reference bits from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Source {
    /// From nowhere.
    Nothing,
    /// This share of the slots holds pages that are hidden before they leave.
    SoftFaults(f64),
    /// At the end of each tile it is told which pages the tile has touched.
    Hints,
    /// Hints, and these pages are brought before they are touched.
    Prefetch(Ahead),
}

/// Which pages are brought before they are touched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ahead {
    /// Those that follow a missed one.
    Neighbours,
    /// Before each tile, those that it touched in the last frame.
    Tiles,
    /// Both.
    Both,
}

impl Ahead {
    pub(crate) const ALL: [Self; 3] = [Self::Neighbours, Self::Tiles, Self::Both];
}

/// What a replay has counted, summed over the nodes of the trace.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Counts {
    /// Touches that had to wait for a page.
    pub(crate) misses: u64,
    pub(crate) soft_faults: u64,
    /// Pages brought before anybody touched them.
    pub(crate) prefetched: u64,
    /// Those of them that were touched before they left.
    pub(crate) used: u64,
}

/// Replays every node's part of a trace with `slots` slots for each.
pub(crate) fn replay(trace: &Trace, slots: usize, policy: PolicyKind, source: Source) -> Counts {
    let mut counts = Counts::default();
    for node in 0..usize::from(trace.nodes) {
        let frames = trace.frames.iter().map(|frame| &frame[node]);
        Machine::run(trace, slots, Policy::new(policy, SEED), source, frames, &mut counts);
    }
    counts
}

/// The touches of one node, in order.
pub(crate) fn touches_of(trace: &Trace, node: usize) -> Vec<u32> {
    trace.frames.iter().flat_map(|frame| frame[node].touches()).copied().collect()
}

const SEED: u64 = 1;

/// A cache, what it was told, and what came of it.
struct Machine<'a, 's> {
    cache: Replay<'s, Policy>,
    sets: PageSets<'s>,
    source: Source,
    /// Pages brought and not touched since.
    waiting: Vec<bool>,
    counts: &'a mut Counts,
}

impl<'a> Machine<'a, '_> {
    fn run<'t>(
        trace: &Trace,
        slots: usize,
        policy: Policy,
        source: Source,
        frames: impl Iterator<Item = &'t NodeFrame> + Clone,
        counts: &'a mut Counts,
    ) {
        let pages = trace.page_count as usize;
        let touches_max = frames.clone().map(|frame| frame.touches().len()).max().unwrap_or(0);
        let tiles = frames.clone().flat_map(NodeFrame::tiles).map(|(tile, _)| tile.0).max().unwrap_or(0);
        let hidden = match source {
            Source::SoftFaults(share) => (slots as f64 * share).round().min(slots as f64 - 1.0),
            Source::Nothing | Source::Hints | Source::Prefetch(_) => 0.0,
        };
        let (mut slot_of, mut slots) = (vec![0; pages], vec![SlotEntry::EMPTY; slots]);
        let mut entries = vec![SetEntry::EMPTY; 2 * touches_max];
        let mut tiles = vec![TileEntry::EMPTY; tiles as usize + 1];
        let mut next_uses = vec![0; pages];
        let storage = PageSetStorage { entries: &mut entries, tiles: &mut tiles, next_uses: &mut next_uses };
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "below the slots")]
        let cache = Replay::new(&mut slot_of, &mut slots, policy, hidden as u32);
        let has_neighbours = matches!(source, Source::Prefetch(Ahead::Neighbours | Ahead::Both));
        let cache = if has_neighbours { cache.with_neighbours(NEIGHBOURS_MAX) } else { cache };
        let waiting = vec![false; pages];
        let mut machine = Machine { cache, sets: PageSets::new(storage), source, waiting, counts };
        frames.for_each(|frame| machine.draw(frame));
    }

    fn draw(&mut self, frame: &NodeFrame) {
        let is_told = matches!(self.source, Source::Hints | Source::Prefetch(_));
        if is_told {
            let order: Vec<u32> = frame.tiles().map(|(TileId(tile), _)| tile).collect();
            self.sets.begin_frame(&order, |page, when| self.cache.forecast(page, when));
        }
        for (TileId(tile), touches) in frame.tiles() {
            if is_told {
                self.cache.clock(self.sets.place_of(tile), self.sets.frame_end());
            }
            if matches!(self.source, Source::Prefetch(Ahead::Tiles | Ahead::Both)) {
                self.prefetch(tile);
            }
            touches.iter().for_each(|page| self.touch(*page));
            if is_told {
                self.hint(tile, touches);
            }
        }
    }

    fn touch(&mut self, page: u32) {
        let was_waiting = core::mem::take(&mut self.waiting[page as usize]);
        match self.cache.touch(PageId(page)) {
            Touch::Hit => self.counts.used += u64::from(was_waiting),
            Touch::SoftFault => self.counts.soft_faults += 1,
            Touch::Miss => {
                self.counts.misses += 1;
                let Self { cache, counts, waiting, .. } = self;
                cache.prefetch_neighbours(PageId(page), |brought| {
                    counts.prefetched += 1;
                    waiting[brought.index()] = true;
                });
            }
        }
    }

    fn prefetch(&mut self, tile: u32) {
        for page in self.sets.pages_of(tile) {
            if self.cache.prefetch(page) {
                self.counts.prefetched += 1;
                self.waiting[page.index()] = true;
            }
        }
    }

    /// The end of a tile.
    fn hint(&mut self, tile: u32, touches: &[u32]) {
        let mut pages: Vec<PageId> = touches.iter().map(|page| PageId(*page)).collect();
        pages.sort_unstable();
        pages.dedup();
        pages.iter().for_each(|page| self.cache.hint(*page));
        self.sets.finish_tile(tile, &pages, |page, when| self.cache.forecast(page, when));
    }
}
