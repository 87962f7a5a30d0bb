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

    /// Microseconds from `earlier` to this moment, 0 when `earlier` is later.
    #[inline]
    #[must_use]
    pub const fn since(self, earlier: Self) -> u64 {
        self.0.saturating_sub(earlier.0)
    }
}

#[cfg(test)]
mod tests {
    use super::Instant;

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
