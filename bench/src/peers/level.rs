//! Which vectors a program may use.

/// The widest vectors that a program may use; wider ones are greater.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Level {
    /// Whatever every processor of this architecture has.
    Portable,
    Avx2,
    Avx512,
}

impl Level {
    /// The levels that are compared here, the widest first.
    pub(crate) fn compared() -> Vec<Self> {
        let here: Vec<Self> =
            [Self::Avx512, Self::Avx2].into_iter().filter(|level| level.is_here()).collect();
        if here.is_empty() { vec![Self::Portable] } else { here }
    }

    /// Whether this machine has it.
    pub(crate) fn is_here(self) -> bool {
        match self {
            Self::Portable => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => is_x86_feature_detected!("avx2"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512vl"),
            #[cfg(not(target_arch = "x86_64"))]
            Self::Avx2 | Self::Avx512 => false,
        }
    }

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            Self::Avx2 => "AVX2",
            Self::Avx512 => "AVX-512",
        }
    }

    /// What Embree is configured with; by itself it takes the widest it finds.
    pub(crate) const fn configuration(self) -> &'static str {
        match self {
            Self::Portable | Self::Avx512 => "verbose=0",
            Self::Avx2 => "isa=avx2",
        }
    }
}
