//! The pixels of a tile, each looking for the first root on its ray.

use super::cross::{Roots, Targets};
use super::packet::Limit;
use crate::beam::pixels::{blocks_within, present_in};
use crate::beam::surface::directions;
use crate::beam::triangles::Bounds;
use crate::blocks::BLOCKS;
use crate::memory::SceneMemory;
use crate::simd::{LANES, Mask, Simd, each};
use crate::tile::{Tile, TileView};

/// The pixels of a tile: each block is a packet.
pub(super) struct Pixels<'a, S: Simd, M> {
    view: &'a TileView<'a, M>,
    tile: Tile,
    pub(super) found: &'a mut [Found<S::D, S::F>; BLOCKS],
    /// What is deeper does not matter to a pixel; infinite where it shows nothing.
    end: [S::D; BLOCKS],
    /// For each block: what has a smaller inverse depth does not matter.
    waiting: [f32; BLOCKS],
}

/// The roots that sixteen pixels have found.
#[derive(Clone, Copy)]
pub(super) struct Found<D, F> {
    pub(super) lanes: Mask,
    /// Stretches of the rays in the cells, and the places of their ends.
    pub(super) enter: D,
    pub(super) exit: D,
    pub(super) from: [F; 3],
    pub(super) to: [F; 3],
    pub(super) samples: [F; 8],
    /// Which of the isosurfaces sought.
    pub(super) sought: F,
    /// Roots in the stretches, where they are known.
    pub(super) at: F,
    pub(super) known: Mask,
}

impl<D: Copy, F: Copy> Found<D, F> {
    /// No roots.
    #[inline(always)]
    pub(super) fn nothing<S: Simd<D = D, F = F>>(s: S) -> Self {
        let (zero, zeros) = (s.splat(0.0), s.splat_f64(0.0));
        Self {
            lanes: 0,
            enter: zeros,
            exit: zeros,
            from: [zero; 3],
            to: [zero; 3],
            samples: [zero; 8],
            sought: zero,
            at: zero,
            known: 0,
        }
    }
}

impl<'a, S: Simd, M: SceneMemory> Pixels<'a, S, M> {
    /// Pixels that show other things at these depths, or infinitely deep.
    #[inline(always)]
    pub(super) fn new(
        s: S,
        view: &'a TileView<'a, M>,
        tile: Tile,
        found: &'a mut [Found<S::D, S::F>; BLOCKS],
        t_max: &[S::F; BLOCKS],
    ) -> Self {
        let mut pixels = Self { view, tile, found, end: [s.splat_f64(0.0); BLOCKS], waiting: [0.0; BLOCKS] };
        for (block, &t_max) in t_max.iter().enumerate() {
            pixels.end[block] = s.widen(t_max);
            pixels.waiting[block] = of_no_matter(s, present_in(tile, block), t_max);
        }
        pixels
    }
}

/// The inverse depth below which nothing matters to pixels that look no deeper than `t`; infinite for none.
#[inline(always)]
fn of_no_matter<S: Simd>(s: S, lanes: Mask, t: S::F) -> f32 {
    let farthest = s.least(s.sub(s.splat(0.0), s.select(lanes, t, s.splat(0.0)))).abs();
    (1.0 - 1.0 / 1_048_576.0) / farthest
}

impl<S: Simd, M: SceneMemory> Targets<S> for Pixels<'_, S, M> {
    #[inline(always)]
    fn least(&mut self, s: S) -> f32 {
        let (quarters, _) = self.waiting.as_chunks::<LANES>();
        let [a, b, c, d] = each!(4: [0, 1, 2, 3], quarter => s.load(&quarters[quarter]));
        s.least(s.min(s.min(a, b), s.min(c, d)))
    }

    #[inline(always)]
    fn interest(&mut self, s: S, bounds: &Bounds) -> u64 {
        let near = s.splat(bounds.near);
        let mut waiting = 0;
        for (quarter, blocks) in self.waiting.as_chunks::<LANES>().0.iter().enumerate() {
            waiting |= u64::from(s.le(s.load(blocks), near)) << (quarter * LANES);
        }
        let [left, right] = [s.splat(bounds.left), s.splat(bounds.right)];
        let [top, bottom] = [s.splat(bounds.top), s.splat(bounds.bottom)];
        waiting & blocks_within(s, [left, right], [top, bottom])
    }

    #[inline(always)]
    fn rays(&self, s: S, number: usize) -> [[S::F; 3]; 2] {
        [s.splat3(self.view.eye), directions(s, &self.view.frame.camera, self.tile, number % BLOCKS)]
    }

    #[inline(always)]
    fn limit(&self, _: S, number: usize) -> Limit<S::D> {
        let block = number % BLOCKS;
        Limit { end: self.end[block], open: present_in(self.tile, block) }
    }

    #[inline(always)]
    fn take(&mut self, s: S, number: usize, roots: &Roots<'_, S>) {
        let block = number % BLOCKS;
        let (found, lanes, places) = (&mut self.found[block], roots.lanes, roots.places);
        let wide = s.wide_mask(lanes);
        found.lanes |= lanes;
        found.enter = s.select_f64(wide, places.enter, found.enter);
        found.exit = s.select_f64(wide, places.exit, found.exit);
        for axis in 0..3 {
            found.from[axis] = s.select(lanes, places.from[axis], found.from[axis]);
            found.to[axis] = s.select(lanes, places.to[axis], found.to[axis]);
        }
        for (to, &from) in found.samples.iter_mut().zip(roots.samples) {
            *to = s.select(lanes, from, *to);
        }
        found.sought = s.select(lanes, roots.sought, found.sought);
        found.known &= !lanes;
        if let Some(at) = roots.at {
            found.at = s.select(lanes, at, found.at);
            found.known |= lanes;
        }
        // What begins behind the cell of a root is of no matter.
        let end = s.select_f64(wide, places.enter, self.end[block]);
        self.end[block] = end;
        self.waiting[block] = of_no_matter(s, present_in(self.tile, block), s.narrow(end));
    }
}
