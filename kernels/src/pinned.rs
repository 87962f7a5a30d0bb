//! Memory whose pages are pinned record by record.

use core::fmt;

use fault_linux::Record;
use rt_core::SceneMemory;

/// Pins records of a scene image.
pub trait Pins {
    /// The bytes `offset..offset + length`, in place while the record lives; `None` when they cannot be had.
    fn record(&self, offset: u64, length: usize) -> Option<Record<'_>>;

    /// Length of the image in bytes.
    fn length(&self) -> u64;
}

/// A scene of which every access goes through a table: the `soft` backend, whatever its transport.
#[derive(Clone, Copy)]
pub struct Pinned<'a>(pub &'a dyn Pins);

impl SceneMemory for Pinned<'_> {
    type Record<'b>
        = Record<'b>
    where
        Self: 'b;

    #[inline]
    fn record(&self, offset: u64, length: usize) -> Option<Record<'_>> {
        self.0.record(offset, length)
    }

    fn length(&self) -> u64 {
        self.0.length()
    }
}

impl fmt::Debug for Pinned<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Pinned({} bytes)", self.length())
    }
}
