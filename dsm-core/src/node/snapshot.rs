//! A node put aside, without the memory it works in.

use core::hash::{Hash, Hasher};

use heapless::Deque;

use super::{Config, Node};
use crate::id::PageId;
use crate::membership::Membership;
use crate::page_table::{Lists, PageTable};
use crate::prefetch::Prefetch;
use crate::replacement::{Policy, Replacement, Residents};
use crate::request::Requests;
use crate::stats::NodeStats;
use crate::storage::Storage;
use crate::time::{Instant, SteadyClock};

/// A node between two inputs, without the memory it works in: with copies of both, a second node goes on from here.
///
/// This is how a model checker follows every path from one state, over the very functions that serve faults.
#[derive(Clone, Debug)]
pub struct Snapshot<R = Policy> {
    config: Config,
    lists: Lists,
    request_count: usize,
    is_even: bool,
    residents: Residents<R>,
    clock: SteadyClock,
    slot_waited_for: bool,
    next_number: u32,
    prefetch: Prefetch,
    stats: NodeStats,
}

impl<R: Replacement> Node<'_, R> {
    /// Puts the node aside; the memory that it was lent is as it left it.
    ///
    /// # Panics
    /// When there are outputs that have not been polled.
    #[must_use]
    pub fn into_snapshot(self) -> Snapshot<R> {
        assert!(self.outbox.is_empty(), "one input, then poll until Idle");
        Snapshot {
            config: self.config,
            lists: self.table.lists(),
            request_count: self.requests.len(),
            is_even: self.membership.is_even(),
            residents: self.residents,
            clock: self.clock,
            slot_waited_for: self.slot_waited_for,
            next_number: self.next_number,
            prefetch: self.prefetch,
            stats: self.stats,
        }
    }
}

impl<R> Snapshot<R> {
    /// What the node has counted so far.
    #[must_use]
    pub const fn stats(&self) -> NodeStats {
        self.stats
    }
}

impl<R: Replacement> Snapshot<R> {
    /// The node again, in the memory that it left or in a copy of it. Other memory makes it do anything but harm.
    #[must_use]
    pub fn resume(self, storage: Storage<'_>) -> Node<'_, R> {
        let Storage { pages, slots, peers, requests } = storage;
        let config = self.config;
        let first_owner = config.placement.first_owner();
        Node {
            table: PageTable::resume(pages, slots, self.lists),
            requests: Requests::new(requests, self.request_count),
            membership: Membership::new(peers, first_owner, config.patience(), config.limits())
                .with_evenness(self.is_even),
            config,
            residents: self.residents,
            clock: self.clock,
            outbox: Deque::new(),
            slot_waited_for: self.slot_waited_for,
            next_number: self.next_number,
            prefetch: self.prefetch,
            stats: self.stats,
        }
    }
}

impl<R: Replacement> Node<'_, R> {
    /// Feeds a hash with all that decides what this node will do from `now` on: two nodes of the same configuration and
    /// policy that feed it alike behave alike.
    ///
    /// Times go in as distances from now, requests without their numbers; of how prefetch has paid so far, whether it goes
    /// on; what was counted does not, nor what only makes a difference to a time whose bounds leave no choice. So a model that returns to where it was finds that it did. The
    /// order that a policy keeps outside the slots does not go in either; with one slot there is none.
    pub fn fingerprint(&self, now: Instant, hasher: &mut impl Hasher) {
        let mut clock = self.clock;
        let now = clock.advance(now);
        self.table.fingerprint(hasher);
        self.slot_waited_for.hash(hasher);
        self.prefetch.allows_tiles().hash(hasher);
        self.membership.fingerprint(now, hasher);
        for page in (0..self.table.page_count()).map(PageId) {
            if let Some(request) = self.requests.iter().find(|request| request.page == page) {
                request.fingerprint(now, self.config.round(), hasher);
            }
        }
    }
}
