//! Time as an argument: microseconds of a clock that the caller keeps.

/// A moment, in microseconds since some start that the driver chose.
///
/// The core never asks what time it is. It compares moments it was given and adds to them; both saturate, so a
/// clock that jumps backwards makes a wait longer and nothing worse.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Instant(u64);

impl Instant {
    /// The first moment there is.
    pub const ZERO: Self = Self(0);

    /// The moment `micros` after the clock's start.
    #[inline]
    #[must_use]
    pub const fn from_micros(micros: u64) -> Self {
        Self(micros)
    }

    /// Microseconds since the clock's start.
    #[inline]
    #[must_use]
    pub const fn as_micros(self) -> u64 {
        self.0
    }

    /// The moment `micros` later, or the last one there is.
    #[inline]
    #[must_use]
    pub const fn after(self, micros: u64) -> Self {
        Self(self.0.saturating_add(micros))
    }

    /// What of this moment fits a message: its microseconds, without those above 32 bits.
    #[inline]
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "it wraps")]
    pub(crate) const fn stamp(self) -> u32 {
        self.0 as u32
    }

    /// Microseconds since the last moment that has this stamp: 71 minutes at most.
    #[inline]
    #[must_use]
    pub(crate) const fn since_stamp(self, stamp: u32) -> u64 {
        self.stamp().wrapping_sub(stamp) as u64
    }

    /// Microseconds from `earlier` to this moment, 0 when `earlier` is later.
    #[inline]
    #[must_use]
    pub const fn since(self, earlier: Self) -> u64 {
        self.0.saturating_sub(earlier.0)
    }
}

/// Turns the caller's clock, which may jump, into one that never goes back.
///
/// # Edge cases
/// A clock that jumps backwards, by however much, stands still for one step and goes on from there: no timer waits
/// longer than it would have. A jump forwards cannot be told from time that has passed, and counts as that.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub(crate) struct SteadyClock {
    /// The caller's time at the last input.
    seen: Instant,
    /// Our own at that input.
    steady: Instant,
}

impl SteadyClock {
    /// Our own time at an input to which the caller has given the time `now`.
    pub(crate) fn advance(&mut self, now: Instant) -> Instant {
        self.steady = self.steady.after(now.since(self.seen));
        self.seen = now;
        self.steady
    }

    /// The caller's time at which ours was or will be `moment`, unless its clock jumps.
    pub(crate) fn outside(&self, moment: Instant) -> Instant {
        let before = self.steady.since(moment);
        Instant(self.seen.after(moment.since(self.steady)).0.saturating_sub(before))
    }
}

#[cfg(test)]
mod tests {
    use super::{Instant, SteadyClock};

    #[test]
    fn a_steady_clock_goes_on_where_it_was_when_its_source_jumps_back() {
        let at = Instant::from_micros;
        let mut clock = SteadyClock::default();
        assert_eq!(clock.advance(at(1_000_000)), at(1_000_000));
        assert_eq!(clock.advance(at(10)), at(1_000_000));
        assert_eq!(clock.outside(at(1_000_005)), at(15));
        assert_eq!(clock.advance(at(15)), at(1_000_005));
        assert_eq!([1_000_001, 3].map(|moment| clock.outside(at(moment))), [at(11), at(0)]);
        assert_eq!(clock.advance(at(u64::MAX)), at(u64::MAX));
    }

    #[test]
    fn a_stamp_tells_how_long_ago_it_was_made_across_the_wrap() {
        let made = Instant::from_micros((7 << 32) - 5);
        assert_eq!(made.after(12).since_stamp(made.stamp()), 12);
        assert_eq!(made.since_stamp(made.stamp()), 0);
    }

    #[test]
    fn a_clock_that_jumps_back_gives_zero() {
        assert_eq!(Instant::from_micros(5).since(Instant::from_micros(9)), 0);
    }

    #[test]
    fn the_last_moment_has_no_successor() {
        let last = Instant::from_micros(u64::MAX);
        assert_eq!(last.after(1), last);
    }
}
