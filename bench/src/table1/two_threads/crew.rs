//! Threads that read a region until so many accesses are made.

use core::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Barrier};
use std::thread;
use std::time::Instant;

use anyhow::{Result, anyhow, ensure};
use fault_linux::Region;

use crate::owner::ShmOwner;
use crate::space::{Numbers, PAGE_WORDS, Space, word};

/// Accesses that a thread takes at a time, so that all end at the same moment.
const CHUNK: u32 = 32;

/// Threads that read a region.
pub(super) struct Crew<'a> {
    pub(super) space: Space,
    pub(super) owner: &'a ShmOwner,
    pub(super) region: &'a Arc<Region>,
    pub(super) threads: u32,
    pub(super) seed: u64,
}

/// What the threads of a crew share.
struct Work {
    start: Barrier,
    left: AtomicU32,
}

impl Crew<'_> {
    /// Makes so many accesses, and gives back how many misses a second there were.
    pub(super) fn read(&self, accesses: u32) -> Result<f64> {
        let work =
            Work { start: Barrier::new(self.threads as usize), left: AtomicU32::new(accesses / CHUNK) };
        let before = self.region.stats().fetched_pages;
        let spans = thread::scope(|scope| {
            let start = |thread| {
                let work = &work;
                scope.spawn(move || self.read_as(thread, work))
            };
            let threads: Vec<_> = (0..self.threads).map(start).collect();
            let spans =
                threads.into_iter().map(|thread| thread.join().map_err(|_| anyhow!("a reader panicked"))?);
            spans.collect::<Result<Vec<_>>>()
        })?;
        let misses = self.region.stats().fetched_pages - before;
        let start = spans.iter().map(|(start, _)| *start).min();
        let end = spans.iter().map(|(_, end)| *end).max();
        let seconds = end.zip(start).map_or(0.0, |(end, start)| end.duration_since(start).as_secs_f64());
        Ok(misses as f64 / seconds)
    }

    /// Reads as one of the threads: words of its own pages, which lie between those of the others.
    fn read_as(&self, thread: u32, work: &Work) -> Result<(Instant, Instant)> {
        let Self { space, region, threads, .. } = *self;
        let attached = region.attach(space.direct_port(self.owner.pages())?);
        // Before any question mark: who does not come to the start keeps the others waiting for ever.
        work.start.wait();
        let attached = attached?;
        let words: &[u64] = bytemuck::cast_slice(attached.bytes());
        let mut numbers = Numbers::new(self.seed << 8 | u64::from(thread));
        let start = Instant::now();
        while take(&work.left) {
            for _ in 0..CHUNK {
                let index = numbers.below(space.words() / threads as usize);
                let page = index / PAGE_WORDS * threads as usize + thread as usize;
                let index = page * PAGE_WORDS + index % PAGE_WORDS;
                ensure!(words[index] == word(index), "word {index} is read wrong");
            }
        }
        let end = Instant::now();
        attached.check()?;
        Ok((start, end))
    }
}

/// Takes one of those left, if there is one.
fn take(left: &AtomicU32) -> bool {
    left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1)).is_ok()
}
