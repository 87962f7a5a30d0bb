//! Which kernel draws tiles.

use core::fmt;
use core::str::FromStr;

use crate::simd::{Lanes, LanesError};

/// How tiles are drawn. All ways give the same bytes; they differ in speed alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kernel {
    /// A tile at a time, as one beam; see [`Lanes`].
    Beams(Lanes),
    /// One ray after the other, which tests sixteen cells or triangles at once.
    Rays(Lanes),
}

impl Kernel {
    /// Beams with the widest lanes that this processor has. Asks the processor; keep the answer.
    pub fn fastest() -> Self {
        Self::Beams(Lanes::widest())
    }

    /// Rays with the widest lanes that this processor has. Asks the processor; keep the answer.
    pub fn rays() -> Self {
        Self::Rays(Lanes::widest())
    }

    /// All kernels that this processor can run, the fastest last.
    pub fn available() -> impl Iterator<Item = Self> {
        Lanes::available().map(Self::Rays).chain(Lanes::available().map(Self::Beams))
    }

    /// The name that [`FromStr`] takes: that of the lanes, with `rays-` before it for rays.
    pub fn name(self) -> &'static str {
        match self {
            Self::Beams(lanes) => lanes.name(),
            Self::Rays(lanes) => RAYS.into_iter().find(|name| name.ends_with(lanes.name())).unwrap_or("rays"),
        }
    }
}

/// Names of rays with each of the lanes.
const RAYS: [&str; 3] = ["rays-portable", "rays-avx2", "rays-avx512"];

/// Takes `portable`, `avx2` or `avx512` for beams, with `rays-` before it for rays; and `rays` for rays with the
/// widest lanes that there are.
impl FromStr for Kernel {
    type Err = LanesError;

    fn from_str(name: &str) -> Result<Self, LanesError> {
        match name.strip_prefix("rays") {
            Some("") => Ok(Self::rays()),
            Some(lanes) => lanes.strip_prefix('-').ok_or(LanesError::Unknown)?.parse().map(Self::Rays),
            None => name.parse().map(Self::Beams),
        }
    }
}

impl fmt::Display for Kernel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kernel_is_found_by_its_name() {
        for kernel in Kernel::available() {
            assert_eq!(kernel.name().parse(), Ok(kernel), "{kernel}");
        }
        assert_eq!("rays".parse(), Ok(Kernel::rays()));
        for name in ["rays-", "raysportable", "rays-avx1024", ""] {
            assert_eq!(name.parse::<Kernel>(), Err(LanesError::Unknown), "{name}");
        }
    }
}
