//! The ways in which a page appears to its readers and leaves them.

mod segv;
mod soft;
mod uffd;

pub(crate) use segv::Segv;
pub use soft::Record;
pub(crate) use soft::Soft;
pub(crate) use uffd::Uffd;

use core::fmt;
use core::str::FromStr;

use dsm_core::id::{PageId, SlotId};
use dsm_core::replacement::ReferenceSource;
use dsm_core::transport::Body;

use crate::area::Area;
use crate::sys::Errno;

/// The backends by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BackendKind {
    /// userfaultfd: an absent page raises SIGBUS in the thread that reads it, and one call makes it appear whole.
    Uffd,
    /// SIGSEGV: absent pages are protected; a page is filled in a memory file and then mapped. The paper's way, made
    /// safe for many threads.
    Segv,
    /// A table in software that every access looks into; no signals, no memory management unit.
    Soft,
    /// Everything is mapped from the start and nothing ever leaves.
    Replicated,
}

/// A backend at work.
#[derive(Debug)]
pub(crate) enum Backend {
    Uffd(Uffd),
    Segv(Segv),
    Soft(Soft),
}

/// No backend has this name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownBackend;

impl Backend {
    /// Fills `slot` with `body` and makes `page` visible, whole.
    pub(crate) fn fill(&self, area: &Area, page: PageId, slot: SlotId, body: Body<'_>) -> Result<(), Errno> {
        if body.len() < area.page_bytes() {
            return Err(Errno(libc::EMSGSIZE));
        }
        match self {
            Self::Uffd(uffd) => uffd.fill(area, page, body),
            Self::Segv(segv) => segv.fill(area, page, slot, body),
            Self::Soft(soft) => soft.fill(page, slot, body),
        }
    }

    /// Takes `victims` away from their readers. At most [`EVICT_BATCH_MAX`](dsm_core::node::EVICT_BATCH_MAX).
    pub(crate) fn take_away(&self, area: &Area, victims: &[(PageId, SlotId)]) -> Result<(), Errno> {
        match self {
            Self::Uffd(uffd) => uffd.take_away(area, victims),
            Self::Segv(segv) => segv.take_away(area, victims),
            Self::Soft(soft) => soft.take_away(victims),
        }
    }

    /// Takes pages from their readers' sight and keeps their bytes. Only where [`reference`](Self::reference) says so.
    pub(crate) fn hide(&self, area: &Area, pages: &[(PageId, SlotId)]) -> Result<(), Errno> {
        match self {
            Self::Segv(segv) => segv.hide(area, pages),
            Self::Uffd(_) | Self::Soft(_) => Err(Errno(libc::ENOTSUP)),
        }
    }

    /// Brings a hidden page back.
    pub(crate) fn show(&self, area: &Area, page: PageId) -> Result<(), Errno> {
        match self {
            Self::Segv(segv) => segv.show(area, page),
            Self::Uffd(_) | Self::Soft(_) => Err(Errno(libc::ENOTSUP)),
        }
    }

    /// How many of `slot_count` slots may hold hidden pages, of the share in per cent that is wanted. `soft` sees its
    /// accesses and hides nothing.
    pub(crate) fn hidden_max(&self, wanted: ReferenceSource, slot_count: u32, per_cent: u32) -> u32 {
        match (self, wanted) {
            (Self::Segv(_), ReferenceSource::SoftFaults) => {
                let hidden = u64::from(slot_count) * u64::from(per_cent.min(100)) / 100;
                u32::try_from(hidden).unwrap_or(0).min(slot_count.saturating_sub(1))
            }
            _ => 0,
        }
    }

    /// Makes a page that cannot be had readable as zeros, so that the load that waits for it can end. It costs no
    /// memory and no slot.
    pub(crate) fn give_zeros(&self, area: &Area, page: PageId) -> Result<(), Errno> {
        match self {
            Self::Uffd(uffd) => uffd.give_zeros(area, page),
            Self::Segv(segv) => segv.give_zeros(area, page),
            // Nobody waits inside a load: the reader is told.
            Self::Soft(_) => Ok(()),
        }
    }

    /// What this backend can do of a source of reference bits.
    pub(crate) const fn reference(&self, wanted: ReferenceSource) -> ReferenceSource {
        match (self, wanted) {
            // To hide a page would split the one mapping that makes this backend fast, and costs with the way back
            // more than a page from another process of this machine; see bench/README.
            (Self::Uffd(_), ReferenceSource::SoftFaults) => ReferenceSource::Hints,
            _ => wanted,
        }
    }

    pub(crate) const fn kind(&self) -> BackendKind {
        match self {
            Self::Uffd(_) => BackendKind::Uffd,
            Self::Segv(_) => BackendKind::Segv,
            Self::Soft(_) => BackendKind::Soft,
        }
    }
}

impl BackendKind {
    /// All backends, in the order in which they are preferred; `replicated` only by name.
    pub const ALL: [Self; 4] = [Self::Uffd, Self::Segv, Self::Soft, Self::Replicated];

    /// The backend's name, as the command line and the reports spell it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Uffd => "uffd",
            Self::Segv => "segv",
            Self::Soft => "soft",
            Self::Replicated => "replicated",
        }
    }
}

impl FromStr for BackendKind {
    type Err = UnknownBackend;

    fn from_str(name: &str) -> Result<Self, UnknownBackend> {
        Self::ALL.into_iter().find(|kind| kind.name() == name).ok_or(UnknownBackend)
    }
}

impl fmt::Display for BackendKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl fmt::Display for UnknownBackend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("no backend has this name; there are uffd, segv, soft and replicated")
    }
}

impl core::error::Error for UnknownBackend {}
