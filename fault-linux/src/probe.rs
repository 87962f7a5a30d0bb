//! Choosing a backend: by name, or the best one that this system does not refuse.

use core::fmt;
use std::io;

use crate::area::Area;
use crate::backend::{Backend, BackendKind, Segv, Soft, Uffd};
use crate::sys::Errno;

/// The backend that was chosen, and which others were not and why. For the log and the run report.
#[derive(Clone, Debug)]
pub struct Choice {
    /// The backend in use.
    pub used: BackendKind,
    /// Backends that were tried first.
    pub declined: Vec<Declined>,
    /// Slots asked for and not given, because this backend cannot hold so many pages on this system.
    pub slots_withheld: u32,
}

/// A backend that was tried and cannot be used here.
#[derive(Clone, Debug)]
pub struct Declined {
    /// The backend.
    pub backend: BackendKind,
    /// What the system said.
    pub why: Errno,
}

/// What a backend has to hold.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Demand {
    pub(crate) page_count: u32,
    pub(crate) page_bytes: usize,
    pub(crate) slot_count: u32,
    pub(crate) home_stripes: usize,
    pub(crate) watches_touches: bool,
}

/// A backend ready for use, with the area it works on.
#[derive(Debug)]
pub(crate) struct Probed {
    pub(crate) area: Area,
    pub(crate) backend: Backend,
    pub(crate) slot_count: u32,
    pub(crate) choice: Choice,
}

/// Why no backend could be had.
#[derive(Debug)]
pub(crate) struct AllDeclined(pub(crate) Vec<Declined>);

/// Sets up `wanted`, or with `None` the first that works: `uffd`, `segv`, `soft`.
pub(crate) fn probe(wanted: Option<BackendKind>, demand: Demand) -> Result<Probed, AllDeclined> {
    let candidates = [BackendKind::Uffd, BackendKind::Segv, BackendKind::Soft];
    let mut declined = Vec::new();
    for used in candidates.into_iter().filter(|kind| wanted.is_none_or(|wanted| wanted == *kind)) {
        match set_up(used, demand) {
            Ok((area, backend, slot_count)) => {
                let slots_withheld = demand.slot_count - slot_count;
                let choice = Choice { used, declined, slots_withheld };
                return Ok(Probed { area, backend, slot_count, choice });
            }
            Err(why) => declined.push(Declined { backend: used, why }),
        }
    }
    Err(AllDeclined(declined))
}

fn set_up(kind: BackendKind, demand: Demand) -> Result<(Area, Backend, u32), Errno> {
    let Demand { page_count, page_bytes, slot_count, home_stripes, watches_touches } = demand;
    match kind {
        BackendKind::Uffd => {
            let area = Area::reserve(page_count, page_bytes, libc::PROT_READ)?;
            let backend = Uffd::new(&area)?;
            Ok((area, Backend::Uffd(backend), slot_count))
        }
        BackendKind::Segv => {
            let allowed = Segv::slots_allowed(home_stripes).map_err(errno_of)?;
            let slot_count = slot_count.min(allowed);
            let area = Area::reserve(page_count, page_bytes, libc::PROT_NONE)?;
            let backend = Segv::new(&area, slot_count)?;
            Ok((area, Backend::Segv(backend), slot_count))
        }
        BackendKind::Soft => {
            let area = Area::reserve(page_count, page_bytes, libc::PROT_NONE)?;
            let backend = Soft::new(page_count, slot_count, page_bytes, watches_touches)?;
            Ok((area, Backend::Soft(backend), slot_count))
        }
        BackendKind::Replicated => Err(Errno(libc::EINVAL)),
    }
}

fn errno_of(error: io::Error) -> Errno {
    Errno(error.raw_os_error().unwrap_or(libc::EIO))
}

impl fmt::Display for Declined {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.backend, self.why)
    }
}

impl fmt::Display for Choice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.used)?;
        for declined in &self.declined {
            write!(f, "; not {declined}")?;
        }
        if self.slots_withheld > 0 {
            write!(f, "; {} slots withheld: the system allows no more mappings", self.slots_withheld)?;
        }
        Ok(())
    }
}

impl fmt::Display for AllDeclined {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "no backend can be used here")?;
        self.0.iter().try_for_each(|declined| write!(f, "; {declined}"))
    }
}
