//! What one node may believe and has promised, known independently of it.

use core::hash::{Hash, Hasher};
use std::collections::BTreeMap;

use dsm_core::id::{Incarnation, NodeId, PageId};
use dsm_core::membership::Liveness;
use dsm_core::node::{Config, Node};
use dsm_core::placement::Stripes;
use dsm_core::time::Instant;
use dsm_core::wire::{Body, Message};

/// What is known of one node from the outside.
#[derive(Clone, Debug, Default)]
pub(crate) struct Oracle {
    /// The last incarnation of each peer that it has believed or been told of, and whether that is dead to it.
    peers: BTreeMap<u16, (u16, bool)>,
    /// Requests under way, by page.
    pub(crate) asked: BTreeMap<u32, Asked>,
}

/// A request, as the network has seen it.
#[derive(Clone, Debug)]
pub(crate) struct Asked {
    pub(crate) number: u32,
    /// When, by the world's clock, each peer was asked with each stamp.
    sendings: BTreeMap<(u16, u32), Instant>,
    /// The time to the next sending, of the last sending to each peer that was not heard from since.
    intervals: BTreeMap<u16, u64>,
    pub(crate) last_to: NodeId,
}

impl Oracle {
    /// A request left the node.
    pub(crate) fn note_request(&mut self, message: &Message, world_now: Instant) {
        let fresh = || Asked {
            number: message.request,
            sendings: BTreeMap::new(),
            intervals: BTreeMap::new(),
            last_to: message.to,
        };
        let asked = self.asked.entry(message.page.0).or_insert_with(fresh);
        if asked.number != message.request {
            *asked = fresh();
        }
        asked.sendings.insert((message.to.0, message.stamp_us), world_now);
        asked.last_to = message.to;
    }

    /// The node will wait so long for the answer to what it has just sent. `BACKS_OFF`.
    ///
    /// Where the time left is short it is shared out: so long as `share_us` it may wait in any case.
    pub(crate) fn note_interval(&mut self, page: PageId, interval_us: u64, share_us: u64) {
        let Some(asked) = self.asked.get_mut(&page.0) else { return };
        let to = asked.last_to;
        if let Some(before) = asked.intervals.insert(to.0, interval_us) {
            assert!(
                interval_us >= (before * 2).min(share_us),
                "BACKS_OFF: {to} is silent; asked again after {before} us, it is asked again after {interval_us} us"
            );
        }
    }

    /// The driver told the node that `peer` is dead.
    pub(crate) fn note_down(&mut self, peer: NodeId) {
        self.peers.entry(peer.0).or_default().1 = true;
    }

    /// The node believed something of this incarnation of `peer`, or was told of it.
    pub(crate) fn note_heard(&mut self, peer: NodeId, incarnation: Incarnation) {
        let known = self.peers.entry(peer.0).or_default();
        if incarnation.0 > known.0 {
            *known = (incarnation.0, false);
        }
        self.asked.values_mut().for_each(|asked| {
            asked.intervals.remove(&peer.0);
        });
    }

    /// Silence may have made the node take peers for dead; from the outside that cannot be known better.
    pub(crate) fn note_silence(&mut self, node: &Node<'_>, peers: impl Iterator<Item = NodeId>) {
        for peer in peers.filter(|peer| node.liveness(*peer) == Liveness::Dead) {
            self.note_down(peer);
        }
    }

    /// Whether the node thinks of this incarnation of a peer as dead.
    pub(crate) fn is_dead_in(&self, peer: NodeId, incarnation: Incarnation) -> bool {
        self.peers.get(&peer.0).is_some_and(|(known, dead)| *dead && incarnation.0 <= *known)
    }

    /// Whether the node would ask this incarnation of a peer and believe it. It does not when the peer was dead to it and
    /// has not been heard of since it came back, nor when a corrupted message has made it believe in a later incarnation.
    pub(crate) fn asks(&self, peer: NodeId, incarnation: Incarnation) -> bool {
        self.peers.get(&peer.0).is_none_or(|(known, dead)| !dead && *known <= incarnation.0)
    }

    /// What was sent before is no measure for the time to the next sending of this page's request.
    pub(crate) fn forgive(&mut self, page: PageId) {
        if let Some(asked) = self.asked.get_mut(&page.0) {
            asked.intervals.clear();
        }
    }

    /// Feeds a hash with what a later check depends on.
    pub(crate) fn fingerprint(&self, hasher: &mut impl Hasher) {
        self.peers.hash(hasher);
    }

    /// Why an answer must not be believed, or `None` when it may be.
    pub(crate) fn distrust(&self, config: &Config, message: &Message) -> Option<&'static str> {
        let Message { from, page, .. } = *message;
        let (known, is_dead) = self.peers.get(&from.0).copied().unwrap_or_default();
        let holds = holds(&config.placement, from, page);
        match () {
            () if message.cluster != config.cluster => Some("is of another cluster"),
            () if message.epoch != config.epoch => Some("is of another epoch"),
            () if message.to_incarnation != config.incarnation => Some("is for another incarnation"),
            () if !holds => Some("is of a node that does not hold the page"),
            () if message.from_incarnation.0 < known => Some("is of an older incarnation"),
            () if is_dead && message.from_incarnation.0 <= known => Some("is of a dead node"),
            () => None,
        }
    }

    /// An answer had an effect: it must have been to the request under way. `ONE_ANSWER`.
    pub(crate) fn check_effect(&self, message: &Message) {
        let number = self.asked.get(&message.page.0).map(|asked| asked.number);
        assert_eq!(number, Some(message.request), "ONE_ANSWER: {message:?} had an effect");
    }

    /// The time from the sending that this answers to now, by the world's clock; `None` when nothing was sent with its
    /// stamp, which then was changed on the way.
    pub(crate) fn round_trip_us(&self, message: &Message, world_now: Instant) -> Option<u64> {
        let asked = self.asked.get(&message.page.0)?;
        let sent_at = asked.sendings.get(&(message.from.0, message.stamp_us))?;
        Some(world_now.since(*sent_at))
    }
}

/// Whether a home must drop this request.
pub(crate) fn must_drop(config: &Config, message: &Message) -> bool {
    message.cluster != config.cluster || message.epoch != config.epoch
}

/// Whether `node` holds `page`, without asking for an index.
pub(crate) fn holds(placement: &Stripes, node: NodeId, page: PageId) -> bool {
    placement.holders(page).contains(node)
}

/// The pages that `node` holds in the order in which it must number them: home pages, then replicas, by address.
pub(crate) fn held_in_order(placement: &Stripes, node: NodeId) -> Vec<u32> {
    let held = (0..placement.page_count()).filter(|page| holds(placement, node, PageId(*page)));
    let (home, replicas): (Vec<u32>, Vec<u32>) =
        held.partition(|page| placement.home(PageId(*page)) == Some(node));
    [home, replicas].concat()
}

/// Bytes of the page that an answer carries, as offset and length.
pub(crate) fn carried(message: &Message) -> Option<(u32, u32)> {
    match message.body {
        Body::Grant { offset, bytes } => Some((offset, bytes)),
        Body::Request { .. } | Body::Refusal(_) => None,
    }
}
