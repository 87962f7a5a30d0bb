//! Where reference bits come from.

use core::fmt;
use core::str::FromStr;

/// How a policy learns which resident pages are used, though reading one is a plain load.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ReferenceSource {
    /// It does not.
    Nothing,
    /// Who reads says at the end of each tile which pages the tile has used.
    Hints,
    /// A page is hidden before it is evicted, and a touch brings it back.
    SoftFaults,
}

/// No source has this name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownSource;

impl ReferenceSource {
    /// All sources.
    pub const ALL: [Self; 3] = [Self::Nothing, Self::Hints, Self::SoftFaults];

    /// The source's name, as the command line and the reports spell it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Nothing => "none",
            Self::Hints => "hints",
            Self::SoftFaults => "soft-faults",
        }
    }
}

impl FromStr for ReferenceSource {
    type Err = UnknownSource;

    fn from_str(name: &str) -> Result<Self, UnknownSource> {
        Self::ALL.into_iter().find(|source| source.name() == name).ok_or(UnknownSource)
    }
}

impl fmt::Display for ReferenceSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl fmt::Display for UnknownSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("no source of reference bits has this name; there are none, hints and soft-faults")
    }
}

impl core::error::Error for UnknownSource {}
