//! Anonymous memory: the plain array that shared pages are compared with, and room for the reconstruction of 2004.

use core::ptr;
use core::slice;
use std::io;

use crate::space::Numbers;

/// A private anonymous mapping, given back on drop.
#[derive(Debug)]
pub(crate) struct Memory {
    mapped: *mut u8,
    mapped_bytes: usize,
    /// Where the part in use starts: at a multiple of [`ALIGN`], as regions do.
    start: *mut u8,
    bytes: usize,
}

/// How large the pages are that the processor looks addresses up by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum HugePages {
    /// 4 KB, as in the regions, which forbid others.
    Never,
    /// 2 MB where the system finds them.
    Advised,
}

const ALIGN: usize = 2 << 20;

/// What the system allocates at a time where it does not find more.
const SMALL_PAGE: usize = 4096;

// SAFETY: a mapping belongs to the process, not to a thread; what is done through the pointer argues for itself.
unsafe impl Send for Memory {}
// SAFETY: as above; `&Memory` gives shared slices and raw pointers.
unsafe impl Sync for Memory {}

impl Memory {
    /// An array of `bytes` zeros.
    pub(crate) fn array(bytes: usize, huge_pages: HugePages) -> io::Result<Self> {
        let memory = Self::map(bytes, libc::PROT_READ | libc::PROT_WRITE)?;
        let advice = match huge_pages {
            HugePages::Never => libc::MADV_NOHUGEPAGE,
            HugePages::Advised => libc::MADV_HUGEPAGE,
        };
        // SAFETY: the range is ours, and the advice does not change what is in it.
        let advised = unsafe { libc::madvise(memory.start.cast(), bytes, advice) };
        // A kernel without huge pages does not know the advice, and does not need it.
        if advised != 0 && io::Error::last_os_error().raw_os_error() != Some(libc::EINVAL) {
            return Err(io::Error::last_os_error());
        }
        Ok(memory)
    }

    /// Lends room for `count` values of which each is `value` at first. Only for memory made by [`array`](Self::array).
    ///
    /// # Panics
    /// When it has not as much.
    pub(crate) fn lend<T: Copy>(&mut self, value: T, count: usize) -> &mut [T] {
        assert!(count * size_of::<T>() <= self.bytes && align_of::<T>() <= ALIGN, "room for {count} values");
        let start = self.start.cast::<T>();
        for index in 0..count {
            // SAFETY: in bounds and aligned, as asserted; the exclusive borrow makes it the only access.
            unsafe { start.wrapping_add(index).write(value) };
        }
        // SAFETY: all `count` values were written just now; the exclusive borrow lives as long as the slice.
        unsafe { slice::from_raw_parts_mut(start, count) }
    }

    /// Address space that nobody may touch yet.
    pub(crate) fn reserve(bytes: usize) -> io::Result<Self> {
        Self::map(bytes, libc::PROT_NONE)
    }

    pub(crate) const fn start(&self) -> *mut u8 {
        self.start
    }

    pub(crate) const fn bytes(&self) -> usize {
        self.bytes
    }

    /// The array's words. Only for memory made by [`array`](Self::array).
    pub(crate) fn words(&self) -> &[u64] {
        // SAFETY: the part in use is mapped, aligned to 2 MB, and zeros or numbers written through `words_mut`, whose
        // exclusive borrow has ended.
        unsafe { slice::from_raw_parts(self.start.cast(), self.bytes / size_of::<u64>()) }
    }

    /// The same, for writing.
    pub(crate) fn words_mut(&mut self) -> &mut [u64] {
        // SAFETY: the part in use is mapped, aligned to 2 MB, and zeros or numbers written through this slice; the
        // exclusive borrow makes it the only reference.
        unsafe { slice::from_raw_parts_mut(self.start.cast(), self.bytes / size_of::<u64>()) }
    }

    fn map(bytes: usize, protection: i32) -> io::Result<Self> {
        let mapped_bytes = bytes + ALIGN;
        let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_NORESERVE;
        // SAFETY: the kernel chooses a free address.
        let mapped = unsafe { libc::mmap(ptr::null_mut(), mapped_bytes, protection, flags, -1, 0) };
        if mapped == libc::MAP_FAILED {
            return Err(io::Error::last_os_error());
        }
        let mapped = mapped.cast::<u8>();
        let start = mapped.wrapping_add(mapped.addr().next_multiple_of(ALIGN) - mapped.addr());
        Ok(Self { mapped, mapped_bytes, start, bytes })
    }
}

/// Memory that is held so that what is allocated next comes from all over the machine.
///
/// The system gives fresh arrays neighbouring pages or scattered ones, as it happens, and to read scattered ones takes
/// ten per cent longer: more than what is to be measured. After this every page of every array is scattered.
#[derive(Debug)]
pub(crate) struct Scattered {
    _rest: Memory,
}

impl Scattered {
    /// Scatters the next `bytes` that are allocated page by page.
    pub(crate) fn next(bytes: usize, numbers: &mut Numbers) -> io::Result<Self> {
        let mut memory = Memory::array(2 * bytes, HugePages::Never)?;
        memory.words_mut().iter_mut().step_by(SMALL_PAGE / size_of::<u64>()).for_each(|word| *word = 1);
        let mut pages: Vec<usize> = (0..2 * bytes / SMALL_PAGE).collect();
        for last in (1..pages.len()).rev() {
            pages.swap(last, numbers.below(last + 1));
        }
        for page in &pages[..bytes / SMALL_PAGE] {
            let start = memory.start.wrapping_add(page * SMALL_PAGE);
            // SAFETY: the page lies in our mapping, and nobody looks at what is in it.
            if unsafe { libc::madvise(start.cast(), SMALL_PAGE, libc::MADV_DONTNEED) } != 0 {
                return Err(io::Error::last_os_error());
            }
        }
        Ok(Self { _rest: memory })
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        // SAFETY: mapped by `map` with this length; every reference into it borrowed `self`.
        let unmapped = unsafe { libc::munmap(self.mapped.cast(), self.mapped_bytes) };
        debug_assert_eq!(unmapped, 0);
    }
}
