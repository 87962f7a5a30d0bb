//! Asking the processor to bring bytes nearer before they are read.
#![allow(unsafe_code, reason = "one instruction that has no safe wrapper")]

/// Has the processor fetch these bytes into its caches while it goes on. Bytes on an absent page are left alone: a
/// prefetch never faults.
#[inline(always)]
pub(crate) fn prefetch(bytes: &[u8]) {
    #[cfg(target_arch = "x86_64")]
    for line in bytes.chunks(LINE_BYTES) {
        use core::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: every processor of this architecture has SSE; the instruction reads nothing that shows.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(line.as_ptr().cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = bytes;
}

#[cfg(target_arch = "x86_64")]
const LINE_BYTES: usize = 64;
