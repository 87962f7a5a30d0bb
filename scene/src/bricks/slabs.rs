//! Runs through a volume, a layer of bricks at a time.

use core::ops::Range;

use rt_core::volume::{BRICK_CELLS, BRICK_EDGE, bricks_along};

use super::PrepareError;
use crate::volume::VolumeSource;

/// A layer of bricks: up to eight slices, of which the first belongs to the layer below as well.
#[derive(Debug)]
pub(super) struct Slab {
    /// Samples along each axis of the whole volume.
    pub(super) dims: [usize; 3],
    /// Layer, from 0.
    pub(super) layer: u32,
    samples: Vec<f32>,
    /// Slices in `samples`.
    slices: usize,
    /// Slices in `samples` that an earlier slab had as well.
    seen: usize,
}

/// Calls `each` with every layer of a volume, from below. Every slice is read once and is in some slab.
pub(super) fn for_each_slab(
    source: &mut dyn VolumeSource,
    dims: [u32; 3],
    mut each: impl FnMut(&Slab) -> Result<(), PrepareError>,
) -> Result<(), PrepareError> {
    let dims = dims.map(|count| count as usize);
    let slice = dims[0] * dims[1];
    let samples = vec![0.0; slice * dims[2].min(BRICK_EDGE)];
    let mut slab = Slab { dims, layer: 0, samples, slices: 0, seen: 0 };
    let layers = dims[2].saturating_sub(1).div_ceil(BRICK_CELLS as usize).max(1);
    for layer in 0..layers {
        // The last slice of the layer below is the first of this one.
        slab.seen = usize::from(layer > 0);
        if slab.seen > 0 {
            slab.samples.copy_within((slab.slices - 1) * slice..slab.slices * slice, 0);
        }
        let first = layer * BRICK_CELLS as usize + slab.seen;
        slab.slices = (dims[2] - layer * BRICK_CELLS as usize).min(BRICK_EDGE);
        source.read_slices(first as u64, &mut slab.samples[slab.seen * slice..slab.slices * slice])?;
        slab.layer = u32::try_from(layer).unwrap_or(u32::MAX);
        each(&slab)?;
    }
    Ok(())
}

impl Slab {
    /// The samples that no earlier slab had.
    pub(super) fn new_samples(&self) -> &[f32] {
        let slice = self.dims[0] * self.dims[1];
        &self.samples[self.seen * slice..self.slices * slice]
    }

    /// Bricks of the layer along x and y.
    pub(super) fn bricks(&self) -> [u32; 2] {
        [self.dims[0], self.dims[1]].map(|count| bricks_along(u32::try_from(count).unwrap_or(u32::MAX)))
    }

    /// The rows of samples of a brick, each with its place in the brick; cut off where the volume ends.
    pub(super) fn rows(&self, [x, y]: [u32; 2]) -> impl Iterator<Item = (usize, &[f32])> {
        let along = |brick: u32, count: usize| -> Range<usize> {
            let first = brick as usize * BRICK_CELLS as usize;
            first..count.min(first + BRICK_EDGE)
        };
        let (xs, ys) = (along(x, self.dims[0]), along(y, self.dims[1]));
        (0..self.slices).flat_map(move |z| {
            let xs = xs.clone();
            ys.clone().enumerate().map(move |(row, y)| {
                let start = (z * self.dims[1] + y) * self.dims[0];
                ((z * BRICK_EDGE + row) * BRICK_EDGE, &self.samples[start + xs.start..start + xs.end])
            })
        })
    }
}
