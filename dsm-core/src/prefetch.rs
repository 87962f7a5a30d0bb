//! Whether it pays to bring pages before anybody touches them.

/// Keeps account of the pages that were moved: of 33, at most one may have come for nothing.
///
/// Every page that was used earns a little, every one that left unused costs much, and nothing is brought ahead while the
/// account is empty. So prefetch turns itself off where the last frame foretells little, and comes back by and by.
#[derive(Clone, Debug)]
pub(crate) struct Account {
    credit: u32,
}

/// What a page costs that was brought for nothing; a page that was used earns 1.
const WASTE_COST: u32 = 32;

/// So much can be saved up, and there is to start with.
const CREDIT_MAX: u32 = 256;

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
    fn of_thirty_three_pages_one_may_be_wasted_in_the_long_run() {
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
        assert!((31.0..35.0).contains(&share), "one in {share}");
    }

    #[test]
    fn what_is_used_is_never_held_back() {
        let mut account = Account::new();
        for _ in 0..1000 {
            assert!(account.allows());
            account.used();
        }
    }
}
