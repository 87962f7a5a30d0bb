//! What a node gives away.

use super::hand::{Hand, TileState};
use crate::schedule::message::GIFTS_MAX;
use crate::schedule::page_map::PageMap;
use crate::tile::TileId;

/// Tiles that go to one thief.
pub(super) type Chosen = heapless::Vec<TileId, GIFTS_MAX>;

impl Hand<'_> {
    /// The paper's gift: one task. The one that would be drawn last.
    pub(super) fn choose_last(&self) -> Chosen {
        self.queued_tiles(true).take(1).collect()
    }

    /// Queued tiles that take about half as long as all of them: first those whose pages `map` has, of these
    /// the ones that would be drawn last. None when all together take less than `margin_us`.
    ///
    /// # Source
    /// Half instead of one: Hendler and Shavit, "Non-blocking steal-half work queues", PODC 2002.
    pub(super) fn choose_half(&self, map: PageMap, margin_us: u64) -> Chosen {
        let mut chosen = Chosen::new();
        if self.queued_us <= margin_us {
            return chosen;
        }
        let target_us = if self.queued == 1 { self.queued_us } else { self.queued_us / 2 };
        let nearest = self.nearest_share(map, target_us);
        let mut chosen_us = 0;
        // Two passes: all that is nearer than the share at which the target is met, then of that share as many as are wanted.
        for is_second in [false, true] {
            for tile in self.queued_tiles(true) {
                let entry = &self.tiles[tile.0 as usize];
                let share = entry.map.share_in(map);
                let is_wanted = if is_second { share == nearest } else { share > nearest };
                let cost_us = u64::from(entry.cost_us);
                if is_wanted && chosen_us + cost_us <= target_us && chosen.push(tile).is_ok() {
                    chosen_us += cost_us;
                }
            }
        }
        if chosen.is_empty() {
            // One of them is dearer than all others together. Whoever draws it, the others are better off elsewhere.
            let cheapest = self.queued_tiles(true).min_by_key(|tile| self.tiles[tile.0 as usize].cost_us);
            chosen.extend(cheapest);
        }
        chosen
    }

    /// The share of their pages in `map` so that the queued tiles with more than it do not meet the target, and with those
    /// of exactly that share do.
    fn nearest_share(&self, map: PageMap, target_us: u64) -> usize {
        let mut cost_us = [0_u64; PageMap::SHARES as usize + 1];
        for tile in self.queued_tiles(false) {
            let entry = &self.tiles[tile.0 as usize];
            cost_us[entry.map.share_in(map)] += u64::from(entry.cost_us);
        }
        let mut sum_us = 0;
        let met = |share: &usize| {
            sum_us += cost_us[*share];
            sum_us >= target_us
        };
        (0..cost_us.len()).rev().find(met).unwrap_or(0)
    }

    /// Marks tiles as given to `to`.
    pub(super) fn give(&mut self, chosen: &Chosen, to: u16) {
        for tile in chosen {
            self.unqueue(*tile, TileState::Given);
            self.tiles[tile.0 as usize].to = to;
        }
    }
}
