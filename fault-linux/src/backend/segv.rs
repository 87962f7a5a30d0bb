//! `segv`: pages are filled in a memory file of slots, then mapped over the protected range; the paper's way, made
//! safe for many threads.
//!
//! The paper makes an empty page appear and then receives into it, so that a second thread can read it half filled.
//! Here a slot is written through the file, where no reader can see it, and one `mmap` puts it in place.
//!
//! Slots are never given back to the kernel: allocating shared memory anew for every miss costs more than the miss.
//! They are written with `pwrite`, not through a mapping of their own: then the pages that are resident in this
//! process are exactly those its readers see, and no stray pointer can change a slot.

use std::os::fd::{AsFd, OwnedFd};

use dsm_core::id::{PageId, SlotId};
use dsm_core::transport::Body;

use crate::area::Area;
use crate::sys::{self, Errno};

#[derive(Debug)]
pub(crate) struct Segv {
    slots: OwnedFd,
}

/// What one resident page can cost in mappings: itself, and the gap behind it.
const MAPPINGS_PER_PAGE: usize = 2;

/// Mappings left to the rest of the process: at the limit threads cannot start and large allocations fail.
const MAPPINGS_RESERVED: usize = 1024;

impl Segv {
    /// Makes a file for `slot_count` slots. Its memory is taken slot by slot, when they are first filled.
    pub(crate) fn new(area: &Area, slot_count: u32) -> Result<Self, Errno> {
        let bytes = (slot_count as usize).checked_mul(area.page_bytes()).ok_or(Errno(libc::EFBIG))?;
        Ok(Self { slots: sys::memory_file(bytes)? })
    }

    /// Slots that the kernel's limit on mappings allows, given what `home_stripes` of this node's own take.
    ///
    /// Beyond the limit not only filling fails, but evicting too: a page cut out of a mapping makes two.
    pub(crate) fn slots_allowed(home_stripes: usize) -> std::io::Result<u32> {
        let taken = sys::mapping_count()? + MAPPINGS_PER_PAGE * home_stripes + MAPPINGS_RESERVED;
        let allowed = sys::mapping_count_max()?.saturating_sub(taken) / MAPPINGS_PER_PAGE;
        Ok(u32::try_from(allowed).unwrap_or(u32::MAX))
    }

    pub(super) fn fill(&self, area: &Area, page: PageId, slot: SlotId, body: Body<'_>) -> Result<(), Errno> {
        let offset = slot.index() as u64 * area.page_bytes() as u64;
        let file = sys::raw(self.slots.as_fd());
        // SAFETY: the transport vouches for the body as long as it lives; its length was checked.
        unsafe { sys::write_at(file, body.as_ptr(), area.page_bytes(), offset) }?;
        // SAFETY: the page lies in our area and is absent. Its slot is not written again before it is taken away, so
        // the bytes do not change under a reader.
        unsafe { sys::map_file_over(area.address(page), area.page_bytes(), file, offset) }
    }

    pub(super) fn give_zeros(&self, area: &Area, page: PageId) -> Result<(), Errno> {
        // SAFETY: the page lies in our area and is absent.
        unsafe { sys::map_nothing_over(area.address(page), area.page_bytes(), libc::PROT_READ) }
    }

    /// Takes pages from their readers' sight. Their bytes stay in their slots.
    pub(super) fn hide(&self, area: &Area, pages: &[(PageId, SlotId)]) -> Result<(), Errno> {
        for (page, _) in pages {
            // SAFETY: the page lies in our area, and the state machine has declared it hiding: a reader that comes
            // now faults and waits.
            unsafe { sys::protect(area.address(*page), area.page_bytes(), libc::PROT_NONE) }?;
        }
        Ok(())
    }

    /// Brings a hidden page back.
    pub(super) fn show(&self, area: &Area, page: PageId) -> Result<(), Errno> {
        // SAFETY: the page lies in our area, and its slot was not written since it was hidden.
        unsafe { sys::protect(area.address(page), area.page_bytes(), libc::PROT_READ) }
    }

    pub(super) fn take_away(&self, area: &Area, victims: &[(PageId, SlotId)]) -> Result<(), Errno> {
        for (page, _) in victims {
            // SAFETY: the page lies in our area, and the state machine has declared it leaving: a reader that comes
            // now faults and waits. Bytes that were read before stay right; the scene does not change.
            unsafe { sys::map_nothing_over(area.address(*page), area.page_bytes(), libc::PROT_NONE) }?;
        }
        Ok(())
    }
}
