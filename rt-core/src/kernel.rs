//! Which kernel draws tiles.

use core::fmt;
use core::str::FromStr;

use crate::simd::{Lanes, LanesError};

/// How tiles are drawn. All ways give the same bytes; they differ in speed alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kernel {
    /// A tile at a time, as one beam; see [`Lanes`].
    Beams(Lanes),
    /// One ray after the other: the plain way, and the oracle.
    Rays,
}

impl Kernel {
    /// Beams with the widest lanes that this processor has. Asks the processor; keep the answer.
    pub fn fastest() -> Self {
        Self::Beams(Lanes::widest())
    }

    /// All kernels that this processor can run, the fastest last.
    pub fn available() -> impl Iterator<Item = Self> {
        core::iter::once(Self::Rays).chain(Lanes::available().map(Self::Beams))
    }

    /// The name that [`FromStr`] takes: `rays`, or that of the lanes.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Beams(lanes) => lanes.name(),
            Self::Rays => "rays",
        }
    }
}

/// Takes `rays`, `portable`, `avx2` or `avx512`.
impl FromStr for Kernel {
    type Err = LanesError;

    fn from_str(name: &str) -> Result<Self, LanesError> {
        if name == "rays" { Ok(Self::Rays) } else { name.parse().map(Self::Beams) }
    }
}

impl fmt::Display for Kernel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
