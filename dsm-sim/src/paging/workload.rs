//! Which pages threads touch.

use dsm_core::id::PageId;

use crate::chance::{Chance, mix};

/// Which pages the threads of the rendering nodes touch.
#[derive(Clone, Debug, PartialEq)]
pub enum Workload {
    /// Any page, each with the same chance.
    Uniform,
    /// The page of rank `r` with a chance proportional to `1 / r^exponent`. All threads agree on the ranks, and these
    /// are scattered over the address space.
    Zipf {
        /// 0 is uniform, 1 is what one finds in many places; at most 16.
        exponent: f64,
    },
    /// Any page of a window that moves on through the address space and around. Each thread has its own, and they
    /// start at equal distances.
    Window {
        /// Pages in the window.
        pages: u32,
        /// Touches after which it moves on by one page.
        touches_a_page: u32,
    },
    /// These pages, one list after the other for each thread and from the beginning for more threads; a list that
    /// has ended begins again.
    Trace(Vec<Vec<PageId>>),
}

/// A workload made ready for an address space and so many threads.
#[derive(Debug)]
pub(super) struct Pattern {
    workload: Workload,
    page_count: u32,
    thread_count: u32,
    /// Pages from one rank to the next.
    rank_step: u64,
    /// For `Zipf`: the chance of a rank up to this one, in 2^-64.
    up_to_rank: Vec<u64>,
}

impl Pattern {
    pub(super) fn new(workload: Workload, page_count: u32, thread_count: u32) -> Self {
        let up_to_rank = match workload {
            Workload::Zipf { exponent } => sums(page_count, exponent),
            _ => Vec::new(),
        };
        let rank_step = scattering_step(page_count.into());
        Self { workload, page_count, thread_count: thread_count.max(1), rank_step, up_to_rank }
    }

    /// The page that a thread, counted over the whole cluster, touches next; `touch` counts its touches so far.
    pub(super) fn page(&self, thread: u32, touch: u32, chance: &mut Chance) -> PageId {
        let count = u64::from(self.page_count);
        let page = match &self.workload {
            Workload::Uniform => chance.below(count),
            Workload::Zipf { .. } => {
                let number = chance.number();
                self.scatter(self.up_to_rank.partition_point(|sum| *sum < number))
            }
            Workload::Window { pages, touches_a_page } => {
                let start = u64::from(thread) * count / u64::from(self.thread_count);
                let moved = u64::from(touch / (*touches_a_page).max(1));
                (start + moved + chance.below(u64::from(*pages))) % count
            }
            Workload::Trace(lists) => {
                let list = &lists[thread as usize % lists.len()];
                return list[touch as usize % list.len()];
            }
        };
        PageId(u32::try_from(page).unwrap_or(0))
    }

    /// The page of a rank.
    fn scatter(&self, rank: usize) -> u64 {
        let count = u64::from(self.page_count);
        (rank as u64 % count) * self.rank_step % count
    }
}

/// The contents that a page has in every simulation: a number that stands for its bytes.
pub(super) const fn contents_of(page: PageId) -> u64 {
    mix(page.0 as u64 ^ 0x5CE9_E000_0000_0000)
}

/// Sums of `1 / r^exponent` up to each rank, scaled so that the last is 2^64 - 1.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "in 0..2^64; more saturates")]
fn sums(page_count: u32, exponent: f64) -> Vec<u64> {
    let weight = |rank: u32| 1.0 / power(f64::from(rank), exponent);
    let whole: f64 = (1..=page_count).map(weight).sum();
    let mut sum = 0.0;
    let scaled = (1..=page_count).map(|rank| {
        sum += weight(rank);
        (sum / whole * u64::MAX as f64) as u64
    });
    let mut sums: Vec<u64> = scaled.collect();
    if let Some(last) = sums.last_mut() {
        *last = u64::MAX;
    }
    sums
}

/// `base` to a power in `0..=EXPONENT_MAX`, by multiplications and square roots alone: these are rounded in one way
/// everywhere, so that every machine has the same workload.
fn power(base: f64, exponent: f64) -> f64 {
    let (mut power, mut root, mut rest) = (1.0, base, exponent);
    while rest >= 1.0 {
        power *= base;
        rest -= 1.0;
    }
    while rest > 0.0 {
        (root, rest) = (root.sqrt(), rest * 2.0);
        if rest >= 1.0 {
            power *= root;
            rest -= 1.0;
        }
    }
    power
}

/// The steepest Zipf workload there can be; all of it falls on one page.
pub(super) const EXPONENT_MAX: f64 = 16.0;

/// About the golden section of `count`, such that steps of it visit every number below once.
const fn scattering_step(count: u64) -> u64 {
    let mut step = count * 618 / 1000 + 1;
    while greatest_common_divisor(step, count) > 1 {
        step += 1;
    }
    step
}

const fn greatest_common_divisor(mut a: u64, mut b: u64) -> u64 {
    while b > 0 {
        (a, b) = (b, a % b);
    }
    a
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(workload: Workload, touches: u32) -> Vec<u32> {
        let pattern = Pattern::new(workload, 100, 4);
        let (mut chance, mut counts) = (Chance::new(1, 0), vec![0; 100]);
        for touch in 0..touches {
            counts[pattern.page(1, touch, &mut chance).index()] += 1;
        }
        counts
    }

    #[test]
    fn uniform_touches_each_page_about_equally() {
        assert!(counts(Workload::Uniform, 100_000).into_iter().all(|count| (850..1_150).contains(&count)));
    }

    #[test]
    fn zipf_follows_its_law_and_reaches_every_page() {
        let mut counts = counts(Workload::Zipf { exponent: 1.0 }, 1_000_000);
        counts.sort_unstable_by_key(|count| core::cmp::Reverse(*count));
        let harmonic: f64 = (1..=100).map(|rank| 1.0 / f64::from(rank)).sum();
        for rank in [1, 2, 10, 50] {
            let expected = 1e6 / harmonic / rank as f64;
            let ratio = f64::from(counts[rank - 1]) / expected;
            assert!((0.9..1.1).contains(&ratio), "rank {rank}: {ratio}");
        }
        assert!(counts[99] > 0);
    }

    #[test]
    fn powers_are_powers() {
        for (base, exponent) in [(2.0, 0.5), (10.0, 3.0), (7.0, 0.0), (1e6, 1.25), (3.0, 0.7), (5.0, 16.0)] {
            let ratio = power(base, exponent) / base.powf(exponent);
            assert!((ratio - 1.0).abs() < 1e-12, "{base} to {exponent}: {ratio}");
        }
    }

    #[test]
    fn a_window_moves_on_from_where_its_thread_starts() {
        let pattern = Pattern::new(Workload::Window { pages: 5, touches_a_page: 10 }, 100, 4);
        let mut chance = Chance::new(1, 0);
        for touch in 0..2_000 {
            let ahead = (pattern.page(1, touch, &mut chance).0 + 100 - (25 + touch / 10) % 100) % 100;
            assert!(ahead < 5, "{ahead} at {touch}");
        }
    }

    #[test]
    fn a_trace_is_followed_and_begins_again() {
        let lists = vec![vec![PageId(1)], vec![PageId(2), PageId(3)]];
        let pattern = Pattern::new(Workload::Trace(lists), 100, 4);
        let mut chance = Chance::new(1, 0);
        let pages = [0, 1, 2].map(|touch| pattern.page(3, touch, &mut chance).0);
        assert_eq!(pages, [2, 3, 2]);
    }

    #[test]
    fn ranks_are_scattered_over_all_pages() {
        for count in [1, 2, 7, 100, 4096] {
            let pattern = Pattern::new(Workload::Uniform, count, 1);
            let mut pages: Vec<u64> = (0..count as usize).map(|rank| pattern.scatter(rank)).collect();
            pages.sort_unstable();
            assert!(pages.into_iter().eq(0..u64::from(count)));
        }
    }
}
