//! `random`: any resident page.

use super::Replacement;
use super::dice::Dice;
use crate::id::SlotId;
use crate::storage::SlotEntry;

/// Evicts any resident page, each with about the same chance. Takes no reference bits, keeps no order.
///
/// # Source
/// DeMarle, Gribble, Parker, EGPGV 2004, sec. 3: "Currently a random page replacement policy is used".
#[derive(Clone, Debug)]
pub struct Random {
    dice: Dice,
}

impl Random {
    /// The same seed makes the same choices.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { dice: Dice::new(seed) }
    }
}

impl Replacement for Random {
    fn handle_resident(&mut self, _slots: &mut [SlotEntry], _slot: SlotId) {}

    fn handle_reference(&mut self, _slots: &mut [SlotEntry], _slot: SlotId) {}

    fn choose_victim(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        // Nearly all slots are evictable nearly always: a few throws find one. Else look at each in turn.
        (0..THROWS).find_map(|_| self.dice.throw(slots)).or_else(|| self.dice.search(slots))
    }
}

/// Throws before looking at each slot in turn.
const THROWS: u32 = 16;
