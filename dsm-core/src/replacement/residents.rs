//! Pages on their way out: hidden first, so that a touch shows that they are used, and only then evicted.

use super::Replacement;
use super::queue::Queue;
use crate::id::SlotId;
use crate::storage::SlotEntry;

/// The resident pages of a node: those that its readers see, in the order of a policy, and those that are *hidden*.
///
/// A page that the policy chooses is first taken from its readers' sight and kept. If one of them touches it, it comes
/// back without the network, and the policy takes it for a page that has just come; if nobody does, it leaves,
/// the one that was hidden first before the others. So a policy that is told nothing learns which of the pages that it
/// would have evicted are used, and what a wrong choice costs is a fault without a message.
///
/// # Source
/// Turner and Levy, "Segmented FIFO page replacement", SIGMETRICS 1981; VAX/VMS did so for want of reference bits.
#[derive(Clone, Debug)]
pub struct Residents<R> {
    policy: R,
    /// Hidden pages, the one that was hidden first at the head.
    hidden: Queue,
    /// Pages that are being hidden.
    hiding: u32,
    hidden_max: u32,
}

impl<R: Replacement> Residents<R> {
    /// Knows of no page yet. Keeps at most `hidden_max` pages hidden; 0: a page that is chosen leaves at once.
    pub const fn new(policy: R, hidden_max: u32) -> Self {
        Self { policy, hidden: Queue::new(), hiding: 0, hidden_max }
    }

    /// A page has just become visible in `slot`: it came, or it was hidden and was touched.
    pub fn handle_resident(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        self.policy.handle_resident(slots, slot);
    }

    /// The page in `slot`, which [`choose_to_hide`](Self::choose_to_hide) has chosen, is hidden now.
    pub fn handle_hidden(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        self.hiding -= 1;
        self.hidden.push(slots, slot);
    }

    /// The page in `slot`, which is hidden, was touched: it will be visible again.
    pub fn handle_shown(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        self.hidden.remove(slots, slot);
    }

    /// A page to hide, or `None` when enough are hidden or no other is visible.
    pub fn choose_to_hide(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        if self.hidden.count() + self.hiding >= self.hidden_max {
            return None;
        }
        let slot = self.policy.choose_victim(slots)?;
        self.hiding += 1;
        Some(slot)
    }

    /// The slot whose page is to leave, hidden or not, or `None` when there is none. Forgets the slot.
    pub fn choose_victim(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        self.hidden.pop(slots).or_else(|| self.policy.choose_victim(slots))
    }

    /// As [`choose_victim`](Self::choose_victim), for a page that nobody waits for yet.
    pub fn choose_victim_for_prefetch(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        self.hidden.pop(slots).or_else(|| self.policy.choose_victim_for_prefetch(slots))
    }

    /// The policy, to tell it what it wants to know.
    pub const fn policy_mut(&mut self) -> &mut R {
        &mut self.policy
    }

    /// Pages that are hidden.
    #[must_use]
    pub const fn hidden_count(&self) -> u32 {
        self.hidden.count()
    }
}
