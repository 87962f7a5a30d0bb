//! Memory lent to a state machine that lives beside it.

use crate::sys;

/// A slice that was lent to somebody who lives no longer than this value: declare it after its borrower.
#[derive(Debug)]
pub(crate) struct Lent<T>(*mut [T]);

impl<T> Lent<T> {
    /// Lends `values`.
    ///
    /// # Safety
    /// The borrower is dropped before the second of the pair.
    pub(crate) unsafe fn lend(values: Vec<T>) -> (&'static mut [T], Self) {
        let values = Box::into_raw(values.into_boxed_slice());
        // SAFETY: just made, lent once, and given back by `drop` only, which the caller says is after the last use.
        (unsafe { &mut *values }, Self(values))
    }
}

/// `count` values that are read at random, each `value` at first: in huge pages, where the system has them.
pub(crate) fn table<T: Copy>(value: T, count: usize) -> Vec<T> {
    let mut values = Vec::<T>::with_capacity(count);
    let start = values.as_mut_ptr().cast::<u8>();
    let before = start.addr().next_multiple_of(HUGE_PAGE_BYTES) - start.addr();
    let whole = (count * size_of::<T>()).saturating_sub(before) / HUGE_PAGE_BYTES * HUGE_PAGE_BYTES;
    if whole > 0 {
        // Where they are refused, small pages do: a fault then waits a little longer for memory.
        let _ = sys::advise(start.wrapping_add(before), whole, libc::MADV_HUGEPAGE);
    }
    values.resize(count, value);
    values
}

const HUGE_PAGE_BYTES: usize = 2 << 20;

impl<T> Drop for Lent<T> {
    fn drop(&mut self) {
        // SAFETY: made by `Box::into_raw`; who borrowed it is gone, as the caller of `lend` has said.
        drop(unsafe { Box::from_raw(self.0) });
    }
}

// SAFETY: the pointer is only kept for `drop`, which any thread may do that may drop a `T`.
unsafe impl<T: Send> Send for Lent<T> {}
// SAFETY: `&Lent` gives access to nothing.
unsafe impl<T> Sync for Lent<T> {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_of_any_length_is_of_its_value() {
        for count in [0, 1, 1000, HUGE_PAGE_BYTES / 4, HUGE_PAGE_BYTES + 3] {
            let values = table(7_u32, count);
            assert!(values.len() == count && values.iter().all(|value| *value == 7), "{count}");
        }
    }
}
