//! How many pages after a missed one are worth bringing with it.

use crate::prefetch::Account;

/// How many pages to bring along with one that was missed: those that follow it in address order.
///
/// The number follows what became of those before: it doubles when they were used, halves with each that was not, and
/// at 0 it stays there for a while, twice as long each time. What became of a page is known when it is used or leaves;
/// until then it is in doubt, and while too many are, none are brought.
///
/// # Invariants
/// Never more than `run_max`, and never more than [`IN_DOUBT_MAX`] and a run in doubt: so what is brought for nothing is
/// bounded before anything is known, and by the account after that.
#[derive(Clone, Debug)]
pub(crate) struct Neighbours {
    account: Account,
    run: u32,
    run_max: u32,
    /// Pages that were used since the run last changed.
    used: u32,
    /// Pages that were brought, and neither used nor gone yet.
    in_doubt: u32,
    /// Misses to go before one page is tried again; counts while the run is 0.
    pause: u32,
    /// How long the next pause is.
    next_pause: u32,
}

/// Pages in doubt beyond which none are brought.
const IN_DOUBT_MAX: u32 = 16;

/// Of the longest run, so often must a whole one be used before it doubles.
const USED_TO_DOUBLE: u32 = 4;

const PAUSE_MIN: u32 = 64;
const PAUSE_MAX: u32 = 1 << 16;

impl Neighbours {
    pub(crate) const fn new(run_max: u32) -> Self {
        let run = if run_max > 0 { 1 } else { 0 };
        Self { account: Account::new(), run, run_max, used: 0, in_doubt: 0, pause: 0, next_pause: PAUSE_MIN }
    }

    /// A page was missed: how many after it to bring along.
    pub(crate) fn run_after_miss(&mut self) -> u32 {
        if self.run_max == 0 || self.in_doubt >= IN_DOUBT_MAX || !self.account.allows() {
            return 0;
        }
        if self.run == 0 {
            self.pause = self.pause.saturating_sub(1);
            self.run = u32::from(self.pause == 0);
        }
        self.run
    }

    /// A page was brought along.
    pub(crate) fn asked(&mut self) {
        self.in_doubt += 1;
    }

    /// A page came that somebody waited for.
    pub(crate) fn fetched(&mut self) {
        self.account.used();
    }

    /// A page that was brought along was used.
    pub(crate) fn used(&mut self) {
        self.account.used();
        self.in_doubt = self.in_doubt.saturating_sub(1);
        self.used += 1;
        if self.used >= USED_TO_DOUBLE * self.run {
            self.used = 0;
            self.run = (2 * self.run).clamp(1, self.run_max);
            self.next_pause = PAUSE_MIN;
        }
    }

    /// A page that was brought along left without having been used.
    pub(crate) fn wasted(&mut self) {
        self.account.wasted();
        self.in_doubt = self.in_doubt.saturating_sub(1);
        self.used = 0;
        self.run /= 2;
        if self.run == 0 && self.pause == 0 {
            self.pause = self.next_pause;
            self.next_pause = (2 * self.next_pause).min(PAUSE_MAX);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Pages brought along with `misses` misses, of which these many in a hundred are used, known at once.
    fn brought(neighbours: &mut Neighbours, misses: u32, used_per_cent: u32) -> (u32, u32) {
        let (mut brought, mut wasted) = (0, 0);
        for _ in 0..misses {
            neighbours.fetched();
            for _ in 0..neighbours.run_after_miss() {
                neighbours.asked();
                brought += 1;
                // 61 is prime to 100: every remainder comes once.
                if brought * 61 % 100 < used_per_cent {
                    neighbours.used();
                } else {
                    neighbours.wasted();
                    wasted += 1;
                }
            }
        }
        (brought, wasted)
    }

    #[test]
    fn where_all_are_used_runs_grow_to_the_longest() {
        let mut neighbours = Neighbours::new(8);
        let _ = brought(&mut neighbours, 100, 100);
        assert_eq!(neighbours.run_after_miss(), 8);
    }

    #[test]
    fn where_none_are_used_it_turns_itself_off() {
        let mut neighbours = Neighbours::new(8);
        let (brought, wasted) = brought(&mut neighbours, 100_000, 0);
        assert!(brought == wasted && (2..20).contains(&brought), "{brought}");
    }

    #[test]
    fn it_comes_back_when_pages_are_used_again() {
        let mut neighbours = Neighbours::new(8);
        let _ = brought(&mut neighbours, 1_000, 0);
        assert_eq!(neighbours.run_after_miss(), 0);
        let _ = brought(&mut neighbours, 10_000, 100);
        assert_eq!(neighbours.run_after_miss(), 8);
    }

    #[test]
    fn pages_in_doubt_hold_it_back() {
        let mut neighbours = Neighbours::new(8);
        let mut brought = 0;
        for _ in 0..1000 {
            let run = neighbours.run_after_miss();
            (0..run).for_each(|_| neighbours.asked());
            brought += run;
        }
        assert_eq!(brought, IN_DOUBT_MAX);
    }

    #[test]
    fn none_allowed_are_none() {
        let mut neighbours = Neighbours::new(0);
        assert_eq!(brought(&mut neighbours, 1_000, 100), (0, 0));
    }

    proptest! {
        #[test]
        fn whatever_is_used_few_pages_come_for_nothing(
            run_max in 0u32..9, phases in prop::collection::vec((1u32..2_000, 0u32..101), 1..10),
        ) {
            let mut neighbours = Neighbours::new(run_max);
            let (mut moved, mut in_vain) = (0, 0);
            for (misses, used_per_cent) in phases {
                let (brought, wasted) = brought(&mut neighbours, misses, used_per_cent);
                (moved, in_vain) = (moved + misses + brought, in_vain + wasted);
                prop_assert!(neighbours.run_after_miss() <= run_max);
            }
            prop_assert!(in_vain <= moved / 60 + 4 + run_max, "{in_vain} of {moved}");
        }
    }
}
