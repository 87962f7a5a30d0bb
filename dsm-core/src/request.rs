//! What a node has asked for and not yet been answered.

use core::hash::{Hash, Hasher};

use crate::fragments::Fragments;
use crate::id::{NodeId, PageId, PortId};
use crate::mutants::{self, Mutant};
use crate::time::Instant;

/// What a node knows of one request under way, in 80 bytes. Opaque; start with [`RequestEntry::EMPTY`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RequestEntry {
    pub(crate) page: PageId,
    /// Returned with the answer; the same for every sending of this request.
    pub(crate) number: u32,
    /// The copy that is being asked.
    pub(crate) holder: NodeId,
    pub(crate) port: PortId,
    /// Sendings so far, 255 at most. Those of before anybody waited for the page do not count: they may all be lost.
    pub(crate) sendings: u8,
    /// Of those, sendings to `holder` since it was its turn.
    pub(crate) tries: u8,
    /// Doublings of the timeout of the last sending.
    pub(crate) backoff: u8,
    /// The copies, by their place among the holders of the page, that have had their turn.
    pub(crate) asked: u8,
    /// The copies that have refused.
    pub(crate) refused: u8,
    /// The peer that was asked has died or is a new node: due at once, and no timeout.
    pub(crate) is_orphan: bool,
    /// Since the last sending, a part of the page has come that was missing.
    pub(crate) has_advanced: bool,
    /// A round trip of this request has been measured, that of the sending with `measured_stamp`.
    pub(crate) is_measured: bool,
    pub(crate) measured_stamp: u32,
    /// When it was sent first.
    pub(crate) sent_at: Instant,
    /// When it is sent again unless an answer came.
    pub(crate) resend_at: Instant,
    /// When it is given up.
    pub(crate) deadline: Instant,
    /// What has come of the page.
    pub(crate) fragments: Fragments,
}

/// The requests under way, one for each page in state `Requested`.
///
/// # Cost
/// Each is found by looking at all; there are no more than threads that wait and pages asked for ahead.
#[derive(Debug)]
pub(crate) struct Requests<'s> {
    entries: &'s mut [RequestEntry],
    /// The first so many entries are in use.
    count: usize,
}

impl RequestEntry {
    /// No request.
    pub const EMPTY: Self = Self {
        page: PageId(u32::MAX),
        number: 0,
        holder: NodeId(0),
        port: PortId(0),
        sendings: 0,
        tries: 0,
        backoff: 0,
        asked: 0,
        refused: 0,
        is_orphan: false,
        has_advanced: false,
        is_measured: false,
        measured_stamp: 0,
        sent_at: Instant::ZERO,
        resend_at: Instant::ZERO,
        deadline: Instant::ZERO,
        fragments: Fragments::NONE,
    };

    pub(crate) fn next_event(&self) -> Instant {
        if mutants::is_on(Mutant::NeverExpire) { self.resend_at } else { self.resend_at.min(self.deadline) }
    }

    /// Feeds a hash with all of it but its number, times as distances from `now`. The sendings after a whole `round` through the
    /// copies are all alike.
    pub(crate) fn fingerprint(&self, now: Instant, round: u64, hasher: &mut impl Hasher) {
        (self.page, self.holder, self.port).hash(hasher);
        (u64::from(self.sendings).min(round), self.tries, self.asked, self.refused).hash(hasher);
        (self.is_orphan, self.has_advanced, self.fragments).hash(hasher);
        (self.resend_at.since(now), self.deadline.since(now)).hash(hasher);
    }
}

impl<'s> Requests<'s> {
    /// The first `count` entries are under way already.
    pub(crate) fn new(entries: &'s mut [RequestEntry], count: usize) -> Self {
        let count = count.min(entries.len());
        Self { entries, count }
    }

    /// Gives the lent entries back.
    pub(crate) fn into_entries(self) -> &'s mut [RequestEntry] {
        self.entries
    }

    /// Adds a request and says where it is. The caller has made sure that there is room.
    pub(crate) fn push(&mut self, request: RequestEntry) -> usize {
        debug_assert!(!self.is_full(), "a fault is let through only when a request is free");
        let index = self.count.min(self.entries.len() - 1);
        self.entries[index] = request;
        self.count = index + 1;
        index
    }

    /// Takes a request out. The last one takes its place.
    pub(crate) fn remove(&mut self, index: usize) -> RequestEntry {
        let removed = self.entries[index];
        self.count -= 1;
        self.entries[index] = self.entries[self.count];
        removed
    }

    pub(crate) fn get_mut(&mut self, index: usize) -> &mut RequestEntry {
        &mut self.entries[index]
    }

    /// The place of the request for `page` when it has this number.
    pub(crate) fn find(&self, page: PageId, number: u32) -> Option<usize> {
        let any_number = mutants::is_on(Mutant::SkipNumberCheck);
        self.iter()
            .position(|request| request.page == page)
            .filter(|index| self.entries[*index].number == number || any_number)
    }

    /// The place of a request that left through `port` and for which something is due at `now`.
    pub(crate) fn next_due(&self, now: Instant, port: PortId) -> Option<usize> {
        self.iter().position(|request| request.port == port && request.next_event() <= now)
    }

    pub(crate) fn is_full(&self) -> bool {
        self.count == self.entries.len()
    }

    pub(crate) fn capacity(&self) -> usize {
        self.entries.len()
    }

    pub(crate) fn len(&self) -> usize {
        self.count
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &RequestEntry> {
        self.entries[..self.count].iter()
    }

    pub(crate) fn iter_mut(&mut self) -> impl Iterator<Item = &mut RequestEntry> {
        self.entries[..self.count].iter_mut()
    }

    /// When something will next be due, on `port` or, with `None`, on any.
    pub(crate) fn next_event(&self, port: Option<PortId>) -> Option<Instant> {
        let asked = |request: &&RequestEntry| port.is_none_or(|port| request.port == port);
        self.iter().filter(asked).map(RequestEntry::next_event).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_costs_80_bytes() {
        assert_eq!(size_of::<RequestEntry>(), 80);
    }

    #[test]
    fn what_is_removed_leaves_no_gap() {
        let mut entries = [RequestEntry::EMPTY; 3];
        let mut requests = Requests::new(&mut entries, 0);
        for page in 0..3 {
            requests.push(RequestEntry { page: PageId(page), number: page, ..RequestEntry::EMPTY });
        }
        assert!(requests.is_full());
        assert_eq!(requests.remove(0).page, PageId(0));
        assert_eq!([0, 1, 2].map(|page| requests.find(PageId(page), page)), [None, Some(1), Some(0)]);
        assert_eq!(requests.find(PageId(2), 9), None);
    }
}
