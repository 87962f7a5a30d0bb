//! Trying many seeds, and saying which one failed and how to see it again.

use core::any::Any;
use core::fmt;
use core::ops::Range;
use core::panic::AssertUnwindSafe;
use std::panic::catch_unwind;

/// A seed whose run broke a promise.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Counterexample {
    /// The seed. The same configuration with this seed fails again, at the same event.
    pub seed: u64,
    /// What the run said: the name of an invariant and the facts.
    pub what: String,
    /// Seeds that were run before it and held.
    pub held: u64,
}

/// Runs `run` with each seed, and stops at the first that panics or says what is wrong.
///
/// # Errors
/// The seed, and what its run said.
pub fn seeds(
    seeds: Range<u64>,
    mut run: impl FnMut(u64) -> Result<(), String>,
) -> Result<u64, Counterexample> {
    let first = seeds.start;
    for seed in seeds.clone() {
        let outcome = catch_unwind(AssertUnwindSafe(|| run(seed)));
        let what = match outcome {
            Ok(Ok(())) => continue,
            Ok(Err(what)) => what,
            Err(panic) => message_of(&*panic),
        };
        return Err(Counterexample { seed, what, held: seed - first });
    }
    Ok(seeds.end.saturating_sub(first))
}

/// What a panic said.
pub(crate) fn message_of(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic without words").to_owned()
}

impl fmt::Display for Counterexample {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { seed, what, held } = self;
        write!(f, "seed {seed} fails, after {held} that held: {what}")
    }
}

impl core::error::Error for Counterexample {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_seed_that_fails_is_told_whether_it_panics_or_says_so() {
        assert_eq!(seeds(3..9, |_| Ok(())), Ok(6));
        let says = seeds(3..9, |seed| if seed == 5 { Err("ouch".to_owned()) } else { Ok(()) });
        assert_eq!(says, Err(Counterexample { seed: 5, what: "ouch".to_owned(), held: 2 }));
        let panics = seeds(3..9, |seed| {
            assert!(seed < 4, "BOUNDED: {seed}");
            Ok(())
        });
        assert_eq!(panics.unwrap_err().to_string(), "seed 4 fails, after 1 that held: BOUNDED: 4");
    }
}
