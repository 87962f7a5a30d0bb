//! Virtual time: nanoseconds since the world began.

use core::fmt;

/// A moment of virtual time, the same for the whole cluster.
///
/// Nodes do not see it. Each has a clock of its own, in microseconds, that may be wrong and may jump.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Moment(u64);

impl Moment {
    /// When the world begins.
    pub const ZERO: Self = Self(0);

    /// After the end of every run.
    pub const NEVER: Self = Self(u64::MAX);

    /// The moment so many nanoseconds after the beginning.
    #[must_use]
    pub const fn from_ns(ns: u64) -> Self {
        Self(ns)
    }

    /// Nanoseconds since the beginning.
    #[must_use]
    pub const fn as_ns(self) -> u64 {
        self.0
    }

    /// The moment so much later, at most [`NEVER`](Self::NEVER).
    #[must_use]
    pub const fn after(self, ns: u64) -> Self {
        Self(self.0.saturating_add(ns))
    }

    /// Nanoseconds since `earlier`, 0 when that is later.
    #[must_use]
    pub const fn since(self, earlier: Self) -> u64 {
        self.0.saturating_sub(earlier.0)
    }
}

/// Nanoseconds of so many microseconds.
#[must_use]
pub const fn us(micros: u64) -> u64 {
    micros.saturating_mul(1_000)
}

/// Nanoseconds of so many milliseconds.
#[must_use]
pub const fn ms(millis: u64) -> u64 {
    millis.saturating_mul(1_000_000)
}

impl fmt::Display for Moment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{:06} ms", self.0 / 1_000_000, self.0 % 1_000_000)
    }
}
