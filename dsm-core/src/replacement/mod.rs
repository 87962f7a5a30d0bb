//! Which page has to leave when a slot is needed.
//!
//! A page-fault DSM does not see its hits: a resident page costs a plain load, and nobody is told. A policy that
//! wants to know which pages are used must get its *reference bits* from somewhere else, and says where.

mod clock;
mod fifo;
mod queue;
mod random;

pub use clock::Clock;
pub use fifo::Fifo;
pub use random::Random;

use core::fmt;
use core::str::FromStr;

use crate::id::SlotId;
use crate::storage::SlotEntry;

/// Chooses victims among the resident pages of a node. Keeps its order in the slots themselves.
///
/// # Invariants
/// A victim's slot was evictable: its page is resident and neither coming nor leaving.
pub trait Replacement: fmt::Debug {
    /// A page has just become resident in `slot`.
    fn handle_resident(&mut self, slots: &mut [SlotEntry], slot: SlotId);

    /// The page in `slot` is known to have been used. May be called seldom, or never.
    fn handle_reference(&mut self, slots: &mut [SlotEntry], slot: SlotId);

    /// The slot whose page is to leave, or `None` when no page is resident. Forgets the slot.
    fn choose_victim(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId>;
}

/// The policies by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PolicyKind {
    /// Any resident page: the paper's.
    Random,
    /// The page that came first.
    Fifo,
    /// The page that came first and was not used since the hand last passed.
    Clock,
}

/// One of the policies, chosen at run time.
#[derive(Clone, Debug)]
#[expect(missing_docs, reason = "each variant is the policy of that name")]
pub enum Policy {
    Random(Random),
    Fifo(Fifo),
    Clock(Clock),
}

/// No policy has this name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownPolicy;

impl Policy {
    /// A policy that knows of no page yet. Only `random` uses the seed.
    #[must_use]
    pub fn new(kind: PolicyKind, seed: u64) -> Self {
        match kind {
            PolicyKind::Random => Self::Random(Random::new(seed)),
            PolicyKind::Fifo => Self::Fifo(Fifo::new()),
            PolicyKind::Clock => Self::Clock(Clock::new()),
        }
    }
}

impl Replacement for Policy {
    fn handle_resident(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        match self {
            Self::Random(policy) => policy.handle_resident(slots, slot),
            Self::Fifo(policy) => policy.handle_resident(slots, slot),
            Self::Clock(policy) => policy.handle_resident(slots, slot),
        }
    }

    fn handle_reference(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        match self {
            Self::Random(policy) => policy.handle_reference(slots, slot),
            Self::Fifo(policy) => policy.handle_reference(slots, slot),
            Self::Clock(policy) => policy.handle_reference(slots, slot),
        }
    }

    fn choose_victim(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        match self {
            Self::Random(policy) => policy.choose_victim(slots),
            Self::Fifo(policy) => policy.choose_victim(slots),
            Self::Clock(policy) => policy.choose_victim(slots),
        }
    }
}

impl PolicyKind {
    /// All policies.
    pub const ALL: [Self; 3] = [Self::Random, Self::Fifo, Self::Clock];

    /// The policy's name, as the command line and the reports spell it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Random => "random",
            Self::Fifo => "fifo",
            Self::Clock => "clock",
        }
    }
}

impl FromStr for PolicyKind {
    type Err = UnknownPolicy;

    fn from_str(name: &str) -> Result<Self, UnknownPolicy> {
        Self::ALL.into_iter().find(|kind| kind.name() == name).ok_or(UnknownPolicy)
    }
}

impl fmt::Display for PolicyKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl fmt::Display for UnknownPolicy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("no replacement policy has this name; there are random, fifo and clock")
    }
}

impl core::error::Error for UnknownPolicy {}

#[cfg(test)]
mod tests;
