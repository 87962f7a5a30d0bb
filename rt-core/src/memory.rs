//! How kernels reach the bytes of a scene image.

use core::ops::Deref;

/// Read access to the bytes of one scene image.
///
/// # Contract
/// - The bytes of an image do not change while a view of it exists.
/// - A *record* (a branch, a leaf, a cluster, one id) never crosses a page of the image, so an instance that
///   holds pages apart needs to pin one page for one record.
/// - Kernels copy small records out at once and hold the [`Record`](Self::Record) of one cluster while they
///   test it; they never hold two, unless [`HOLDS_NOTHING`](Self::HOLDS_NOTHING) allows it.
pub trait SceneMemory {
    /// Bytes of one record; the page they lie on stays in place while this value lives.
    type Record<'a>: Deref<Target = [u8]>
    where
        Self: 'a;

    /// Whether a record holds nothing in place, so that kernels may hold several.
    const HOLDS_NOTHING: bool = false;

    /// The bytes `offset..offset + length` of the image, or `None` when they do not lie inside it.
    fn record(&self, offset: u64, length: usize) -> Option<Self::Record<'_>>;

    /// Length of the image in bytes.
    fn length(&self) -> u64;

    /// Whether reading a record takes no time to speak of. If not, kernels look twice whether they need it.
    #[inline]
    fn is_at_hand(&self, _offset: u64, _length: usize) -> bool {
        true
    }

    /// Whether that is so of all records, at any time. Who says no is read in the order that needs the fewest of them.
    #[inline]
    fn is_all_at_hand(&self) -> bool {
        true
    }

    /// Says that a record will be read soon. Changes nothing, and does not wait.
    #[inline]
    fn prefetch(&self, _offset: u64, _length: usize) {}
}

/// An image that lies in one slice: mapped whole, or paged by hardware below the tracer.
///
/// A record costs a bounds check and plain loads.
#[derive(Clone, Copy, Debug)]
pub struct Flat<'a>(&'a [u8]);

impl<'a> Flat<'a> {
    /// Lends the bytes of an image.
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }
}

impl SceneMemory for Flat<'_> {
    type Record<'b>
        = &'b [u8]
    where
        Self: 'b;

    const HOLDS_NOTHING: bool = true;

    #[inline]
    fn record(&self, offset: u64, length: usize) -> Option<&[u8]> {
        let start = usize::try_from(offset).ok()?;
        self.0.get(start..start.checked_add(length)?)
    }

    fn length(&self) -> u64 {
        self.0.len() as u64
    }

    #[inline]
    fn prefetch(&self, offset: u64, length: usize) {
        if let Some(record) = self.record(offset, length) {
            crate::simd::prefetch(record);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Flat, SceneMemory};

    #[test]
    fn a_record_outside_the_image_is_none() {
        let flat = Flat::new(&[1, 2, 3, 4]);
        assert_eq!(flat.record(1, 3), Some(&[2, 3, 4][..]));
        assert_eq!(flat.record(4, 0), Some(&[][..]));
        assert_eq!(flat.record(2, 3), None);
        assert_eq!(flat.record(u64::MAX, 1), None);
        assert_eq!(flat.record(1, usize::MAX), None);
    }
}
