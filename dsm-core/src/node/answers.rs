//! What a node does with the messages it is given.

use core::fmt;

use super::{Node, Output, PageBytes, Pending};
use crate::failure::Failure;
use crate::fragments::{Added, Fragments};
use crate::id::{ClusterId, Epoch, Incarnation, NodeId, PageId};
use crate::membership::Distrust;
use crate::mutants::{self, Mutant};
use crate::page_state::{Effect, PageEvent, PageState};
use crate::replacement::Replacement;
use crate::time::Instant;
use crate::wire::{Body, Message, ParseError};

/// Why the bytes of a message were refused. The node's state has not changed, but for a counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum MessageError {
    /// The bytes are no message.
    Parse(ParseError),
    /// It belongs to another run.
    Cluster(ClusterId),
    /// It was sent in another epoch.
    Epoch(Epoch),
    /// It is for another node.
    To(NodeId),
    /// It answers another incarnation of this node.
    ToIncarnation(Incarnation),
    /// Its sender's incarnation is not the last one that was heard of.
    OldIncarnation(Incarnation),
    /// Its sender is dead.
    Dead(NodeId),
    /// The address space has no such page.
    NoSuchPage(PageId),
    /// `from` does not hold the page it sent.
    NotOwner {
        /// The page.
        page: PageId,
        /// The sender.
        from: NodeId,
    },
    /// Bytes that are not the whole page, and no fragment of it that this node takes.
    Fragment {
        /// Where in the page they are said to start.
        offset: u32,
        /// How many there are.
        bytes: u32,
    },
    /// A request; those go to [`Home`](crate::home::Home).
    Request,
    /// An answer to no request that is under way, or a fragment that is here: it came late, or twice.
    Late(PageId),
}

impl<R: Replacement> Node<'_, R> {
    /// Believes a message or says why not, without looking at what was asked for.
    pub(super) fn check(&self, bytes: &[u8]) -> Result<Message, MessageError> {
        let message = Message::parse(bytes).map_err(MessageError::Parse)?;
        let Message { cluster, epoch, from, to, page, body, .. } = message;
        if cluster != self.config.cluster {
            return Err(MessageError::Cluster(cluster));
        }
        if epoch != self.config.epoch && !mutants::is_on(Mutant::SkipEpochCheck) {
            return Err(MessageError::Epoch(epoch));
        }
        if to != self.config.me {
            return Err(MessageError::To(to));
        }
        if let Body::Request { .. } = body {
            return Err(MessageError::Request);
        }
        if message.to_incarnation != self.config.incarnation {
            return Err(MessageError::ToIncarnation(message.to_incarnation));
        }
        if self.config.placement.home(page).is_none() {
            return Err(MessageError::NoSuchPage(page));
        }
        if !self.config.placement.holds(from, page) && !mutants::is_on(Mutant::SkipHolderCheck) {
            return Err(MessageError::NotOwner { page, from });
        }
        self.membership.trusts(from, message.from_incarnation).map_err(|distrust| match distrust {
            Distrust::Dead => MessageError::Dead(from),
            Distrust::OldIncarnation => MessageError::OldIncarnation(message.from_incarnation),
        })?;
        match body {
            Body::Grant { offset, bytes } if !self.takes(offset, bytes) => {
                Err(MessageError::Fragment { offset, bytes })
            }
            _ => Ok(message),
        }
    }

    /// Whether these bytes can be a page, or a fragment where those are taken.
    fn takes(&self, offset: u32, bytes: u32) -> bool {
        let page_bytes = self.config.page_bytes;
        let is_whole = offset == 0 && bytes == page_bytes;
        is_whole || self.config.fragments && Fragments::can_be(page_bytes, offset, bytes)
    }

    /// Acts on a message that is believed.
    pub(super) fn accept(&mut self, now: Instant, message: Message) -> Result<(), MessageError> {
        let Message { page, from, body, .. } = message;
        if self.membership.heard(from, message.from_incarnation) {
            self.make_due(now, from);
        }
        let Some(index) = self.requests.find(page, message.request) else {
            self.fill_twice(page);
            return Err(MessageError::Late(page));
        };
        self.measure(now, index, &message);
        match body {
            Body::Grant { .. } => self.take_bytes(now, index, &message),
            Body::Refusal(why) => {
                self.refused(now, index, from, Failure::Refused { by: from, why });
                Ok(())
            }
            Body::Request { .. } => Err(MessageError::Request),
        }
    }

    /// Measures the round trip of the sending that this is the answer to, once for each.
    ///
    /// The stamp tells which sending that was, so nothing is ambiguous when a request was sent several times; Karn's rule, to
    /// measure only what was sent once, would measure nothing where some fragment of every page gets lost. A stamp of before
    /// the first sending is none of this request's.
    fn measure(&mut self, now: Instant, index: usize, message: &Message) {
        let request = self.requests.get_mut(index);
        let since_first_us = now.since(request.sent_at);
        let round_trip_us = now.since_stamp(message.stamp_us);
        let is_later = message.stamp_us.wrapping_sub(request.measured_stamp).cast_signed() > 0;
        if round_trip_us <= since_first_us && (is_later || !request.is_measured) {
            (request.is_measured, request.measured_stamp) = (true, message.stamp_us);
            let is_wrong = mutants::is_on(Mutant::MeasureFromFirst);
            self.membership.measured(message.from, if is_wrong { since_first_us } else { round_trip_us });
        }
    }

    /// Bytes of a page have come: all, or some.
    fn take_bytes(&mut self, now: Instant, index: usize, message: &Message) -> Result<(), MessageError> {
        let Message { from, body, .. } = *message;
        let Body::Grant { offset, bytes } = body else { return Err(MessageError::Request) };
        let page_bytes = self.config.page_bytes;
        let request = self.requests.get_mut(index);
        let page = request.page;
        if bytes == page_bytes {
            self.take_page(index, PageBytes::InMessage);
            self.stats.received_bytes += u64::from(bytes);
            return Ok(());
        }
        let added = request.fragments.add(page_bytes, offset, bytes);
        if request.holder == from {
            request.has_advanced |= added != Added::Nothing;
            // It is on its way: what is missing may be asked for again a whole round trip from now.
            let wait_us = self.membership.timeout_us(from).min(self.share_us(now, index));
            self.requests.get_mut(index).resend_at = now.after(wait_us);
        }
        if added == Added::Nothing {
            return Err(MessageError::Late(page));
        }
        self.stats.fragments += 1;
        self.stats.received_bytes += u64::from(bytes);
        if let Some(slot) = self.table.slot(page) {
            self.push(Pending::Done(Output::Store { page, slot, offset, bytes }));
        }
        if added == Added::TheRest {
            self.take_page(index, PageBytes::Stored);
        }
        Ok(())
    }

    /// All of a page is here: its request has done its work.
    fn take_page(&mut self, index: usize, bytes: PageBytes) {
        let was_full = self.requests.is_full();
        let page = self.requests.remove(index).page;
        if let (Effect::Map, Some(slot)) = (self.apply(page, PageEvent::Grant), self.table.slot(page)) {
            self.stats.fetched_pages += 1;
            if self.table.slots_mut()[slot.index()].prefetched.is_none() {
                self.prefetch.fetched();
            }
            self.push(Pending::Done(Output::Map { page, slot, bytes }));
            if mutants::is_on(Mutant::EvictInUse) {
                self.apply(page, PageEvent::Filled);
                self.residents.handle_resident(self.table.slots_mut(), slot);
            }
        }
        if was_full {
            self.wake_slots();
        }
    }

    /// A mutant: a second grant is obeyed as the first was.
    fn fill_twice(&mut self, page: PageId) {
        if mutants::is_on(Mutant::GrantFillsTwice)
            && self.table.state(page) == Some(PageState::Filling)
            && let Some(slot) = self.table.slot(page)
        {
            self.push(Pending::Done(Output::Map { page, slot, bytes: PageBytes::InMessage }));
        }
    }
}

impl fmt::Display for MessageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Parse(error) => write!(f, "{error}"),
            Self::Cluster(cluster) => write!(f, "message of another cluster, {:#x}", cluster.0),
            Self::Epoch(epoch) => write!(f, "message of epoch {}", epoch.0),
            Self::To(to) => write!(f, "message for {to}"),
            Self::ToIncarnation(to) => write!(f, "message for incarnation {} of this node", to.0),
            Self::OldIncarnation(from) => {
                write!(f, "message of incarnation {}, and there is a later one", from.0)
            }
            Self::Dead(from) => write!(f, "message of {from}, which is dead"),
            Self::NoSuchPage(page) => write!(f, "message about {page}, which does not exist"),
            Self::NotOwner { page, from } => write!(f, "{from} sent {page} and does not hold it"),
            Self::Fragment { offset, bytes } => {
                write!(f, "{bytes} bytes from byte {offset} on are no page and no fragment")
            }
            Self::Request => write!(f, "a request, and this is no home"),
            Self::Late(page) => write!(f, "an answer about {page} that nobody waits for"),
        }
    }
}

impl core::error::Error for MessageError {}
