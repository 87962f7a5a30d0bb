//! Counters, and a histogram of times that needs no floating point.

use crate::prefetch::Foretold;

/// What a node has counted since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NodeStats {
    /// Faults, each counted once however often it was tried again.
    pub faults: u64,
    /// Faults that found another thread fetching the page, or the page on its way out.
    pub merged_faults: u64,
    /// Faults that found the page here already, brought by another thread meanwhile.
    pub ready_faults: u64,
    /// Faults that had to wait because every slot was on its way in or out.
    pub full_faults: u64,
    /// Faults that found the page hidden: it was shown, and no message was sent.
    pub soft_faults: u64,
    /// Pages that were hidden.
    pub hidden_pages: u64,
    /// Requests begun, one for each page fetched.
    pub requests: u64,
    /// Requests sent again because no answer came in time.
    pub resends: u64,
    /// Requests that went on to another copy of the page: the one before was silent, dead, or refused.
    pub failovers: u64,
    /// Requests sent to a suspected peer besides, to see whether it is back.
    pub probes: u64,
    /// Peers that were found or said to be dead.
    pub dead_peers: u64,
    /// Fragments of pages that came and were stored.
    pub fragments: u64,
    /// Pages asked for before the tile that touched them in the last frame.
    pub tile_prefetch: PrefetchStats,
    /// Pages asked for together with one that they follow.
    pub neighbour_prefetch: PrefetchStats,
    /// Requests made ahead that a fault found under way: it waited for less than a whole one.
    pub adopted_requests: u64,
    /// Requests made ahead that were given up, while nobody waited for their pages.
    pub abandoned_requests: u64,
    /// Pages granted and put into a slot.
    pub fetched_pages: u64,
    /// Bytes of those pages.
    pub received_bytes: u64,
    /// Pages chosen as victims.
    pub evicted_pages: u64,
    /// Pages that could not be had.
    pub failed_pages: u64,
    /// Messages refused: malformed, of another cluster, epoch or incarnation, from the wrong node or a dead one.
    pub refused_messages: u64,
    /// Answers that came late or twice and were dropped.
    pub late_answers: u64,
}

/// Pages asked for before anybody touched them, and what became of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PrefetchStats {
    /// Pages asked for.
    pub asked: u64,
    /// Of those, pages that are known to have been used.
    pub used: u64,
    /// Of those, pages that left and are not known to have been used, and pages that could not be had.
    pub wasted: u64,
}

/// What a home has counted since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HomeStats {
    /// Pages granted to other nodes.
    pub granted_pages: u64,
    /// Requests refused to nodes that asked for what this node does not hold.
    pub refused_requests: u64,
    /// Messages refused: malformed, of another cluster or epoch.
    pub refused_messages: u64,
}

impl NodeStats {
    /// What is counted of pages that were foretold in this way.
    pub fn prefetch_mut(&mut self, foretold: Foretold) -> &mut PrefetchStats {
        match foretold {
            Foretold::ByTile => &mut self.tile_prefetch,
            Foretold::ByNeighbour => &mut self.neighbour_prefetch,
        }
    }

    /// Pages that were foretold in whatever way.
    #[must_use]
    pub const fn prefetch(&self) -> PrefetchStats {
        let (tiles, neighbours) = (self.tile_prefetch, self.neighbour_prefetch);
        PrefetchStats {
            asked: tiles.asked + neighbours.asked,
            used: tiles.used + neighbours.used,
            wasted: tiles.wasted + neighbours.wasted,
        }
    }
}

/// Counts times in buckets that widen with the time: 8 to each doubling, so a quantile is off by 12 % at most.
///
/// # Shape and units
/// Any `u64`; the unit is the caller's (nanoseconds throughout this project). 2 KB, no allocation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Histogram {
    buckets: [u32; BUCKETS],
    count: u64,
    max: u64,
}

impl Histogram {
    /// A histogram of nothing.
    pub const EMPTY: Self = Self { buckets: [0; BUCKETS], count: 0, max: 0 };

    /// Counts one time.
    pub fn record(&mut self, value: u64) {
        let bucket = &mut self.buckets[bucket_of(value)];
        *bucket = bucket.saturating_add(1);
        self.count += 1;
        self.max = self.max.max(value);
    }

    /// Counts what `other` has counted.
    pub fn merge(&mut self, other: &Self) {
        for (bucket, other) in self.buckets.iter_mut().zip(&other.buckets) {
            *bucket = bucket.saturating_add(*other);
        }
        self.count += other.count;
        self.max = self.max.max(other.max);
    }

    /// Times counted.
    #[must_use]
    pub const fn count(&self) -> u64 {
        self.count
    }

    /// The longest time counted, exactly. 0 when there is none.
    #[must_use]
    pub const fn max(&self) -> u64 {
        self.max
    }

    /// The time that `per_mille` of a thousand do not exceed, up to the width of its bucket. 0 when there is none.
    ///
    /// 500 is the median, 990 the time that 99 of 100 stay below.
    #[must_use]
    pub fn quantile(&self, per_mille: u32) -> u64 {
        let rank = (u128::from(self.count) * u128::from(per_mille)).div_ceil(1000).max(1);
        let mut seen = 0u128;
        for (index, bucket) in self.buckets.iter().enumerate() {
            seen += u128::from(*bucket);
            if seen >= rank {
                return last_of(index).min(self.max);
            }
        }
        0
    }
}

impl Default for Histogram {
    fn default() -> Self {
        Self::EMPTY
    }
}

/// Values below `STEPS` have a bucket each; above, each doubling has `STEPS` buckets.
fn bucket_of(value: u64) -> usize {
    let octave = (63 - (value | 1).leading_zeros()).saturating_sub(STEP_BITS - 1);
    let step = value >> octave.saturating_sub(1);
    let index = if octave == 0 { value } else { u64::from(octave) * STEPS + (step - STEPS) };
    usize::try_from(index).unwrap_or(BUCKETS - 1).min(BUCKETS - 1)
}

/// The largest value that falls into the bucket.
fn last_of(bucket: usize) -> u64 {
    let bucket = bucket as u64;
    let octave = bucket / STEPS;
    if octave == 0 {
        return bucket;
    }
    let step = bucket % STEPS + STEPS + 1;
    let shift = u32::try_from(octave - 1).unwrap_or(0);
    step.checked_mul(1 << shift).map_or(u64::MAX, |end| end - 1)
}

const STEP_BITS: u32 = 3;
const STEPS: u64 = 1 << STEP_BITS;
const BUCKETS: usize = 62 * 8;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_value_lies_in_its_bucket_and_the_bucket_is_narrow(value in any::<u64>(), shift in 0u32..64) {
            let value = value >> shift;
            let bucket = bucket_of(value);
            let last = last_of(bucket);
            prop_assert!(value <= last);
            prop_assert!(bucket == 0 || last_of(bucket - 1) < value);
            prop_assert!(last - value <= value / 8);
        }
    }

    #[test]
    fn quantiles_of_a_hundred_values() {
        let mut histogram = Histogram::EMPTY;
        for value in 1..=100 {
            histogram.record(value * 1000);
        }
        assert_eq!(histogram.count(), 100);
        assert_eq!(histogram.max(), 100_000);
        assert!((50_000..57_000).contains(&histogram.quantile(500)));
        assert!((99_000..=100_000).contains(&histogram.quantile(990)));
        assert_eq!(histogram.quantile(1000), 100_000);
    }

    #[test]
    fn merging_counts_both() {
        let mut one = Histogram::EMPTY;
        one.record(5);
        let mut other = Histogram::EMPTY;
        other.record(u64::MAX);
        one.merge(&other);
        assert_eq!(
            (one.count(), one.max(), one.quantile(500), one.quantile(1000)),
            (2, u64::MAX, 5, u64::MAX)
        );
    }

    #[test]
    fn nothing_counted_is_zero() {
        assert_eq!(Histogram::EMPTY.quantile(500), 0);
    }
}
