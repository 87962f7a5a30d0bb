//! Which owners are alive, as far as this node can tell, and how far away they are.

use core::hash::{Hash, Hasher};

use crate::id::{Incarnation, NodeId};
use crate::mutants::{self, Mutant};
use crate::round_trip::{BACKOFF_MAX, Limits, RoundTrip};
use crate::time::Instant;

/// What a node thinks of a peer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Liveness {
    /// It answers, or has not been asked.
    #[default]
    Alive,
    /// It has left requests unanswered for a while. It is asked when nobody else can be, and now and then to see whether
    /// it is back; whatever it says makes it alive again.
    Suspected,
    /// It has been silent for too long, or the driver has said so. It is asked nothing and believed nothing, until it
    /// comes back in a later incarnation, which is a new node.
    Dead,
}

/// What a node knows of one owner, in 40 bytes. Opaque; start with [`PeerEntry::EMPTY`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PeerEntry {
    /// When the first of the requests was sent that it has left unanswered since it was last heard from.
    silent_since: Option<Instant>,
    /// When it was last asked only to see whether it is back.
    probed_at: Instant,
    round_trip: RoundTrip,
    incarnation: Incarnation,
    cost: u16,
    /// Requests sent to it since it was last heard from, 255 at most.
    unanswered: u8,
    /// Times its next timeout is doubled.
    backoff: u8,
    liveness: Liveness,
}

/// After how much silence a peer is thought what of, in microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Patience {
    pub(crate) suspect_after_us: u64,
    pub(crate) dead_after_us: u64,
}

/// The owners, as this node sees them.
///
/// Silence counts while an owner is asked: from the first request it leaves unanswered to its next sign of life, of
/// whatever kind. An owner that nobody asks anything is never suspected.
///
/// # Invariants
/// `DEAD_STAYS_DEAD`: only a later incarnation changes what has been dead.
#[derive(Debug)]
pub(crate) struct Membership<'s> {
    /// One for each owner, in order.
    peers: &'s mut [PeerEntry],
    first_owner: u16,
    patience: Patience,
    limits: Limits,
    /// Some owner is not like the others: suspected, dead, or of another cost.
    is_uneven: bool,
}

/// Why a peer is not believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Distrust {
    Dead,
    OldIncarnation,
}

/// Sendings that have to be left unanswered before silence means death, however long it lasts: of two or three the
/// network may have lost each.
pub const UNANSWERED_BEFORE_DEATH: u8 = 3;

impl PeerEntry {
    /// A peer of which nothing is known.
    pub const EMPTY: Self = Self {
        silent_since: None,
        probed_at: Instant::ZERO,
        round_trip: RoundTrip::NOTHING,
        incarnation: Incarnation(0),
        cost: 0,
        unanswered: 0,
        backoff: 0,
        liveness: Liveness::Alive,
    };

    fn heard(&mut self) {
        self.silent_since = None;
        self.unanswered = 0;
        if self.liveness == Liveness::Suspected {
            self.liveness = Liveness::Alive;
        }
    }
}

impl<'s> Membership<'s> {
    pub(crate) fn new(
        peers: &'s mut [PeerEntry],
        first_owner: NodeId,
        patience: Patience,
        limits: Limits,
    ) -> Self {
        Self { peers, first_owner: first_owner.0, patience, limits, is_uneven: false }
    }

    /// With what [`is_even`](Self::is_even) said of these peers.
    pub(crate) fn with_evenness(self, is_even: bool) -> Self {
        Self { is_uneven: !is_even, ..self }
    }

    /// Gives the lent entries back.
    pub(crate) fn into_entries(self) -> &'s mut [PeerEntry] {
        self.peers
    }

    /// Feeds a hash with what is known of every peer, times as distances from `now` and no finer than they matter.
    pub(crate) fn fingerprint(&self, now: Instant, hasher: &mut impl Hasher) {
        let patience = self.patience;
        let is_adaptive = self.limits.min_us < self.limits.max_us;
        for peer in self.peers.iter() {
            let silent_us = peer.silent_since.map(|since| now.since(since).min(patience.dead_after_us));
            let probed_us = now.since(peer.probed_at).min(patience.suspect_after_us);
            (silent_us, peer.unanswered.min(UNANSWERED_BEFORE_DEATH), peer.liveness).hash(hasher);
            (peer.incarnation, peer.cost).hash(hasher);
            if peer.liveness == Liveness::Suspected {
                probed_us.hash(hasher);
            }
            if is_adaptive {
                (peer.round_trip, peer.backoff).hash(hasher);
            }
        }
    }

    /// Says whether a message that claims to be of this incarnation of `node` can be believed; it changes nothing.
    pub(crate) fn trusts(&self, node: NodeId, incarnation: Incarnation) -> Result<(), Distrust> {
        let Some(peer) = self.peer(node) else { return Ok(()) };
        if incarnation < peer.incarnation && !mutants::is_on(Mutant::SkipIncarnationCheck) {
            return Err(Distrust::OldIncarnation);
        }
        let is_dead = peer.liveness == Liveness::Dead && incarnation <= peer.incarnation;
        if is_dead && !mutants::is_on(Mutant::BelieveTheDead) { Err(Distrust::Dead) } else { Ok(()) }
    }

    /// A message was believed, or the driver knows otherwise that `node` lives. A later incarnation is a new node.
    /// Tells whether it was one.
    pub(crate) fn heard(&mut self, node: NodeId, incarnation: Incarnation) -> bool {
        let Some(peer) = self.peer_mut(node) else { return false };
        let is_new = incarnation > peer.incarnation;
        if is_new {
            *peer = PeerEntry { incarnation, cost: peer.cost, ..PeerEntry::EMPTY };
        } else {
            peer.heard();
        }
        is_new
    }

    /// `node` answered a request that was sent so long ago: its timeouts are no longer doubled.
    pub(crate) fn measured(&mut self, node: NodeId, round_trip_us: u64) {
        if let Some(peer) = self.peer_mut(node) {
            peer.round_trip.measure(round_trip_us);
            peer.backoff = 0;
        }
    }

    /// A request is being sent to `node`.
    pub(crate) fn sent(&mut self, now: Instant, node: NodeId) {
        if let Some(peer) = self.peer_mut(node) {
            peer.silent_since.get_or_insert(now);
            peer.unanswered = peer.unanswered.saturating_add(1);
        }
    }

    /// A request to `node` was not answered in time: its timeouts are doubled `backoff` times from now on, however many
    /// requests find out at once. Looks at how long the node has been silent.
    pub(crate) fn timed_out(&mut self, now: Instant, node: NodeId, backoff: u8) {
        let patience = self.patience;
        let Some(peer) = self.peer_mut(node) else { return };
        peer.backoff = peer.backoff.max(backoff).min(BACKOFF_MAX);
        let silent_us = peer.silent_since.map_or(0, |since| now.since(since));
        let is_ignored = peer.unanswered >= UNANSWERED_BEFORE_DEATH;
        let liveness = if silent_us >= patience.dead_after_us && is_ignored {
            Liveness::Dead
        } else if silent_us >= patience.suspect_after_us {
            Liveness::Suspected
        } else {
            Liveness::Alive
        };
        peer.liveness = peer.liveness.max(liveness);
        self.is_uneven |= liveness > Liveness::Alive;
    }

    /// The driver knows that `node` is dead. Tells whether that is news.
    pub(crate) fn bury(&mut self, node: NodeId) -> bool {
        let Some(peer) = self.peer_mut(node) else { return false };
        let is_news = peer.liveness != Liveness::Dead;
        peer.liveness = Liveness::Dead;
        self.is_uneven = true;
        is_news
    }

    /// Whether it is time to ask the suspected `node` again whether it is back; if so, it has been asked now.
    pub(crate) fn take_probe(&mut self, now: Instant, node: NodeId) -> bool {
        let suspect_after_us = self.patience.suspect_after_us;
        let Some(peer) = self.peer_mut(node) else { return false };
        let is_due = peer.liveness == Liveness::Suspected && now.since(peer.probed_at) >= suspect_after_us;
        if is_due {
            peer.probed_at = now;
        }
        is_due
    }

    pub(crate) fn set_cost(&mut self, node: NodeId, cost: u16) {
        if let Some(peer) = self.peer_mut(node) {
            peer.cost = cost;
            self.is_uneven = true;
        }
    }

    /// Whether all owners are alive and equally near, as far as is known.
    pub(crate) fn is_even(&self) -> bool {
        !self.is_uneven
    }

    pub(crate) fn liveness(&self, node: NodeId) -> Liveness {
        self.peer(node).map_or(Liveness::Alive, |peer| peer.liveness)
    }

    pub(crate) fn incarnation(&self, node: NodeId) -> Incarnation {
        self.peer(node).map_or(Incarnation(0), |peer| peer.incarnation)
    }

    pub(crate) fn cost(&self, node: NodeId) -> u16 {
        self.peer(node).map_or(0, |peer| peer.cost)
    }

    /// The time from sending a request to `node` to sending it again.
    pub(crate) fn timeout_us(&self, node: NodeId) -> u64 {
        self.peer(node)
            .map_or(self.limits.first_us, |peer| peer.round_trip.timeout_us(self.limits, peer.backoff))
    }

    /// Times that the next timeout of `node` is doubled.
    pub(crate) fn backoff(&self, node: NodeId) -> u8 {
        self.peer(node).map_or(0, |peer| peer.backoff)
    }

    pub(crate) fn round_trip_us(&self, node: NodeId) -> Option<u64> {
        self.peer(node)?.round_trip.smoothed_us()
    }

    fn peer(&self, node: NodeId) -> Option<&PeerEntry> {
        self.peers.get(usize::from(node.0.checked_sub(self.first_owner)?))
    }

    fn peer_mut(&mut self, node: NodeId) -> Option<&mut PeerEntry> {
        self.peers.get_mut(usize::from(node.0.checked_sub(self.first_owner)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { first_us: 10, min_us: 1, max_us: 1000 };
    const PATIENCE: Patience = Patience { suspect_after_us: 100, dead_after_us: 300 };
    const PEER: NodeId = NodeId(3);

    fn at(micros: u64) -> Instant {
        Instant::from_micros(micros)
    }

    fn with_membership(test: impl Fn(Membership<'_>)) {
        let mut peers = [PeerEntry::EMPTY; 2];
        test(Membership::new(&mut peers, NodeId(2), PATIENCE, LIMITS));
    }

    fn ask_in_vain(membership: &mut Membership<'_>, times: u8, until: u64) -> Liveness {
        for backoff in 1..=times {
            membership.sent(at(0), PEER);
            membership.timed_out(at(until), PEER, backoff);
        }
        membership.liveness(PEER)
    }

    #[test]
    fn silence_makes_suspected_then_dead_and_a_sign_of_life_alive_again() {
        with_membership(|mut membership| {
            assert_eq!(ask_in_vain(&mut membership, 3, 99), Liveness::Alive);
            assert_eq!(ask_in_vain(&mut membership, 3, 100), Liveness::Suspected);
            membership.heard(PEER, Incarnation(0));
            assert_eq!(membership.liveness(PEER), Liveness::Alive);
            assert_eq!(ask_in_vain(&mut membership, 2, 5000), Liveness::Suspected);
            assert_eq!(ask_in_vain(&mut membership, 1, 5000), Liveness::Dead);
        });
    }

    #[test]
    fn the_dead_are_not_believed_until_they_come_back_as_new() {
        with_membership(|mut membership| {
            assert!(membership.bury(PEER) && !membership.bury(PEER));
            assert_eq!(membership.trusts(PEER, Incarnation(0)), Err(Distrust::Dead));
            assert_eq!(membership.trusts(PEER, Incarnation(1)), Ok(()));
            assert!(membership.heard(PEER, Incarnation(1)));
            assert_eq!(membership.liveness(PEER), Liveness::Alive);
            assert_eq!(membership.trusts(PEER, Incarnation(0)), Err(Distrust::OldIncarnation));
        });
    }

    #[test]
    fn a_suspect_is_asked_now_and_then() {
        with_membership(|mut membership| {
            assert!(!membership.take_probe(at(1000), PEER));
            assert_eq!(ask_in_vain(&mut membership, 1, 1000), Liveness::Suspected);
            assert_eq!(
                [1000, 1099, 1100].map(|now| membership.take_probe(at(now), PEER)),
                [true, false, true]
            );
        });
    }

    #[test]
    fn timeouts_double_until_a_round_trip_is_measured() {
        with_membership(|mut membership| {
            for backoff in 1..=3 {
                membership.timed_out(at(0), PEER, backoff);
                membership.timed_out(at(0), PEER, backoff);
            }
            assert_eq!(membership.timeout_us(PEER), 80);
            membership.measured(PEER, 20);
            assert_eq!((membership.timeout_us(PEER), membership.round_trip_us(PEER)), (60, Some(20)));
        });
    }

    #[test]
    fn nodes_that_own_nothing_are_unknown_and_harmless() {
        with_membership(|mut membership| {
            for node in [NodeId(0), NodeId(4), NodeId(u16::MAX)] {
                membership.sent(at(0), node);
                membership.timed_out(at(1000), node, 1);
                assert!(!membership.heard(node, Incarnation(9)) && !membership.bury(node));
                assert_eq!((membership.liveness(node), membership.timeout_us(node)), (Liveness::Alive, 10));
            }
        });
    }

    #[test]
    fn a_peer_costs_40_bytes() {
        assert_eq!(size_of::<PeerEntry>(), 40);
    }
}
