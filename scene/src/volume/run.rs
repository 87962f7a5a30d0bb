//! Runs of samples.

use super::shape::VolumeShape;

/// Asserts that a run lies in a volume.
pub(super) fn check(shape: &VolumeShape, first: u64, count: usize) {
    let end = first.checked_add(count as u64);
    assert!(
        end.is_some_and(|end| end <= shape.samples()),
        "samples {first} and {count} more of a volume of {:?}",
        shape.dims
    );
}

/// A number below the length of something in memory.
pub(super) fn index(number: u64) -> usize {
    usize::try_from(number).expect("an index of something in memory")
}
