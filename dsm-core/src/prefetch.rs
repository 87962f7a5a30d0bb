//! Whether it pays to bring pages before anybody touches them.

use crate::neighbours::Neighbours;

/// What foretold a page that is brought before anybody touches it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Foretold {
    /// The tile about to be drawn touched it in the last frame.
    ByTile,
    /// It follows, in address order, a page that was missed.
    ByNeighbour,
}

/// What is known of how prefetch has paid so far, for either way to foretell apart: neither can starve the other.
#[derive(Clone, Debug)]
pub(crate) struct Prefetch {
    tiles: Account,
    neighbours: Neighbours,
}

/// Keeps account of the pages that were moved: of 65, at most one may have come for nothing.
///
/// Every page that was used earns a little, every one that left unused costs much, and nothing is brought ahead while the
/// account has nothing to spend. What is known of late, of many pages at once, makes debts. So prefetch turns itself off where the last frame foretells little, and comes back by and by. A page
/// that came for nothing has often taken the slot of one that is fetched again for it, so it costs two.
#[derive(Clone, Debug)]
pub(crate) struct Account {
    credit: i32,
}

/// What a page costs that was brought for nothing; a page that was used earns 1.
const WASTE_COST: i32 = 64;

/// So much can be saved up, and there is to start with.
const CREDIT_MAX: i32 = 4 * WASTE_COST;

impl Prefetch {
    /// May ask for up to `run_max` pages after one that was missed.
    pub(crate) const fn new(run_max: u32) -> Self {
        Self { tiles: Account::new(), neighbours: Neighbours::new(run_max) }
    }

    /// Whether the pages of tiles may be brought ahead.
    pub(crate) const fn allows_tiles(&self) -> bool {
        self.tiles.allows()
    }

    /// A page was missed: how many after it to bring along.
    pub(crate) fn run_after_miss(&mut self) -> u32 {
        self.neighbours.run_after_miss()
    }

    /// A page came that somebody waited for.
    pub(crate) fn fetched(&mut self) {
        self.tiles.used();
        self.neighbours.fetched();
    }

    /// A page was asked for ahead.
    pub(crate) fn asked(&mut self, foretold: Foretold) {
        match foretold {
            Foretold::ByTile => {}
            Foretold::ByNeighbour => self.neighbours.asked(),
        }
    }

    /// A page that was brought ahead was used.
    pub(crate) fn used(&mut self, foretold: Foretold) {
        match foretold {
            Foretold::ByTile => self.tiles.used(),
            Foretold::ByNeighbour => self.neighbours.used(),
        }
    }

    /// A page that was brought ahead left without having been used.
    pub(crate) fn wasted(&mut self, foretold: Foretold) {
        match foretold {
            Foretold::ByTile => self.tiles.wasted(),
            Foretold::ByNeighbour => self.neighbours.wasted(),
        }
    }
}

impl Account {
    pub(crate) const fn new() -> Self {
        Self { credit: CREDIT_MAX }
    }

    /// Whether pages may be brought ahead.
    pub(crate) const fn allows(&self) -> bool {
        self.credit >= WASTE_COST
    }

    /// A page that was moved was used.
    pub(crate) const fn used(&mut self) {
        if self.credit < CREDIT_MAX {
            self.credit += 1;
        }
    }

    /// A page that was brought ahead left without having been used.
    pub(crate) const fn wasted(&mut self) {
        self.credit = self.credit.saturating_sub(WASTE_COST);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_sixty_five_pages_one_may_be_wasted_in_the_long_run() {
        let mut account = Account::new();
        let (mut used, mut wasted) = (0, 0);
        for step in 0..100_000 {
            // Half of what is brought ahead is wasted; else pages are fetched, and used.
            if account.allows() && step % 2 == 0 {
                account.wasted();
                wasted += 1;
            } else {
                account.used();
                used += 1;
            }
        }
        let share = f64::from(used + wasted) / f64::from(wasted);
        assert!((62.0..68.0).contains(&share), "one in {share}");
    }

    #[test]
    fn what_many_pages_cost_that_are_known_at_once_is_owed() {
        let mut account = Account::new();
        (0..100).for_each(|_| account.wasted());
        (0..96 * 64).for_each(|_| account.used());
        assert!(!account.allows());
        (0..64).for_each(|_| account.used());
        assert!(account.allows());
    }

    #[test]
    fn what_is_used_is_never_held_back() {
        let mut account = Account::new();
        for _ in 0..1000 {
            assert!(account.allows());
            account.used();
        }
    }

    #[test]
    fn one_way_to_foretell_that_fails_leaves_the_other_alone() {
        let mut prefetch = Prefetch::new(4);
        (0..100).for_each(|_| prefetch.wasted(Foretold::ByNeighbour));
        assert!(prefetch.allows_tiles() && prefetch.run_after_miss() == 0);
        let mut prefetch = Prefetch::new(4);
        (0..100).for_each(|_| prefetch.wasted(Foretold::ByTile));
        assert!(!prefetch.allows_tiles() && prefetch.run_after_miss() == 1);
    }
}
