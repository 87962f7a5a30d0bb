//! A brick made ready for the rays of a tile: its samples as numbers, and which of its cells may hold a surface.

use super::packet::CellBox;
use crate::brick::{Brick, SAMPLES};
use crate::frame::ISOVALUES_MAX;
use crate::isosurface::Sought;
use crate::simd::Simd;
use crate::volume::BRICK_EDGE;
use crate::volume_memo::CellMask;

/// The samples and cells of a brick.
pub(super) struct BrickCells {
    /// Sample `(x, y, z)` at `x + 8 y + 64 z`.
    pub(super) samples: [f32; SAMPLES],
    /// Cells with samples on both sides of each isovalue, a bit each at the number of their lowest sample.
    pub(super) crossed: [[u64; BRICK_EDGE]; ISOVALUES_MAX],
    /// The same of any of them.
    pub(super) active: [u64; BRICK_EDGE],
    /// The lowest cell of the brick.
    pub(super) corner: [i32; 3],
    /// A box around all active cells of the volume; empty, or the other way round, where there is none.
    pub(super) around: CellBox,
}

impl BrickCells {
    pub(super) const fn new() -> Self {
        Self {
            samples: [0.0; SAMPLES],
            crossed: [[0; BRICK_EDGE]; ISOVALUES_MAX],
            active: [0; BRICK_EDGE],
            corner: [0; 3],
            around: CellBox { low: [0; 3], high: [0; 3] },
        }
    }

    /// Makes ready a brick whose cells of the volume are those of `cells`.
    #[inline(always)]
    pub(super) fn fill<S: Simd>(&mut self, s: S, brick: &Brick<'_>, sought: &[Sought], cells: &CellBox) {
        brick.samples(&mut self.samples);
        self.active = [0; BRICK_EDGE];
        for (crossed, sought) in self.crossed.iter_mut().zip(sought) {
            let mut inside = [0; BRICK_EDGE];
            for (slice, samples) in inside.iter_mut().zip(self.samples.as_chunks::<64>().0) {
                for (quarter, sixteen) in samples.as_chunks().0.iter().enumerate() {
                    *slice |= u64::from(s.le(s.splat(sought.stored), s.load(sixteen))) << (16 * quarter);
                }
            }
            *crossed = CellMask::of(&inside).slices();
            self.active.iter_mut().zip(crossed).for_each(|(active, crossed)| *active |= *crossed);
        }
        self.corner = cells.low;
        self.around = around(&self.active, cells);
    }
}

/// The box around the cells of a mask.
#[inline(always)]
fn around(active: &[u64; BRICK_EDGE], cells: &CellBox) -> CellBox {
    let all = active.iter().fold(0, |all, slice| all | slice);
    let slices = (0..BRICK_EDGE).fold(0_u64, |slices, z| slices | u64::from(active[z] != 0) << z);
    let columns = [32, 16, 8].into_iter().fold(all, |all, half| all | all >> half) & 0xff;
    // Rows of eight columns each.
    let ends = [(columns, 1), (all, 8), (slices, 1)].map(|(bits, each)| {
        let (first, last) = (bits.trailing_zeros() / each, (63 - (bits | 1).leading_zeros()) / each);
        [first, last + 1].map(u32::cast_signed)
    });
    let mut found = *cells;
    for (axis, [first, end]) in ends.into_iter().enumerate() {
        found.high[axis] = found.high[axis].min(cells.low[axis] + end);
        found.low[axis] += first;
    }
    found
}
