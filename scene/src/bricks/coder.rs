//! Makes stored samples of a volume's samples.

use rayon::prelude::*;
use rt_core::volume::{BRICK_SAMPLES, HISTOGRAM_BINS, VolumeTable};

use super::slabs::Slab;
use super::survey::is_absent;
use crate::volume::{Storage, StoredType};

/// How samples are stored, and what their ranges count in.
#[derive(Debug)]
pub(super) struct Coder {
    pub(super) storage: Storage,
    pub(super) table: VolumeTable,
}

/// A brick ready to be written.
pub(super) struct Encoded {
    pub(super) index: u64,
    pub(super) at: [u32; 3],
    pub(super) bytes: Vec<u8>,
    pub(super) low: u8,
    pub(super) high: u8,
}

impl Coder {
    /// The bytes of a brick of a slab, and its range.
    pub(super) fn encode(&self, slab: &Slab, index: u64, at: [u32; 3]) -> Encoded {
        let size = self.storage.stored.bytes();
        let mut bytes = vec![0; BRICK_SAMPLES * size];
        let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
        for (place, row) in slab.rows([at[0], at[1]]) {
            for (&sample, bytes) in row.iter().zip(bytes[place * size..].chunks_exact_mut(size)) {
                if is_absent(sample) {
                    // The storage is single precision then.
                    bytes.copy_from_slice(&f32::NAN.to_le_bytes());
                    continue;
                }
                let code = self.storage.encode(sample) + 0.0;
                (low, high) = (low.min(code), high.max(code));
                put_code(self.storage.stored, code, bytes);
            }
        }
        let (low, high) = (self.table.low_byte(low), self.table.high_byte(high));
        Encoded { index, at, bytes, low, high }
    }

    /// Adds samples to the histogram.
    pub(super) fn count(&mut self, slab: &Slab) {
        let VolumeTable { histogram_low, histogram_high, .. } = self.table;
        let per_bin = HISTOGRAM_BINS as f32 / (histogram_high - histogram_low).max(f32::MIN_POSITIVE);
        let storage = &self.storage;
        let bin = |sample: f32| {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "the cast of a float saturates, as wanted"
            )]
            let bin = ((storage.encode(sample) - histogram_low) * per_bin) as usize;
            bin.min(HISTOGRAM_BINS - 1)
        };
        let samples = slab.new_samples();
        let part = samples.len().div_ceil(rayon::current_num_threads().max(1)).max(1);
        let counts: Vec<[u64; HISTOGRAM_BINS]> = samples
            .par_chunks(part)
            .map(|samples| {
                let mut counts = [0; HISTOGRAM_BINS];
                samples.iter().filter(|x| !is_absent(**x)).for_each(|&sample| counts[bin(sample)] += 1);
                counts
            })
            .collect();
        for counts in counts {
            self.table.histogram.iter_mut().zip(counts).for_each(|(sum, count)| *sum += count);
        }
    }
}

fn put_code(stored: StoredType, code: f32, bytes: &mut [u8]) {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a whole number of that many bits"
    )]
    match stored {
        StoredType::U8 => bytes.copy_from_slice(&[code as u8]),
        StoredType::U16 => bytes.copy_from_slice(&(code as u16).to_le_bytes()),
        StoredType::F32 => bytes.copy_from_slice(&code.to_le_bytes()),
    }
}
