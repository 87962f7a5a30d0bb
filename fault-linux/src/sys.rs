//! The system calls, each as one function that says what it does to memory.
//!
//! All of them are raw calls without allocation or locks, so they may be made from a signal handler.

use core::ffi::c_void;
use core::fmt;
use core::ptr;
use core::sync::atomic::AtomicU32;
use std::io;
use std::os::fd::{AsRawFd, BorrowedFd, FromRawFd, OwnedFd, RawFd};

use dsm_core::time::Instant;

/// The error number of a system call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Errno(pub i32);

impl Errno {
    pub(crate) fn last() -> Self {
        // SAFETY: the address of the calling thread's own error number is always good.
        let location = unsafe { libc::__errno_location() };
        // SAFETY: as above.
        Self(unsafe { *location })
    }

    /// Puts the error number back, for whoever was interrupted.
    pub(crate) fn restore(self) {
        // SAFETY: as in `last`.
        let location = unsafe { libc::__errno_location() };
        // SAFETY: as in `last`.
        unsafe { *location = self.0 };
    }
}

impl fmt::Display for Errno {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", io::Error::from_raw_os_error(self.0))
    }
}

impl core::error::Error for Errno {}

fn check(result: i64) -> Result<usize, Errno> {
    usize::try_from(result).map_err(|_| Errno::last())
}

/// Now, on `CLOCK_MONOTONIC`, in nanoseconds.
pub(crate) fn now_ns() -> u64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `time` is a valid place for the answer. The call cannot fail for this clock.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut time) };
    let (seconds, nanoseconds) = (u64::try_from(time.tv_sec), u64::try_from(time.tv_nsec));
    seconds.unwrap_or(0).saturating_mul(1_000_000_000).saturating_add(nanoseconds.unwrap_or(0))
}

/// Now, on the same clock, as the state machines count.
pub(crate) fn now() -> Instant {
    Instant::from_micros(now_ns() / 1000)
}

/// Sleeps while `word` is `expected`, until woken or for `timeout_us`. May return early for no reason.
pub(crate) fn futex_wait(word: &AtomicU32, expected: u32, timeout_us: u64) {
    let seconds = libc::time_t::try_from(timeout_us / 1_000_000).unwrap_or(libc::time_t::MAX);
    let nanoseconds = libc::c_long::try_from(timeout_us % 1_000_000 * 1000).unwrap_or(0);
    let timeout = libc::timespec { tv_sec: seconds, tv_nsec: nanoseconds };
    let operation = libc::FUTEX_WAIT | libc::FUTEX_PRIVATE_FLAG;
    // SAFETY: the word and the timeout outlive the call, which only reads them.
    unsafe { libc::syscall(libc::SYS_futex, word.as_ptr(), operation, expected, &raw const timeout) };
}

/// Wakes everybody who sleeps on `word`.
pub(crate) fn futex_wake_all(word: &AtomicU32) {
    let operation = libc::FUTEX_WAKE | libc::FUTEX_PRIVATE_FLAG;
    // SAFETY: only the word's address is used.
    unsafe { libc::syscall(libc::SYS_futex, word.as_ptr(), operation, i32::MAX) };
}

/// This process, asked of the kernel every time: a copy made by fork must not take itself for its parent.
pub(crate) fn pid() -> u32 {
    // SAFETY: without arguments.
    let pid = unsafe { libc::syscall(libc::SYS_getpid) };
    u32::try_from(pid).unwrap_or(0)
}

/// Writes a line to standard error without the library's buffers or locks.
pub(crate) fn complain(line: &[u8]) {
    // SAFETY: the bytes are readable for their length. A short or failed write is all we can do.
    unsafe { libc::write(libc::STDERR_FILENO, line.as_ptr().cast(), line.len()) };
}

/// A memory file of `bytes` bytes, all zero, without a name in any file system.
pub(crate) fn memory_file(bytes: usize) -> Result<OwnedFd, Errno> {
    // SAFETY: the name is a C string.
    let file = unsafe { libc::memfd_create(c"memsavvy-slots".as_ptr(), libc::MFD_CLOEXEC) };
    if file < 0 {
        return Err(Errno::last());
    }
    // SAFETY: the descriptor was just made and belongs to nobody else.
    let file = unsafe { OwnedFd::from_raw_fd(file) };
    let length = libc::off_t::try_from(bytes).map_err(|_| Errno(libc::EFBIG))?;
    // SAFETY: sets the length of our own file.
    if unsafe { libc::ftruncate(file.as_raw_fd(), length) } != 0 {
        return Err(Errno::last());
    }
    Ok(file)
}

/// Writes `length` bytes from `source` into `file` at `offset`, all of them.
///
/// # Safety
/// `source..source + length` is readable.
pub(crate) unsafe fn write_at(
    file: RawFd,
    source: *const u8,
    length: usize,
    offset: u64,
) -> Result<(), Errno> {
    let mut done = 0;
    while done < length {
        let at = libc::off_t::try_from(offset + done as u64).map_err(|_| Errno(libc::EFBIG))?;
        let rest = source.wrapping_add(done).cast::<c_void>();
        // SAFETY: the caller vouches for the whole range, of which this is the end.
        match check(unsafe { libc::pwrite(file, rest, length - done, at) } as i64) {
            Ok(0) => return Err(Errno(libc::ENOSPC)),
            Ok(written) => done += written,
            Err(Errno(libc::EINTR)) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Reserves `bytes` of address space at a multiple of `align`, readable as the protection says, costing no memory.
pub(crate) fn reserve(bytes: usize, align: usize, protection: i32) -> Result<*mut u8, Errno> {
    let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_NORESERVE;
    let padded = bytes.checked_add(align).ok_or(Errno(libc::ENOMEM))?;
    // SAFETY: the kernel chooses a free address.
    let start = unsafe { libc::mmap(ptr::null_mut(), padded, protection, flags, -1, 0) };
    if start == libc::MAP_FAILED {
        return Err(Errno::last());
    }
    let start = start.cast::<u8>();
    let before = start.align_offset(align).min(align);
    let aligned = start.wrapping_add(before);
    if before > 0 {
        unmap(start, before);
    }
    if align > before {
        unmap(aligned.wrapping_add(bytes), align - before);
    }
    Ok(aligned)
}

/// Gives address space back. Only for ranges that this crate has mapped and nobody refers to.
pub(crate) fn unmap(start: *mut u8, bytes: usize) {
    // SAFETY: the range is ours by this function's contract, kept by its few callers.
    let result = unsafe { libc::munmap(start.cast(), bytes) };
    debug_assert_eq!(result, 0);
}

/// Maps `bytes` of `file` from `offset` for reading, shared, in place of whatever is at `start`, pages present.
///
/// The replacement is one step: a reader sees the old or the new, never neither. A child made by fork does not get
/// the mapping: what it would read there may be another page by then.
///
/// # Safety
/// `start..start + bytes` lies in a reservation of ours, and no bytes that change under a reader come of it.
pub(crate) unsafe fn map_file_over(
    start: *mut u8,
    bytes: usize,
    file: RawFd,
    offset: u64,
) -> Result<(), Errno> {
    let offset = libc::off_t::try_from(offset).map_err(|_| Errno(libc::EFBIG))?;
    let flags = libc::MAP_SHARED | libc::MAP_FIXED | libc::MAP_POPULATE;
    // SAFETY: the caller vouches for the range.
    let mapped = unsafe { libc::mmap(start.cast(), bytes, libc::PROT_READ, flags, file, offset) };
    if mapped == libc::MAP_FAILED { Err(Errno::last()) } else { advise(start, bytes, libc::MADV_DONTFORK) }
}

/// Puts an empty private mapping in place of whatever is at `start`: not readable, or readable as zeros.
///
/// # Safety
/// `start..start + bytes` lies in a reservation of ours, and nobody relies on what was there.
pub(crate) unsafe fn map_nothing_over(start: *mut u8, bytes: usize, protection: i32) -> Result<(), Errno> {
    let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_NORESERVE | libc::MAP_FIXED;
    // SAFETY: the caller vouches for the range.
    let mapped = unsafe { libc::mmap(start.cast(), bytes, protection, flags, -1, 0) };
    if mapped == libc::MAP_FAILED { Err(Errno::last()) } else { Ok(()) }
}

/// Changes what may be done with pages that stay where they are.
///
/// # Safety
/// The range belongs to the caller, and nobody relies on what is taken from it.
pub(crate) unsafe fn protect(start: *mut u8, bytes: usize, protection: i32) -> Result<(), Errno> {
    // SAFETY: the caller vouches for the range.
    if unsafe { libc::mprotect(start.cast(), bytes, protection) } != 0 {
        return Err(Errno::last());
    }
    Ok(())
}

/// Gives advice about a range that changes no byte a reader may rely on: not to fork it, to use huge pages or not to.
pub(crate) fn advise(start: *mut u8, bytes: usize, advice: i32) -> Result<(), Errno> {
    debug_assert!(matches!(advice, libc::MADV_DONTFORK | libc::MADV_NOHUGEPAGE | libc::MADV_HUGEPAGE));
    // SAFETY: no such advice changes contents in this process.
    if unsafe { libc::madvise(start.cast(), bytes, advice) } == 0 { Ok(()) } else { Err(Errno::last()) }
}

/// Drops the pages of one range, so that they are absent again.
///
/// # Safety
/// The range is ours, and nobody relies on the bytes in it.
pub(crate) unsafe fn drop_pages(start: *mut u8, bytes: usize) -> Result<(), Errno> {
    // SAFETY: the caller vouches for the range.
    let result = unsafe { libc::madvise(start.cast(), bytes, libc::MADV_DONTNEED) };
    if result == 0 { Ok(()) } else { Err(Errno::last()) }
}

/// Drops the pages of many ranges with one call and, above all, one shoot-down of other cores' address caches.
/// Returns how many bytes it got through.
///
/// # Safety
/// As for [`drop_pages`], for every range.
pub(crate) unsafe fn drop_pages_of_all(ranges: &[libc::iovec]) -> Result<usize, Errno> {
    // SAFETY: the caller vouches for the ranges; the list outlives the call.
    let result = unsafe {
        libc::syscall(
            libc::SYS_process_madvise,
            PIDFD_SELF,
            ranges.as_ptr(),
            ranges.len(),
            libc::MADV_DONTNEED,
            0usize,
        )
    };
    check(result)
}

/// Stands for the calling process where a process descriptor is asked for. Linux 6.14.
const PIDFD_SELF: libc::c_int = -10_001;

/// Lines of `/proc/self/maps`: mappings that this process has.
pub(crate) fn mapping_count() -> io::Result<usize> {
    let maps = std::fs::read("/proc/self/maps")?;
    Ok(maps.split(|byte| *byte == b'\n').count())
}

/// Mappings that a process may have.
pub(crate) fn mapping_count_max() -> io::Result<usize> {
    let text = std::fs::read_to_string("/proc/sys/vm/max_map_count")?;
    text.trim().parse().map_err(|_| io::Error::new(io::ErrorKind::InvalidData, text))
}

/// A userfaultfd, and the five calls that are needed of it.
///
/// # Source
/// `ioctl_userfaultfd(2)`, and the kernel's `include/uapi/linux/userfaultfd.h` for the numbers.
#[derive(Debug)]
pub(crate) struct Userfault {
    file: OwnedFd,
}

impl Userfault {
    /// Opens one that any user may open, for faults of user code only, reported as SIGBUS to the faulting thread.
    pub(crate) fn open() -> Result<Self, Errno> {
        let flags = libc::O_CLOEXEC | USER_MODE_ONLY;
        // SAFETY: makes a descriptor, touches no memory.
        let file = check(unsafe { libc::syscall(libc::SYS_userfaultfd, flags) })?;
        let file = i32::try_from(file).map_err(|_| Errno(libc::EMFILE))?;
        // SAFETY: the descriptor was just made and belongs to nobody else.
        let file = unsafe { OwnedFd::from_raw_fd(file) };
        let mut api = [API, FEATURE_SIGBUS, 0];
        control(&file, IOCTL_API, &mut api)?;
        Ok(Self { file })
    }

    /// From now on a read of an absent page in the range raises SIGBUS.
    pub(crate) fn register(&self, start: *mut u8, bytes: usize) -> Result<(), Errno> {
        let mut register = [start.addr() as u64, bytes as u64, MODE_MISSING, 0];
        control(&self.file, IOCTL_REGISTER, &mut register)
    }

    /// Makes absent pages at `target` present with the bytes at `source`, each 4 KB piece in one step.
    ///
    /// A piece that is present already stays as it is.
    pub(crate) fn copy(&self, target: *mut u8, source: *const u8, bytes: usize) -> Result<(), Errno> {
        let mut done = 0;
        while done < bytes {
            let (to, from) = (target.addr() + done, source.addr() + done);
            let mut copy = [to as u64, from as u64, (bytes - done) as u64, 0, 0];
            match control(&self.file, IOCTL_COPY, &mut copy) {
                Ok(()) => return Ok(()),
                Err(Errno(libc::EEXIST)) => done += PIECE,
                // "copy" tells how far it came before it was disturbed.
                Err(Errno(libc::EAGAIN)) => done += usize::try_from(copy[4].cast_signed()).unwrap_or(0),
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Makes absent pages present as zeros, without memory of their own.
    pub(crate) fn zero(&self, target: *mut u8, bytes: usize) -> Result<(), Errno> {
        let mut done = 0;
        while done < bytes {
            let mut zero = [(target.addr() + done) as u64, (bytes - done) as u64, 0, 0];
            match control(&self.file, IOCTL_ZEROPAGE, &mut zero) {
                Ok(()) => return Ok(()),
                Err(Errno(libc::EEXIST)) => done += PIECE,
                Err(Errno(libc::EAGAIN)) => done += usize::try_from(zero[3].cast_signed()).unwrap_or(0),
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

/// Runs one control call, whose argument is a structure of `N` words.
fn control<const N: usize>(file: &OwnedFd, request: u64, argument: &mut [u64; N]) -> Result<(), Errno> {
    debug_assert_eq!((request >> 16) & 0x3fff, size_of::<[u64; N]>() as u64);
    // SAFETY: the request's number states the argument's size, which is checked against `N`. What the call does to
    // memory stays within ranges that this process registered: absent pages of our own reservation become present.
    let result = unsafe { libc::ioctl(file.as_raw_fd(), request, argument.as_mut_ptr()) };
    if result == 0 { Ok(()) } else { Err(Errno::last()) }
}

/// The smallest piece that becomes present in one step.
const PIECE: usize = 4096;

const API: u64 = 0xAA;
const FEATURE_SIGBUS: u64 = 1 << 7;
const MODE_MISSING: u64 = 1;
const USER_MODE_ONLY: i32 = 1;
const IOCTL_API: u64 = read_write(0x3F, 3);
const IOCTL_REGISTER: u64 = read_write(0, 4);
const IOCTL_COPY: u64 = read_write(3, 5);
const IOCTL_ZEROPAGE: u64 = read_write(4, 4);

/// The number of a control call that reads and writes `words` 64-bit words.
const fn read_write(number: u64, words: u64) -> u64 {
    (3 << 30) | ((words * 8) << 16) | (0xAA << 8) | number
}

/// The raw number of a borrowed descriptor, for a handler that cannot borrow.
pub(crate) fn raw(file: BorrowedFd<'_>) -> RawFd {
    file.as_raw_fd()
}
