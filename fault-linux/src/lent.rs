//! Memory lent to a state machine that lives beside it.

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
