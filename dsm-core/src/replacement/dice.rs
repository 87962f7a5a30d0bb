//! Slots by chance.

use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro128PlusPlus;

use crate::id::SlotId;
use crate::storage::SlotEntry;

/// Picks slots by chance. The same seed makes the same picks.
#[derive(Clone, Debug)]
pub(super) struct Dice {
    rng: Xoshiro128PlusPlus,
}

impl Dice {
    pub(super) fn new(seed: u64) -> Self {
        Self { rng: Xoshiro128PlusPlus::seed_from_u64(seed) }
    }

    /// One throw: a slot whose page may be evicted, or `None` for one whose page may not.
    pub(super) fn throw(&mut self, slots: &[SlotEntry]) -> Option<SlotId> {
        let slot = self.below(slots.len());
        slots.get(slot)?.evictable.then_some(SlotId(u32::try_from(slot).ok()?))
    }

    /// A slot whose page may be evicted, found by looking at each in turn; for when throws find none.
    pub(super) fn search(&mut self, slots: &[SlotEntry]) -> Option<SlotId> {
        let start = self.below(slots.len());
        let (before, from) = slots.split_at(start);
        let offset = from.iter().chain(before).position(|slot| slot.evictable)?;
        u32::try_from((start + offset) % slots.len()).ok().map(SlotId)
    }

    fn below(&mut self, bound: usize) -> usize {
        // Multiply and shift; the bias is below 2^-32 * bound, which no cache can notice.
        let bound = bound as u64;
        usize::try_from((u64::from(self.rng.next_u32()) * bound) >> 32).unwrap_or(0)
    }
}
