//! Two memories that hold the same, read in turns.

use core::hint::black_box;
use std::time::Instant;

use anyhow::{Result, ensure};
use dsm_core::node::EVICT_BATCH_MAX;
use fault_linux::BackendKind;

use super::access::{Accesses, Objects, Pattern, Readable, Records, Words};
use crate::memory::{HugePages, Memory, Scattered};
use crate::owner::ShmOwner;
use crate::space::{Numbers, Space, word};

/// What is compared with a plain array of 4 KB pages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Subject {
    /// Pages that appeared by this backend, all resident.
    Pages(BackendKind),
    /// Another plain array: what comes out besides 1 is the error of the method.
    Again,
    /// A plain array of huge pages, to show what is lost by going without.
    HugePages,
    /// The paper's other way: a table of objects under a lock, each counted while it is looked at.
    Objects,
}

/// Nanoseconds of one access, to the plain array and to the subject, in neighbouring moments.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair {
    pub(super) subject: Subject,
    pub(super) pattern: Pattern,
    pub(super) plain_ns: f64,
    pub(super) subject_ns: f64,
}

/// How much is read.
#[derive(Clone, Copy, Debug)]
pub(super) struct Amount {
    pub(super) rounds: u64,
    /// Turns of each round; plain array and subject have one each.
    pub(super) turns: u64,
    /// Accesses of one turn.
    pub(super) accesses: u32,
}

/// What all comparisons need.
#[derive(Debug)]
pub(super) struct Turns<'a> {
    space: Space,
    amount: Amount,
    owner: &'a ShmOwner,
    /// Memory that is read only to drive other memory out of the caches.
    wash: Memory,
}

/// A subject that is about to be made, and the plain array if that came first.
#[derive(Debug)]
struct Making<'a> {
    turns: &'a Turns<'a>,
    subject: Subject,
    round: u64,
    plain: Option<Memory>,
}

/// Accesses that were made.
#[derive(Clone, Copy, Debug)]
struct Timed {
    /// Nanoseconds of one access.
    ns: f64,
    /// What all of them read.
    read: u64,
}

/// Slots that stay free, so that nothing is evicted ahead of need.
const SPARE_SLOTS: u32 = EVICT_BATCH_MAX;

impl Subject {
    pub(super) const ALL: [Self; 6] = [
        Self::Again,
        Self::Pages(BackendKind::Uffd),
        Self::Pages(BackendKind::Segv),
        Self::HugePages,
        Self::Pages(BackendKind::Soft),
        Self::Objects,
    ];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Pages(kind) => kind.name(),
            Self::Again => "plain array, another",
            Self::HugePages => "plain array, huge pages",
            Self::Objects => "objects",
        }
    }
}

impl<'a> Turns<'a> {
    pub(super) fn new(space: Space, amount: Amount, owner: &'a ShmOwner) -> Result<Self> {
        Ok(Self { space, amount, owner, wash: filled(space, HugePages::Advised)? })
    }

    /// Times a plain array and the subject, both made anew, and all of it again with the other made first.
    ///
    /// Where memory lies is luck, and worth ten per cent: whoever is made later gets more scattered pages of the
    /// machine. So each pair is the mean of both orders.
    pub(super) fn compare(&self, subject: Subject, round: u64) -> Result<Vec<Pair>> {
        let [early, late] = [true, false].map(|plain_first| self.make_and_time(subject, round, plain_first));
        Ok(early?.into_iter().zip(late?).map(|(one, other)| one.mean(other)).collect())
    }

    fn make_and_time(&self, subject: Subject, round: u64, plain_first: bool) -> Result<Vec<Pair>> {
        let _scattered = Scattered::next(2 * self.space.bytes(), &mut Numbers::new(round))?;
        let plain = if plain_first { Some(filled(self.space, HugePages::Never)?) } else { None };
        let pair = Making { turns: self, subject, round, plain };
        match subject {
            Subject::Again => pair.time(&Words(filled(self.space, HugePages::Never)?.words())),
            Subject::HugePages => pair.time(&Words(filled(self.space, HugePages::Advised)?.words())),
            Subject::Objects => pair.time(&Objects::new(self.space)),
            Subject::Pages(kind) => self.time_pages(kind, pair),
        }
    }

    fn time_pages(&self, kind: BackendKind, pair: Making<'_>) -> Result<Vec<Pair>> {
        let Self { space, owner, .. } = *self;
        let region = space.region(kind, space.pages + SPARE_SLOTS, 1)?;
        let attached = region.attach(space.direct_port(owner.pages())?)?;
        let pairs = match kind {
            BackendKind::Soft => pair.time(&Records(&attached))?,
            _ => pair.time(&Words(bytemuck::cast_slice(attached.bytes())))?,
        };
        attached.check()?;
        let stats = region.stats();
        let all_stayed = stats.fetched_pages == u64::from(space.pages) && stats.evicted_pages == 0;
        ensure!(all_stayed, "not every access was a hit: {stats:?}");
        Ok(pairs)
    }

    /// Times the same accesses to both, in either order.
    fn time_both(&self, both: [&dyn Readable; 2], accesses: Accesses, in_order: bool) -> [Timed; 2] {
        let [one, other] = both;
        if in_order {
            return both.map(|blocks| self.time(blocks, accesses));
        }
        let [other, one] = [other, one].map(|blocks| self.time(blocks, accesses));
        [one, other]
    }

    fn time(&self, blocks: &dyn Readable, accesses: Accesses) -> Timed {
        if accesses.pattern != Pattern::Hot {
            // Else whoever was read last finds a part of itself in the caches.
            black_box(self.wash.words().iter().fold(0u64, |sum, word| sum.wrapping_add(*word)));
        }
        let start = Instant::now();
        let read = blocks.read(accesses);
        let ns = start.elapsed().as_secs_f64() * 1e9 / f64::from(accesses.blocks());
        Timed { ns, read }
    }
}

impl Making<'_> {
    /// Times all patterns, turn by turn, once every word of the subject is found right; that is also what brings its
    /// pages.
    fn time(self, blocks: &dyn Readable) -> Result<Vec<Pair>> {
        let Self { turns: &Turns { space, amount, .. }, subject, round, plain } = self;
        for index in 0..space.words() {
            ensure!(blocks.word_at(index) == word(index), "{} reads word {index} wrong", subject.name());
        }
        let plain = plain.map_or_else(|| filled(space, HugePages::Never), Ok)?;
        let plain = &Words(plain.words());
        let mut pairs = Vec::new();
        for turn in 0..amount.turns {
            for pattern in Pattern::ALL {
                let accesses = Accesses { pattern, space, count: amount.accesses, seed: round << 32 | turn };
                let [plain, found] = self.turns.time_both([plain, blocks], accesses, turn.is_multiple_of(2));
                ensure!(found.read == plain.read, "{} reads other words than the array", subject.name());
                pairs.push(Pair { subject, pattern, plain_ns: plain.ns, subject_ns: found.ns });
            }
        }
        Ok(pairs)
    }
}

impl Pair {
    /// The mean of two pairs of the same accesses.
    fn mean(self, other: Self) -> Self {
        debug_assert!(self.subject == other.subject && self.pattern == other.pattern);
        let plain_ns = (self.plain_ns + other.plain_ns) / 2.0;
        let subject_ns = (self.subject_ns + other.subject_ns) / 2.0;
        Self { plain_ns, subject_ns, ..self }
    }
}

/// An array with the space's words.
fn filled(space: Space, huge_pages: HugePages) -> Result<Memory> {
    let mut memory = Memory::array(space.bytes(), huge_pages)?;
    for (index, place) in memory.words_mut().iter_mut().enumerate() {
        *place = word(index);
    }
    Ok(memory)
}
