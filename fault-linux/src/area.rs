//! The reserved address range of a region, and where its pages are.

use core::ops::Range;

use dsm_core::id::PageId;

use crate::sys::{self, Errno};

/// Address space of our own, given back on drop.
#[derive(Debug)]
pub(crate) struct Area {
    start: *mut u8,
    page_bytes: usize,
    page_count: u32,
}

// SAFETY: an address range belongs to the process, not to a thread; what is done with it argues for itself.
unsafe impl Send for Area {}
// SAFETY: as above; all fields are constant.
unsafe impl Sync for Area {}

/// Areas start at a multiple of this, or of the page if that is larger, so that huge pages could lie in them.
const ALIGN: usize = 2 << 20;

impl Area {
    /// Reserves `page_count` pages. A child made by fork does not get them: a read there is an ordinary crash.
    pub(crate) fn reserve(page_count: u32, page_bytes: usize, protection: i32) -> Result<Self, Errno> {
        let bytes = (page_count as usize).checked_mul(page_bytes).ok_or(Errno(libc::ENOMEM))?;
        let start = sys::reserve(bytes, ALIGN.max(page_bytes), protection)?;
        let area = Self { start, page_bytes, page_count };
        sys::advise(start, bytes, libc::MADV_DONTFORK)?;
        Ok(area)
    }

    pub(crate) const fn start(&self) -> *mut u8 {
        self.start
    }

    pub(crate) const fn page_bytes(&self) -> usize {
        self.page_bytes
    }

    /// Length in bytes. `reserve` has checked that it does not overflow.
    pub(crate) const fn bytes(&self) -> usize {
        self.page_count as usize * self.page_bytes
    }

    /// The page that `address` lies in, or `None` when it lies outside.
    pub(crate) fn page_at(&self, address: usize) -> Option<PageId> {
        let offset = address.checked_sub(self.start.addr())?;
        let page = u32::try_from(offset / self.page_bytes).ok()?;
        (page < self.page_count).then_some(PageId(page))
    }

    /// Where `page` starts.
    pub(crate) fn address(&self, page: PageId) -> *mut u8 {
        debug_assert!(page.0 < self.page_count);
        self.start.wrapping_add(page.index() * self.page_bytes)
    }

    /// Where `pages` start, and how many bytes they are.
    pub(crate) fn span(&self, pages: &Range<u32>) -> (*mut u8, usize) {
        (self.address(PageId(pages.start)), pages.len() * self.page_bytes)
    }
}

impl Drop for Area {
    fn drop(&mut self) {
        // An area of no pages, as of a node without slots, is no mapping.
        if self.bytes() > 0 {
            sys::unmap(self.start, self.bytes());
        }
    }
}
