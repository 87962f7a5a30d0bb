//! `random`: any resident page.

use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro128PlusPlus;

use super::Replacement;
use crate::id::SlotId;
use crate::storage::SlotEntry;

/// Evicts any resident page, each with about the same chance. Takes no reference bits, keeps no order.
///
/// # Source
/// DeMarle, Gribble, Parker, EGPGV 2004, sec. 3: "Currently a random page replacement policy is used".
#[derive(Clone, Debug)]
pub struct Random {
    rng: Xoshiro128PlusPlus,
}

impl Random {
    /// The same seed makes the same choices.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { rng: Xoshiro128PlusPlus::seed_from_u64(seed) }
    }

    fn below(&mut self, bound: usize) -> usize {
        // Multiply and shift; the bias is below 2^-32 * bound, which no cache can notice.
        let bound = bound as u64;
        usize::try_from((u64::from(self.rng.next_u32()) * bound) >> 32).unwrap_or(0)
    }
}

impl Replacement for Random {
    fn handle_resident(&mut self, _slots: &mut [SlotEntry], _slot: SlotId) {}

    fn handle_reference(&mut self, _slots: &mut [SlotEntry], _slot: SlotId) {}

    fn choose_victim(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        // Nearly all slots are evictable nearly always: a few throws find one. Else look at each in turn.
        for _ in 0..THROWS {
            let slot = self.below(slots.len());
            if slots.get(slot)?.evictable {
                return u32::try_from(slot).ok().map(SlotId);
            }
        }
        let start = self.below(slots.len());
        let (before, from) = slots.split_at(start);
        let offset = from.iter().chain(before).position(|slot| slot.evictable)?;
        u32::try_from((start + offset) % slots.len()).ok().map(SlotId)
    }
}

/// Throws before looking at each slot in turn.
const THROWS: u32 = 16;
