//! The accesses that are timed, for every way to reach a word.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use dsm_core::transport::Transport;
use fault_linux::Attached;

use crate::space::{Numbers, PAGE_BYTES, PAGE_WORDS, Space, word};

/// How the space is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pattern {
    /// Words of two pages that stay in the innermost cache, each load waiting for the one before: what the way
    /// itself costs.
    Hot,
    /// Words of random pages, each load waiting for the one before.
    Dependent,
    /// Words of random pages, as many under way as the processor manages.
    Independent,
    /// All words of random pages.
    WholeBlock,
}

/// Accesses that repeat for a seed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Accesses {
    pub(super) pattern: Pattern,
    pub(super) space: Space,
    pub(super) count: u32,
    pub(super) seed: u64,
}

/// A space that can be read word by word.
pub(super) trait Blocks {
    /// A word, counted from the start of the space.
    fn word(&self, index: usize) -> u64;

    /// The sum of a page's words.
    fn block_sum(&self, page: usize) -> u64;
}

/// [`Blocks`] behind a pointer; one call for many accesses.
pub(super) trait Readable {
    /// A word, for a look at whether it is right.
    fn word_at(&self, index: usize) -> u64;

    /// Makes the accesses. The answer depends on every word that was read.
    fn read(&self, accesses: Accesses) -> u64;
}

/// Plain loads: from an array, and from pages that the hardware looks after. One type, so that both run the very same
/// instructions.
pub(super) struct Words<'a>(pub(super) &'a [u64]);

/// The `soft` backend: every access asks for its record.
pub(super) struct Records<'a, T: Transport>(pub(super) &'a Attached<T>);

/// An object for each block.
pub(super) struct Objects(Mutex<HashMap<usize, Arc<[u64]>>>);

/// Two pages are 32 KB.
const HOT_PAGES: usize = 2;

/// Reading a whole block takes some ten times as long as a load that misses every cache.
const ACCESSES_PER_BLOCK: u32 = 8;

impl Pattern {
    pub(super) const ALL: [Self; 4] = [Self::Hot, Self::Dependent, Self::Independent, Self::WholeBlock];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Hot => "hot loads",
            Self::Dependent => "dependent loads",
            Self::Independent => "independent loads",
            Self::WholeBlock => "whole blocks",
        }
    }
}

impl Accesses {
    /// Accesses that are made: fewer when each reads a whole block.
    pub(super) const fn blocks(&self) -> u32 {
        match self.pattern {
            Pattern::WholeBlock => self.count.div_ceil(ACCESSES_PER_BLOCK),
            Pattern::Hot | Pattern::Dependent | Pattern::Independent => self.count,
        }
    }
}

impl<B: Blocks> Readable for B {
    fn word_at(&self, index: usize) -> u64 {
        self.word(index)
    }

    fn read(&self, accesses: Accesses) -> u64 {
        let (numbers, count, space) = (Numbers::new(accesses.seed), accesses.blocks(), accesses.space);
        match accesses.pattern {
            Pattern::Hot => dependent(self, numbers, count, HOT_PAGES * PAGE_WORDS),
            Pattern::Dependent => dependent(self, numbers, count, space.words()),
            Pattern::Independent => independent(self, numbers, count, space.words()),
            Pattern::WholeBlock => whole_blocks(self, numbers, count, space.pages as usize),
        }
    }
}

// Never inlined: the plain array and the resident pages are read by one and the same copy of the code.
#[inline(never)]
fn dependent<B: Blocks>(blocks: &B, mut numbers: Numbers, count: u32, words: usize) -> u64 {
    for _ in 0..count {
        let index = numbers.below(words);
        numbers.stir(blocks.word(index));
    }
    numbers.below(u32::MAX as usize) as u64
}

#[inline(never)]
fn independent<B: Blocks>(blocks: &B, mut numbers: Numbers, count: u32, words: usize) -> u64 {
    let sum = |sum: u64, _| sum.wrapping_add(blocks.word(numbers.below(words)));
    (0..count).fold(0, sum)
}

#[inline(never)]
fn whole_blocks<B: Blocks>(blocks: &B, mut numbers: Numbers, count: u32, pages: usize) -> u64 {
    let sum = |sum: u64, _| sum.wrapping_add(blocks.block_sum(numbers.below(pages)));
    (0..count).fold(0, sum)
}

impl Blocks for Words<'_> {
    #[inline]
    fn word(&self, index: usize) -> u64 {
        self.0[index]
    }

    #[inline]
    fn block_sum(&self, page: usize) -> u64 {
        sum(&self.0[page * PAGE_WORDS..(page + 1) * PAGE_WORDS])
    }
}

impl<T: Transport> Blocks for Records<'_, T> {
    #[inline]
    fn word(&self, index: usize) -> u64 {
        let record = self.0.record(index as u64 * 8, 8).expect("a record of the space");
        bytemuck::pod_read_unaligned(&record)
    }

    #[inline]
    fn block_sum(&self, page: usize) -> u64 {
        let (offset, length) = (page as u64 * u64::from(PAGE_BYTES), PAGE_BYTES as usize);
        let record = self.0.record(offset, length).expect("a page of the space");
        sum(bytemuck::cast_slice(&record))
    }
}

impl Objects {
    /// All blocks of a space.
    pub(super) fn new(space: Space) -> Self {
        let block = |page: usize| (page * PAGE_WORDS..(page + 1) * PAGE_WORDS).map(word).collect();
        Self(Mutex::new((0..space.pages as usize).map(|page| (page, block(page))).collect()))
    }

    /// Finds a block and counts who looks at it, so that it cannot go meanwhile.
    #[inline]
    fn block(&self, page: usize) -> Arc<[u64]> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)[&page].clone()
    }
}

impl Blocks for Objects {
    #[inline]
    fn word(&self, index: usize) -> u64 {
        self.block(index / PAGE_WORDS)[index % PAGE_WORDS]
    }

    #[inline]
    fn block_sum(&self, page: usize) -> u64 {
        sum(&self.block(page))
    }
}

#[inline]
fn sum(words: &[u64]) -> u64 {
    words.iter().fold(0, |sum, word| sum.wrapping_add(*word))
}
