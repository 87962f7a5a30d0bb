//! Chance, from a seed. Integers only, so that every machine throws the same.

use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro128PlusPlus;

/// A stream of random numbers.
///
/// Who needs chance has a stream of its own, so that one throw more in one place moves nothing in another: two runs
/// of the same seed with different protocols have the same links and the same workload.
#[derive(Clone, Debug)]
pub struct Chance(Xoshiro128PlusPlus);

impl Chance {
    /// The stream with this number, of all the streams of a seed.
    #[must_use]
    pub fn new(seed: u64, stream: u64) -> Self {
        Self(Xoshiro128PlusPlus::seed_from_u64(mix(seed ^ mix(stream))))
    }

    /// Any number.
    pub fn number(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// A number in `0..bound`, each with about the same chance; 0 when `bound` is.
    pub fn below(&mut self, bound: u64) -> u64 {
        // Multiply and shift; the bias is below 2^-64 * bound.
        let product = u128::from(self.number()) * u128::from(bound);
        u64::try_from(product >> 64).unwrap_or(0)
    }

    /// Whether something happens that happens so many times in a million.
    pub fn happens(&mut self, per_million: u32) -> bool {
        per_million > 0 && self.below(1_000_000) < u64::from(per_million)
    }

    /// A number with this mean that is mostly smaller and now and then much larger: falls by half every 0.67 means.
    ///
    /// `-log2` of a uniform number, its curve between two powers of two replaced by a line: no float, no library.
    pub fn tail(&mut self, mean: u64) -> u64 {
        let number = self.number() | 1;
        let zeros = number.leading_zeros();
        // The bits behind the leading one are the way from one power of two to the next, in 2^-32.
        let fraction = ((number << zeros) << 1) >> 32;
        let log = ((u64::from(zeros) + 1) << 32) - fraction;
        // The mean of `log` is 1.5 * 2^32.
        let scaled = u128::from(log) * u128::from(mean) * 2 / (3 << 32);
        u64::try_from(scaled).unwrap_or(u64::MAX)
    }
}

/// Mixes all bits of a number with each other; nothing is lost, and what comes out looks random.
///
/// # Source
/// The finisher of SplitMix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators", 2014).
#[must_use]
pub const fn mix(number: u64) -> u64 {
    let number = number.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let number = (number ^ (number >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let number = (number ^ (number >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    number ^ (number >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_seed_and_stream_throw_the_same_and_others_do_not() {
        let throw = |seed, stream| Chance::new(seed, stream).number();
        assert_eq!(throw(1, 2), throw(1, 2));
        assert_ne!(throw(1, 2), throw(2, 1));
        assert_ne!(throw(1, 2), throw(1, 3));
    }

    #[test]
    fn a_hundred_thousand_in_a_million_is_one_in_ten() {
        let mut chance = Chance::new(7, 0);
        let count = (0..100_000).filter(|_| chance.happens(100_000)).count();
        assert!((9_600..10_400).contains(&count), "{count}");
        assert!(!chance.happens(0) && chance.happens(1_000_000));
    }

    #[test]
    fn a_tail_has_its_mean_and_is_mostly_below_it() {
        let mut chance = Chance::new(7, 0);
        let throws: Vec<u64> = (0..100_000).map(|_| chance.tail(1_000)).collect();
        let mean = throws.iter().sum::<u64>() / 100_000;
        assert!((980..1_020).contains(&mean), "{mean}");
        let above = throws.iter().filter(|throw| **throw > 3_000).count();
        assert!((3_500..6_000).contains(&above), "e^-3 of them are 5,000: {above}");
    }

    #[test]
    fn numbers_stay_below_their_bound() {
        let mut chance = Chance::new(3, 3);
        assert!((0..1_000).all(|_| chance.below(3) < 3));
        assert_eq!(chance.below(0), 0);
    }
}
