//! A piece of a memory file, mapped for reading and writing.

use core::ffi::c_void;
use core::ptr;
use std::io;
use std::os::fd::BorrowedFd;

use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};

/// Shared memory. Other processes write it while we look, so no reference to its bytes is ever formed but to atomics.
#[derive(Debug)]
pub(crate) struct Mapping {
    start: *mut u8,
    length: usize,
}

// SAFETY: a mapping belongs to the process, not to a thread. It is reached only through atomics and raw copies.
unsafe impl Send for Mapping {}
// SAFETY: as above; `&Mapping` gives atomics and raw pointers, and those who copy through them argue for it.
unsafe impl Sync for Mapping {}

impl Mapping {
    /// Maps `length` bytes of `file` from `offset`, both multiples of 4096. The file is at least that long and
    /// sealed against shrinking, so that touching the mapping cannot raise SIGBUS.
    pub(crate) fn new(file: BorrowedFd<'_>, offset: u64, length: usize) -> io::Result<Self> {
        let protection = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: the kernel chooses an address that is free, so no existing mapping is touched.
        let start = unsafe { mmap(ptr::null_mut(), length, protection, MapFlags::SHARED, file, offset)? };
        Ok(Self { start: start.cast(), length })
    }

    /// Maps a whole file for reading, with every page present, only to keep it so.
    pub(crate) fn holding(file: BorrowedFd<'_>, length: usize) -> io::Result<Self> {
        let flags = MapFlags::SHARED | MapFlags::POPULATE;
        // SAFETY: as in `new`.
        let start = unsafe { mmap(ptr::null_mut(), length, ProtFlags::READ, flags, file, 0)? };
        Ok(Self { start: start.cast(), length })
    }

    /// A pointer to byte `offset`, behind which `length` bytes lie inside the mapping.
    ///
    /// # Panics
    /// When they do not: offsets come from a layout, never from another process.
    pub(crate) fn pointer(&self, offset: usize, length: usize) -> *mut u8 {
        assert!(offset.checked_add(length).is_some_and(|end| end <= self.length), "outside the mapping");
        self.start.wrapping_add(offset)
    }

    /// The atomic structure at byte `offset`.
    ///
    /// `T` consists of atomics for which all bits zero is a value, and any bits are.
    ///
    /// # Panics
    /// When it does not lie inside the mapping, or not at its alignment.
    pub(crate) fn shared<T: Atomics>(&self, offset: usize) -> &T {
        let pointer = self.pointer(offset, size_of::<T>()).cast::<T>();
        assert!(pointer.is_aligned());
        // SAFETY: the reference is good for as long as `self` is.
        // - In bounds and aligned: checked above. Mapped until `drop`, which `&self` outlives.
        // - Valid: `T: Atomics` consists of atomics, and any bits are a value of those.
        // - Other processes write it: through atomics, which is what they are for.
        unsafe { &*pointer }
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        let start: *mut c_void = self.start.cast();
        // SAFETY: it was mapped by `new` with this length, and every reference into it borrowed `self`.
        let unmapped = unsafe { munmap(start, self.length) };
        debug_assert!(unmapped.is_ok());
    }
}

/// Types made of atomics alone.
pub(crate) trait Atomics: Sync {}

impl Atomics for crate::bell::Bell {}
impl Atomics for crate::ring::Indices {}
