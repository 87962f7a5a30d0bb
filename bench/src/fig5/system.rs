//! How a node comes to the data that a ray needs.

use core::num::NonZeroU16;
use core::time::Duration;
use std::path::Path;

use fault_linux::BackendKind;
use memsavvy::run::{Options, Source};
use memsavvy::session::Session;
use memsavvy::size::{Memory, PictureSize};
use rt_core::{Kernel, Lanes};

use super::{MEMORY, NODES, STORES};

/// A way to share a volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum System {
    /// Every node has all of it: the baseline.
    Replicated,
    /// Pages come when the memory hardware misses them.
    Uffd,
    /// The same by another of the system's means, the paper's.
    Segv,
    /// A look into a table for every record that is read; beams read one for hundreds of rays.
    Objects,
    /// Pages, with rays that come one by one.
    UffdByRays,
    /// The paper's object-based sharing: each ray looks up every record that it reads.
    ObjectsByRays,
}

impl System {
    /// The baseline first.
    pub(super) const ALL: [Self; 6] =
        [Self::Replicated, Self::Uffd, Self::Segv, Self::Objects, Self::UffdByRays, Self::ObjectsByRays];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Replicated => "replicated",
            Self::Uffd => "paged, uffd",
            Self::Segv => "paged, segv",
            Self::Objects => "objects, soft",
            Self::UffdByRays => "paged, uffd, ray by ray",
            Self::ObjectsByRays => "objects, soft, ray by ray",
        }
    }

    const fn backend(self) -> BackendKind {
        match self {
            Self::Replicated => BackendKind::Replicated,
            Self::Uffd | Self::UffdByRays => BackendKind::Uffd,
            Self::Segv => BackendKind::Segv,
            Self::Objects | Self::ObjectsByRays => BackendKind::Soft,
        }
    }

    /// `None` is the fastest.
    fn kernel(self) -> Option<Kernel> {
        matches!(self, Self::UffdByRays | Self::ObjectsByRays).then(|| Kernel::Rays(Lanes::widest()))
    }

    /// A run of a session on the image of a file.
    pub(super) fn options(self, image: &Path, session: &Session, size: u32) -> Options {
        let has_all = self == Self::Replicated;
        Options {
            source: Source::Path(image.to_owned()),
            nodes: NODES,
            stores: if has_all { 0 } else { STORES },
            threads: Some(NonZeroU16::MIN),
            memory: (!has_all).then_some(Memory::Share(MEMORY)),
            backend: Some(self.backend()),
            kernel: self.kernel(),
            size: PictureSize { width: size, height: size },
            session: session.clone(),
            deadline: Duration::from_secs(60),
            quiet: true,
            ..Options::default()
        }
    }
}
