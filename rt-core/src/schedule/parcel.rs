//! Something that is sent again until the other side says that it has it.

use super::mutants::{self, Mutant};

/// Tiles on their way to one receiver. There is one parcel at a time, and parcels are numbered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Parcel {
    /// Of the parcel that is open, or of the last one.
    pub(super) number: u32,
    pub(super) is_open: bool,
    /// It is to be sent, for the first time or again.
    pub(super) is_due: bool,
    sent_us: u64,
    tries: u8,
}

impl Parcel {
    /// None was ever sent; the first will have the number after `number`.
    pub(super) const fn none(number: u32) -> Self {
        Self { number, is_open: false, is_due: false, sent_us: 0, tries: 0 }
    }

    /// Opens the next parcel.
    pub(super) const fn open(&mut self) {
        *self =
            Self { number: self.number.wrapping_add(1), is_open: true, is_due: true, sent_us: 0, tries: 0 };
    }

    /// It was never sent.
    pub(super) const fn is_new(&self) -> bool {
        self.tries == 0
    }

    /// How often it was sent.
    pub(super) const fn tries(&self) -> u8 {
        self.tries
    }

    pub(super) const fn note_sent(&mut self, now_us: u64) {
        self.is_due = false;
        self.sent_us = now_us;
        self.tries = self.tries.saturating_add(1);
    }

    /// The other side has it. Tells whether that is news.
    pub(super) const fn acknowledge(&mut self, number: u32) -> bool {
        let is_news = self.is_open && self.number == number;
        if is_news {
            self.is_open = false;
            self.is_due = false;
        }
        is_news
    }

    /// When it is to be sent again, if it is neither due nor acknowledged.
    pub(super) fn deadline(&self, resend_us: u64) -> Option<u64> {
        if !self.is_open || self.is_due || mutants::is_on(Mutant::NeverResend) {
            return None;
        }
        let doublings = if self.tries < DOUBLINGS_MAX { self.tries } else { DOUBLINGS_MAX };
        Some(self.sent_us.saturating_add(resend_us << doublings.saturating_sub(1)))
    }

    /// Makes it due when its time has come; tells whether it has.
    pub(super) fn expire(&mut self, now_us: u64, resend_us: u64) -> bool {
        match self.deadline(resend_us) {
            Some(deadline) if deadline <= now_us => {
                self.is_due = true;
                true
            }
            _ => false,
        }
    }
}

/// The time to the next sending doubles so often.
const DOUBLINGS_MAX: u8 = 5;
