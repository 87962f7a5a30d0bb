//! Whom a node asks for a page, and when again.

use super::{Node, Pending};
use crate::failure::Failure;
use crate::id::{Incarnation, NodeId, PageId, PortId};
use crate::membership::Liveness;
use crate::mutants::{self, Mutant};
use crate::replacement::Replacement;
use crate::request::RequestEntry;
use crate::time::Instant;
use crate::wire::{Body, Message};

impl<R: Replacement> Node<'_, R> {
    /// Asks for a page whose fault is `elapsed_us` old.
    pub(super) fn begin_request(&mut self, now: Instant, page: PageId, port: PortId, elapsed_us: u64) {
        let request = RequestEntry {
            page,
            port,
            number: self.next_number,
            sent_at: now,
            deadline: now.after(self.config.deadline_us.saturating_sub(elapsed_us)),
            ..RequestEntry::EMPTY
        };
        self.next_number = self.next_number.wrapping_add(1);
        self.stats.requests += 1;
        let index = self.requests.push(request);
        self.ask_next(now, index, None);
    }

    /// Something is due for a request: it is given up, or sent again, to this copy or to the next.
    pub(super) fn look_after(&mut self, now: Instant, index: usize) {
        let request = self.requests.get_mut(index);
        let RequestEntry { page, holder, .. } = *request;
        if request.deadline <= now && !mutants::is_on(Mutant::NeverExpire) {
            self.requests.remove(index);
            self.fail(page, Failure::NoAnswer { from: holder });
            return;
        }
        if mutants::is_on(Mutant::NeverResend) {
            request.resend_at = request.deadline;
            return;
        }
        let RequestEntry { tries, backoff, is_orphan, has_advanced, .. } = *request;
        if !is_orphan {
            // Who sends parts of a page does not need more time, but the parts that were lost.
            self.membership.timed_out(now, holder, if has_advanced { backoff } else { backoff + 1 });
        }
        match self.membership.liveness(holder) {
            Liveness::Alive if !is_orphan && tries < self.config.tries => {
                self.stats.resends += 1;
                self.send(now, index);
            }
            Liveness::Dead if !is_orphan => {
                self.stats.dead_peers += 1;
                self.make_due(now, holder);
                self.ask_next(now, index, None);
            }
            Liveness::Alive | Liveness::Suspected | Liveness::Dead => self.ask_next(now, index, None),
        }
    }

    /// The copy at `from` is none, or cannot be read: the next one is asked.
    pub(super) fn refused(&mut self, now: Instant, index: usize, from: NodeId, failure: Failure) {
        let request = self.requests.get_mut(index);
        let holders = self.config.placement.holders(request.page);
        for (place, holder) in holders.as_slice().iter().enumerate() {
            request.refused |= u8::from(*holder == from) << place;
        }
        // Another copy may be being asked already; then nothing more is to be done.
        if request.holder == from
            || holders.as_slice().len() == usize::try_from(request.refused.count_ones()).unwrap_or(0)
        {
            self.ask_next(now, index, Some(failure));
        }
    }

    /// What was asked of `node` is due now.
    pub(super) fn make_due(&mut self, now: Instant, node: NodeId) {
        if mutants::is_on(Mutant::ForgetRequestsOfTheDead) {
            return;
        }
        for request in self.requests.iter_mut().filter(|request| request.holder == node) {
            request.resend_at = now;
            request.is_orphan = true;
        }
    }

    /// Asks the copy whose turn it is, or gives up: for `failure`, or because all who hold it are dead.
    fn ask_next(&mut self, now: Instant, index: usize, failure: Option<Failure>) {
        let request = self.requests.get_mut(index);
        let RequestEntry { page, holder: last, asked, .. } = *request;
        let Some((place, holder)) = self.choose(index) else {
            self.requests.remove(index);
            self.fail(page, failure.unwrap_or(Failure::Dead { last }));
            return;
        };
        let request = self.requests.get_mut(index);
        request.asked |= 1 << place;
        request.holder = holder;
        request.tries = 0;
        if asked != 0 {
            self.stats.resends += 1;
            self.stats.failovers += u64::from(holder != last);
        }
        self.probe(now, index);
        self.send(now, index);
    }

    /// The copy to ask, and its place among the holders: of those that have not refused and are alive, or failing that are not
    /// dead, one that has not had its turn and that costs least. When all have had their turn, a new round begins.
    fn choose(&mut self, index: usize) -> Option<(usize, NodeId)> {
        let request = self.requests.get_mut(index);
        let home = self.config.placement.home(request.page)?;
        let is_first = request.asked == 0;
        if mutants::is_on(Mutant::NeverFailOver) || is_first && self.membership.is_even() {
            return Some((0, home));
        }
        let holders = self.config.placement.holders(request.page);
        let may_answer = |(place, holder): &(usize, NodeId)| {
            request.refused & (1 << place) == 0 && self.membership.liveness(*holder) != Liveness::Dead
        };
        let may_answer = || holders.as_slice().iter().copied().enumerate().filter(may_answer);
        // While another copy is thought to be alive, a suspected one is only probed.
        let best = may_answer().map(|(_, holder)| self.membership.liveness(holder)).min()?;
        let candidates = || may_answer().filter(|(_, holder)| self.membership.liveness(*holder) == best);
        if candidates().all(|(place, _)| request.asked & (1 << place) != 0) {
            request.asked = 0;
        }
        let asked = request.asked;
        candidates()
            .min_by_key(|(place, holder)| (asked & (1 << place), self.membership.cost(*holder), *place))
    }

    /// Asks a suspected holder too, now and then: whatever it answers makes it alive again.
    fn probe(&mut self, now: Instant, index: usize) {
        let RequestEntry { page, holder: asked, .. } = *self.requests.get_mut(index);
        if self.membership.is_even() {
            return;
        }
        let holders = self.config.placement.holders(page);
        let mut others = holders.as_slice().iter().filter(|holder| **holder != asked);
        if let Some(holder) = others.find(|holder| self.membership.take_probe(now, **holder)) {
            self.stats.probes += 1;
            self.transmit(now, index, *holder);
        }
    }

    /// Sends the request to the copy that is being asked and says when to send it again.
    fn send(&mut self, now: Instant, index: usize) {
        let request = self.requests.get_mut(index);
        let holder = request.holder;
        request.sendings = request.sendings.saturating_add(1);
        request.tries = request.tries.saturating_add(1);
        request.backoff = self.membership.backoff(holder);
        request.is_orphan = false;
        request.has_advanced = false;
        let wait_us = self.membership.timeout_us(holder).min(self.share_us(now, index));
        self.requests.get_mut(index).resend_at = now.after(wait_us);
        self.transmit(now, index, holder);
    }

    /// How long this sending may wait so that all others of the first round through the copies get as long before the
    /// deadline. A slow peer, or one whose round trip was taken wrong, must not keep the others from being asked.
    pub(super) fn share_us(&mut self, now: Instant, index: usize) -> u64 {
        let RequestEntry { sendings, deadline, .. } = *self.requests.get_mut(index);
        match self.config.round().saturating_sub(u64::from(sendings)) {
            0 => u64::MAX,
            left => deadline.since(now) / (left + 1),
        }
    }

    fn transmit(&mut self, now: Instant, index: usize, to: NodeId) {
        self.membership.sent(now, to);
        let request = self.requests.get_mut(index);
        let part = if request.fragments.is_empty() {
            None
        } else {
            request.fragments.missing(self.config.page_bytes)
        };
        let (offset, bytes) = part.unwrap_or_default();
        let message = Message {
            cluster: self.config.cluster,
            epoch: self.config.epoch,
            from: self.config.me,
            to,
            from_incarnation: self.config.incarnation,
            to_incarnation: Incarnation(0),
            page: request.page,
            request: request.number,
            stamp_us: now.stamp(),
            body: Body::Request { offset, bytes },
        };
        let port = request.port;
        self.push(Pending::Send(port, message));
    }
}
