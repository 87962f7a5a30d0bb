//! Which page has to leave when a slot is needed.
//!
//! A page-fault DSM does not see its hits: a resident page costs a plain load, and nobody is told. A policy that
//! wants to know which pages are used must get its *reference bits* from somewhere else, and says where.

mod clock;
mod dice;
mod fifo;
mod ghosts;
mod queue;
mod random;
mod recall;
mod reference;
mod replay;
mod residents;
mod s3_fifo;
mod sieve;

pub use clock::Clock;
pub use fifo::Fifo;
pub use random::Random;
pub use recall::Recall;
pub use reference::{ReferenceSource, UnknownSource};
pub use replay::{Replay, Touch};
pub use residents::Residents;
pub use s3_fifo::S3Fifo;
pub use sieve::Sieve;

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

    /// The same, for a page that nobody waits for yet: `None` too when what is resident is needed sooner.
    fn choose_victim_for_prefetch(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        self.choose_victim(slots)
    }

    /// The page in `slot` is expected to be used next at tile `next_use`.
    fn handle_forecast(&mut self, _slots: &mut [SlotEntry], _slot: SlotId, _next_use: u32) {}

    /// Tile `now` is being drawn, and the next frame begins with tile `frame_end`.
    fn handle_clock(&mut self, _now: u32, _frame_end: u32) {}
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
    /// As `clock`, but a page that was used keeps its place.
    Sieve,
    /// A page of a small queue of newcomers, unless it was used; then one of the main queue.
    S3Fifo,
    /// The page that is needed last, as far as the last frame tells.
    Recall,
}

/// One of the policies, chosen at run time.
#[derive(Clone, Debug)]
#[expect(missing_docs, reason = "each variant is the policy of that name")]
pub enum Policy {
    Random(Random),
    Fifo(Fifo),
    Clock(Clock),
    Sieve(Sieve),
    S3Fifo(S3Fifo),
    Recall(Recall),
}

/// No policy has this name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownPolicy;

impl Policy {
    /// A policy that knows of no page yet. `random` and `recall` use the seed.
    #[must_use]
    pub fn new(kind: PolicyKind, seed: u64) -> Self {
        match kind {
            PolicyKind::Random => Self::Random(Random::new(seed)),
            PolicyKind::Fifo => Self::Fifo(Fifo::new()),
            PolicyKind::Clock => Self::Clock(Clock::new()),
            PolicyKind::Sieve => Self::Sieve(Sieve::new()),
            PolicyKind::S3Fifo => Self::S3Fifo(S3Fifo::new()),
            PolicyKind::Recall => Self::Recall(Recall::new(seed)),
        }
    }
}

impl Replacement for Policy {
    fn handle_resident(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        match self {
            Self::Random(policy) => policy.handle_resident(slots, slot),
            Self::Fifo(policy) => policy.handle_resident(slots, slot),
            Self::Clock(policy) => policy.handle_resident(slots, slot),
            Self::Sieve(policy) => policy.handle_resident(slots, slot),
            Self::S3Fifo(policy) => policy.handle_resident(slots, slot),
            Self::Recall(policy) => policy.handle_resident(slots, slot),
        }
    }

    fn handle_reference(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        match self {
            Self::Random(policy) => policy.handle_reference(slots, slot),
            Self::Fifo(policy) => policy.handle_reference(slots, slot),
            Self::Clock(policy) => policy.handle_reference(slots, slot),
            Self::Sieve(policy) => policy.handle_reference(slots, slot),
            Self::S3Fifo(policy) => policy.handle_reference(slots, slot),
            Self::Recall(policy) => policy.handle_reference(slots, slot),
        }
    }

    fn choose_victim(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        match self {
            Self::Random(policy) => policy.choose_victim(slots),
            Self::Fifo(policy) => policy.choose_victim(slots),
            Self::Clock(policy) => policy.choose_victim(slots),
            Self::Sieve(policy) => policy.choose_victim(slots),
            Self::S3Fifo(policy) => policy.choose_victim(slots),
            Self::Recall(policy) => policy.choose_victim(slots),
        }
    }

    fn choose_victim_for_prefetch(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        match self {
            Self::Recall(policy) => policy.choose_victim_for_prefetch(slots),
            Self::Random(_) | Self::Fifo(_) | Self::Clock(_) | Self::Sieve(_) | Self::S3Fifo(_) => {
                self.choose_victim(slots)
            }
        }
    }

    fn handle_forecast(&mut self, slots: &mut [SlotEntry], slot: SlotId, next_use: u32) {
        if let Self::Recall(policy) = self {
            policy.handle_forecast(slots, slot, next_use);
        }
    }

    fn handle_clock(&mut self, now: u32, frame_end: u32) {
        if let Self::Recall(policy) = self {
            policy.handle_clock(now, frame_end);
        }
    }
}

impl PolicyKind {
    /// All policies.
    pub const ALL: [Self; 6] =
        [Self::Random, Self::Fifo, Self::Clock, Self::Sieve, Self::S3Fifo, Self::Recall];

    /// The policy's name, as the command line and the reports spell it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Random => "random",
            Self::Fifo => "fifo",
            Self::Clock => "clock",
            Self::Sieve => "sieve",
            Self::S3Fifo => "s3-fifo",
            Self::Recall => "recall",
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
        f.write_str(
            "no replacement policy has this name; there are random, fifo, clock, sieve, s3-fifo and recall",
        )
    }
}

impl core::error::Error for UnknownPolicy {}

#[cfg(test)]
mod models;
#[cfg(test)]
mod tests;
