//! The ways to read a space of which only a part is resident.

use core::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Result, ensure};
use dsm_core::transport::Transport;
use fault_linux::{BackendKind, Region};

use crate::space::{Lent, Numbers, Space, word};
use crate::table1::paper_like::PaperLike;

/// A way to read a space of which a part is resident.
pub(super) trait Reader {
    /// Loads random words, checks each, and gives back the nanoseconds of every load that missed.
    fn read(&mut self, numbers: &mut Numbers, count: u32) -> Result<Vec<u32>>;
}

/// Pages of a region, over a transport.
pub(super) struct ByRegion<T> {
    pub(super) space: Space,
    pub(super) region: Arc<Region>,
    pub(super) port: T,
}

impl<T: Transport> Reader for ByRegion<T> {
    fn read(&mut self, numbers: &mut Numbers, count: u32) -> Result<Vec<u32>> {
        let Self { space, region, port } = self;
        let attached = region.attach(Lent(port))?;
        let faults = || region.stats().faults;
        let misses = if region.choice().used == BackendKind::Soft {
            let load = |index: usize| {
                let record = attached.record(index as u64 * 8, 8);
                record.map_or(0, |record| bytemuck::pod_read_unaligned(&record))
            };
            time_misses(*space, numbers, count, load, faults)?
        } else {
            let words: &[u64] = bytemuck::cast_slice(attached.bytes());
            // Behind a black box, so that the load stays between the clocks.
            time_misses(*space, numbers, count, |index| *black_box(&words[index]), faults)?
        };
        attached.check()?;
        Ok(misses)
    }
}

impl Reader for PaperLike {
    fn read(&mut self, numbers: &mut Numbers, count: u32) -> Result<Vec<u32>> {
        let caught = self.catch_faults()?;
        time_misses(caught.space(), numbers, count, |index| caught.load(index), || caught.faults())
    }
}

/// Loads random words and times those that fault. The clock's own time, some 50 ns, is part of it.
fn time_misses(
    space: Space,
    numbers: &mut Numbers,
    count: u32,
    mut load: impl FnMut(usize) -> u64,
    faults: impl Fn() -> u64,
) -> Result<Vec<u32>> {
    let mut misses = Vec::new();
    let mut before = faults();
    for _ in 0..count {
        let index = numbers.below(space.words());
        let start = Instant::now();
        let found = black_box(load(index));
        let time = start.elapsed();
        ensure!(found == word(index), "word {index} is read wrong");
        let after = faults();
        if after != before {
            misses.push(u32::try_from(time.as_nanos()).unwrap_or(u32::MAX));
        }
        before = after;
    }
    Ok(misses)
}
