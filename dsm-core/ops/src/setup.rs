//! What a cluster is made of.

use dsm_core::id::{Epoch, Incarnation, NodeId};
use dsm_core::node::Config;
use dsm_core::placement::Stripes;
use dsm_core::replacement::PolicyKind;

use crate::member::Wait;

/// What a cluster is made of.
#[derive(Clone, Copy, Debug)]
pub struct Setup {
    /// Nodes, of which the last `owners` own the pages.
    pub nodes: u8,
    /// Nodes that own pages.
    pub owners: u8,
    /// Pages of the address space.
    pub pages: u8,
    /// Pages of a stripe.
    pub stripe_pages: u8,
    /// Copies of each page.
    pub replicas: u8,
    /// Threads of each node.
    pub threads: u8,
    /// Slots of each node.
    pub slots: u8,
    /// Requests that a node can have under way.
    pub requests: u8,
    /// Which page has to leave.
    pub policy: PolicyKind,
    /// See [`Config::evict_batch`].
    pub evict_batch: u8,
    /// See [`Config::evict_ahead`].
    pub evict_ahead: u8,
    /// See [`Config::hidden_max`]; less than the slots.
    pub hidden: u8,
    /// See [`Config::neighbours_max`].
    pub neighbours: u8,
    /// Parts in which pages travel; 1 for whole pages.
    pub fragments: u8,
    /// Sendings to one copy before the next is asked.
    pub tries: u8,
    /// All timeouts are the same, whatever has been measured: a model stays finite.
    pub is_rigid: bool,
    /// Peers die of silence alone before a fault is given up, else after.
    pub buries_early: bool,
}

/// Length of a page. Real ones are longer; what matters is that there are units to be cut into.
pub(crate) const PAGE_BYTES: u32 = 64;

pub(crate) const RESEND_US: u64 = 1_000;
pub(crate) const DEADLINE_US: u64 = 20_000;

/// In a model every moment counts, for each makes other states.
const RIGID_DEADLINE_US: u64 = 8 * RESEND_US;

impl Setup {
    /// Bytes that a set-up is made of.
    pub const BYTES: usize = 4;

    /// The set-up that these bytes stand for. All bytes stand for one.
    #[must_use]
    pub fn from_bytes([cluster, node, asking, parts]: [u8; Self::BYTES]) -> Self {
        let policies = PolicyKind::ALL;
        Self {
            nodes: 3 + cluster % 2,
            replicas: 1 + cluster / 2 % 3,
            stripe_pages: 1 + cluster / 6 % 3,
            slots: 1 + node % 4,
            hidden: (node / 24 % 4).min(node % 4),
            policy: policies[usize::from(node / 4) % policies.len()],
            evict_batch: 1 + asking % 3,
            evict_ahead: asking / 3 % 3,
            requests: 1 + asking / 9 % 4,
            tries: 1 + parts % 3,
            fragments: [1, 4, 32][usize::from(parts / 3) % 3],
            buries_early: parts / 9 % 2 == 0,
            neighbours: [0, 1, 4][usize::from(parts / 18) % 3],
            ..Self::SMALL
        }
    }

    /// Three nodes of two threads, all of which own pages, with two copies of each.
    pub const SMALL: Self = Self {
        nodes: 3,
        owners: 3,
        pages: 9,
        stripe_pages: 2,
        replicas: 2,
        threads: 2,
        slots: 2,
        requests: 4,
        policy: PolicyKind::Fifo,
        evict_batch: 1,
        evict_ahead: 0,
        hidden: 0,
        neighbours: 0,
        fragments: 1,
        tries: 2,
        is_rigid: false,
        buries_early: true,
    };

    pub(crate) const fn deadline_us(&self) -> u64 {
        if self.is_rigid { RIGID_DEADLINE_US } else { DEADLINE_US }
    }

    /// How long what a thread waits for may take. A page that was asked for ahead and that nobody has missed is given up
    /// in half the time.
    pub(crate) const fn patience_us(&self, wait: &Wait) -> u64 {
        if wait.is_ahead && !wait.is_missed { self.deadline_us() / 2 } else { self.deadline_us() }
    }

    /// The configuration of one node.
    pub(crate) fn config(&self, me: NodeId, incarnation: Incarnation) -> Config {
        let first_owner = NodeId(u16::from(self.nodes - self.owners));
        let stripes =
            Stripes::new(self.pages.into(), self.stripe_pages.into(), first_owner, self.owners.into());
        let placement = stripes.and_then(|stripes| stripes.with_replicas(self.replicas));
        let placement = placement.expect("the set-up is consistent");
        Config {
            epoch: Epoch(3),
            incarnation,
            evict_batch: self.evict_batch.into(),
            evict_ahead: self.evict_ahead.into(),
            hidden_max: self.hidden.into(),
            neighbours_max: self.neighbours.into(),
            fragments: self.fragments > 1,
            resend_us: RESEND_US,
            resend_us_min: RESEND_US,
            resend_us_max: if self.is_rigid { RESEND_US } else { DEADLINE_US },
            tries: self.tries,
            suspect_after_us: 2 * RESEND_US,
            dead_after_us: if self.buries_early { self.deadline_us() / 2 } else { self.deadline_us() * 2 },
            deadline_us: self.deadline_us(),
            ..Config::new(me, placement, PAGE_BYTES)
        }
    }
}
