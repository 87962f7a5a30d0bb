//! The first look at a volume: range of the samples, how they are spread, which bricks show anything.

use rayon::prelude::*;
use rt_core::volume::{HISTOGRAM_BINS, TABLE_EDGES, VALUE_MAX, VolumeTable, bricks_along};

use super::PrepareError;
use super::slabs::{Slab, for_each_slab};
use crate::volume::{SampleRange, Storage, StoredType, VolumeSource};

/// What is known of a volume after reading it once.
#[derive(Debug)]
pub(super) struct Survey {
    /// Bricks along each axis.
    bricks: [u32; 3],
    /// One bit for each brick, x fastest: its samples are not all the same.
    varied: Vec<u64>,
    spread: Spread,
}

/// Counts of samples by the leading bits of their value: parts of one in 500 of a value, whatever its size.
#[derive(Clone, Debug)]
struct Spread {
    counts: Vec<u64>,
    low: f32,
    high: f32,
    absent: u64,
}

impl Survey {
    pub(super) fn of(source: &mut dyn VolumeSource, dims: [u32; 3]) -> Result<Self, PrepareError> {
        let bricks = dims.map(bricks_along);
        let count: u64 = bricks.iter().map(|&count| u64::from(count)).product();
        let words = usize::try_from(count.div_ceil(64)).map_err(|_| PrepareError::TooLarge { dims })?;
        let mut survey = Self { bricks, varied: vec![0; words], spread: Spread::new() };
        for_each_slab(source, dims, |slab| {
            survey.spread.add_all(slab.new_samples());
            survey.mark_varied(slab);
            Ok(())
        })?;
        Ok(survey)
    }

    /// Whether a brick shows a surface of any isovalue.
    pub(super) fn is_varied(&self, at: [u32; 3]) -> bool {
        let index = self.index(at);
        self.varied[index / 64] >> (index % 64) & 1 != 0
    }

    /// Bricks along each axis.
    pub(super) const fn bricks(&self) -> [u32; 3] {
        self.bricks
    }

    /// Range of the finite samples; 0 when there are none.
    pub(super) fn range(&self) -> SampleRange {
        let (low, high) = self.spread.ends();
        SampleRange { low, high, is_finite: self.spread.absent == 0 }
    }

    /// The table for samples that are stored so. The histogram is empty yet.
    pub(super) fn table(&self, storage: &Storage) -> VolumeTable {
        let [histogram_low, histogram_high] = self.spread.middle().map(|sample| storage.encode(sample));
        VolumeTable {
            edges: self.edges(storage),
            histogram: [0; HISTOGRAM_BINS],
            histogram_low,
            histogram_high,
            absent: self.spread.absent,
        }
    }

    fn edges(&self, storage: &Storage) -> [f32; TABLE_EDGES] {
        if storage.stored == StoredType::U8 {
            return core::array::from_fn(|code| code as f32);
        }
        let mut edges = self.spread.edges().map(|edge| storage.encode(edge));
        let (low, high) = self.spread.ends();
        edges[0] = storage.encode(low);
        edges[TABLE_EDGES - 1] = storage.encode(high);
        edges
    }

    fn mark_varied(&mut self, slab: &Slab) {
        let [columns, rows] = slab.bricks();
        if slab.dims[2] < 2 {
            return;
        }
        let varied: Vec<[u32; 3]> = (0..rows)
            .into_par_iter()
            .flat_map_iter(|y| (0..columns).map(move |x| [x, y]))
            .filter(|&at| is_varied(slab, at))
            .map(|[x, y]| [x, y, slab.layer])
            .collect();
        for at in varied {
            let index = self.index(at);
            self.varied[index / 64] |= 1 << (index % 64);
        }
    }

    fn index(&self, [x, y, z]: [u32; 3]) -> usize {
        let [columns, rows, _] = self.bricks.map(|count| count as usize);
        (z as usize * rows + y as usize) * columns + x as usize
    }
}

impl Spread {
    fn new() -> Self {
        Self { counts: vec![0; BINS], low: f32::INFINITY, high: f32::NEG_INFINITY, absent: 0 }
    }

    fn add_all(&mut self, samples: &[f32]) {
        let part = samples.len().div_ceil(rayon::current_num_threads().max(1)).max(1);
        let spreads: Vec<Self> = samples.par_chunks(part).map(Self::of).collect();
        for spread in &spreads {
            self.low = self.low.min(spread.low);
            self.high = self.high.max(spread.high);
            self.absent += spread.absent;
            self.counts.iter_mut().zip(&spread.counts).for_each(|(count, more)| *count += more);
        }
    }

    fn of(samples: &[f32]) -> Self {
        let mut spread = Self::new();
        for &sample in samples {
            if is_absent(sample) {
                spread.absent += 1;
                continue;
            }
            // -0 counts as 0.
            let sample = sample + 0.0;
            spread.low = spread.low.min(sample);
            spread.high = spread.high.max(sample);
            spread.counts[bin(sample)] += 1;
        }
        spread
    }

    /// Lowest and highest sample; 0 when there is none.
    fn ends(&self) -> (f32, f32) {
        if self.low <= self.high { (self.low, self.high) } else { (0.0, 0.0) }
    }

    /// Where all but a thousandth of the samples lie, at either end.
    fn middle(&self) -> [f32; 2] {
        let total: u64 = self.counts.iter().sum();
        let beyond = |count: u64| {
            let mut sum = 0;
            self.counts.iter().position(|bin| {
                sum += bin;
                sum > count
            })
        };
        let (low, high) = self.ends();
        let first = beyond(total / 1000).map_or(low, lowest_of);
        let last = beyond(total - total / 1000 - total.min(1)).map_or(high, |bin| lowest_of(bin + 1));
        [first.max(low), last.min(high)]
    }

    /// Samples in ascending order that leave about as many samples between any two; a value that is very frequent
    /// does not take more than its share.
    fn edges(&self) -> [f32; TABLE_EDGES] {
        let total: u64 = self.counts.iter().sum();
        let most = (total / TABLE_EDGES as u64).max(1);
        let shares = || self.counts.iter().map(|&count| count.min(most));
        let total: u64 = shares().sum();
        let (low, high) = self.ends();
        let mut edges = [high; TABLE_EDGES];
        let (mut sum, mut edge) = (0, 0);
        for (bin, share) in shares().enumerate() {
            while edge < TABLE_EDGES && sum + share > total * edge as u64 / (TABLE_EDGES as u64 - 1) {
                edges[edge] = lowest_of(bin).clamp(low, high);
                edge += 1;
            }
            sum += share;
        }
        edges
    }
}

fn is_varied(slab: &Slab, at: [u32; 2]) -> bool {
    let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
    for (_, row) in slab.rows(at) {
        for &sample in row.iter().filter(|sample| !is_absent(**sample)) {
            low = low.min(sample);
            high = high.max(sample);
        }
    }
    low < high
}

/// Whether a sample is one that no surface can be next to.
pub(super) fn is_absent(sample: f32) -> bool {
    sample.is_nan() || sample.abs() > VALUE_MAX
}

/// The part that a sample lies in: its leading bits, in an order in which they ascend.
fn bin(sample: f32) -> usize {
    let bits = sample.to_bits();
    let ascending = if bits >> 31 == 0 { bits | 1 << 31 } else { !bits };
    (ascending >> (32 - BIN_BITS)) as usize
}

/// The lowest sample of a part.
fn lowest_of(bin: usize) -> f32 {
    let ascending = u32::try_from(bin).unwrap_or(u32::MAX) << (32 - BIN_BITS);
    f32::from_bits(if ascending >> 31 == 0 { !ascending } else { ascending & !(1 << 31) })
}

const BIN_BITS: u32 = 18;

const BINS: usize = 1 << BIN_BITS;
