//! `uffd`: pages appear by one `UFFDIO_COPY` and leave by one `process_madvise` for many.
//!
//! One anonymous mapping holds the whole region, readable only. An absent page raises SIGBUS in the thread that reads
//! it; no handler thread, so no wake-up. The copy appears in whole pieces of 4 KB, and a thread that meets a piece
//! not yet there finds the page on its way and waits: no reader sees a piece half filled.
//!
//! Slots are a count here: the kernel finds the memory, and this keeps how much of it is in use within bounds.

use core::ptr;

use dsm_core::id::{PageId, SlotId};
use dsm_core::node::EVICT_BATCH_MAX;
use dsm_core::transport::Body;

use crate::area::Area;
use crate::sys::{self, Errno, Userfault};

#[derive(Debug)]
pub(crate) struct Uffd {
    userfault: Userfault,
    /// `process_madvise` drops pages of this very process (Linux 6.13 and later); else one call each.
    drops_many: bool,
}

impl Uffd {
    /// Opens a userfaultfd and makes `area` fault on it, after trying it on a page of its own.
    pub(crate) fn new(area: &Area) -> Result<Self, Errno> {
        let userfault = Userfault::open()?;
        let drops_many = try_out(&userfault)?;
        sys::advise(area.start(), area.bytes(), libc::MADV_NOHUGEPAGE).or_else(ignore_unknown)?;
        userfault.register(area.start(), area.bytes())?;
        Ok(Self { userfault, drops_many })
    }

    pub(super) fn fill(&self, area: &Area, page: PageId, body: Body<'_>) -> Result<(), Errno> {
        self.userfault.copy(area.address(page), body.as_ptr(), area.page_bytes())
    }

    pub(super) fn give_zeros(&self, area: &Area, page: PageId) -> Result<(), Errno> {
        self.userfault.zero(area.address(page), area.page_bytes())
    }

    pub(super) fn take_away(&self, area: &Area, victims: &[(PageId, SlotId)]) -> Result<(), Errno> {
        let mut ranges = [libc::iovec { iov_base: ptr::null_mut(), iov_len: 0 }; EVICT_BATCH_MAX as usize];
        let ranges = &mut ranges[..victims.len()];
        for (range, (page, _)) in ranges.iter_mut().zip(victims) {
            *range = libc::iovec { iov_base: area.address(*page).cast(), iov_len: area.page_bytes() };
        }
        let mut done = 0;
        if self.drops_many {
            // SAFETY: the pages are ours, and the state machine has declared them leaving: a reader that comes now
            // faults and waits. Bytes that were read before stay right; the scene does not change.
            let bytes = unsafe { sys::drop_pages_of_all(ranges) }?;
            done = bytes / area.page_bytes();
        }
        for range in &ranges[done..] {
            // SAFETY: as above.
            unsafe { sys::drop_pages(range.iov_base.cast(), range.iov_len) }?;
        }
        Ok(())
    }
}

/// Has a page appear and leave, and tells whether many can leave at once. Kernels refuse in more ways than one.
fn try_out(userfault: &Userfault) -> Result<bool, Errno> {
    const BYTES: usize = 4096;
    let area = Area::reserve(1, BYTES, libc::PROT_READ)?;
    let source = [7u8; BYTES];
    userfault.register(area.start(), BYTES)?;
    userfault.copy(area.start(), source.as_ptr(), BYTES)?;
    let range = [libc::iovec { iov_base: area.start().cast(), iov_len: BYTES }];
    // SAFETY: the page is this function's own, and nobody has read it.
    let drops_many = unsafe { sys::drop_pages_of_all(&range) } == Ok(BYTES);
    if !drops_many {
        // SAFETY: as above.
        unsafe { sys::drop_pages(area.start(), BYTES) }?;
    }
    // It has left if it can appear again: a page that is present would be left as it is, silently.
    userfault.copy(area.start(), source.as_ptr(), BYTES)?;
    Ok(drops_many)
}

/// A kernel without huge pages does not know the advice, and does not need it.
fn ignore_unknown(error: Errno) -> Result<(), Errno> {
    if error == Errno(libc::EINVAL) { Ok(()) } else { Err(error) }
}
