//! The pixels of a tile, each looking for the first root on its ray.

use super::cross::{Roots, Targets};
use super::packet::Limit;
use super::waiting::Names;
use crate::beam::pixels::{blocks_within, present_in};
use crate::beam::surface::directions;
use crate::beam::triangles::Bounds;
use crate::blocks::{BLOCKS, ByBlock};
use crate::memory::SceneMemory;
use crate::simd::{LANES, Mask, Simd, each};
use crate::tile::{Tile, TileView};

/// The pixels of a tile: each block is a packet.
pub(super) struct Pixels<'a, M> {
    view: &'a TileView<'a, M>,
    tile: Tile,
    found: &'a mut [FoundByLane; BLOCKS],
    /// What is deeper does not matter to a pixel; infinite where it shows nothing.
    end: ByBlock<f64>,
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

/// The same as numbers that are written one by one.
pub(super) type FoundByLane = Found<[f64; LANES], [f32; LANES]>;

impl FoundByLane {
    /// No roots.
    pub(super) const NOTHING: Self = Self {
        lanes: 0,
        enter: [0.0; LANES],
        exit: [0.0; LANES],
        from: [[0.0; LANES]; 3],
        to: [[0.0; LANES]; 3],
        samples: [[0.0; LANES]; 8],
        sought: [0.0; LANES],
        at: [0.0; LANES],
        known: 0,
    };

    #[inline(always)]
    pub(super) fn load<S: Simd>(&self, s: S) -> Found<S::D, S::F> {
        let mut samples = [s.splat(0.0); 8];
        for (to, from) in samples.iter_mut().zip(&self.samples) {
            *to = s.load(from);
        }
        Found {
            lanes: self.lanes,
            enter: s.load_f64(&self.enter),
            exit: s.load_f64(&self.exit),
            from: each!(3: [0, 1, 2], axis => s.load(&self.from[axis])),
            to: each!(3: [0, 1, 2], axis => s.load(&self.to[axis])),
            samples,
            sought: s.load(&self.sought),
            at: s.load(&self.at),
            known: self.known,
        }
    }

    /// Takes the root in a lane of others, whose masks are not looked at.
    #[inline(always)]
    fn take(&mut self, lane: usize, others: &Self, from: usize, is_known: bool) {
        let (lane, from) = (lane % LANES, from % LANES);
        self.lanes |= 1 << lane;
        self.known = self.known & !(1 << lane) | Mask::from(is_known) << lane;
        self.enter[lane] = others.enter[from];
        self.exit[lane] = others.exit[from];
        for axis in 0..3 {
            self.from[axis][lane] = others.from[axis][from];
            self.to[axis][lane] = others.to[axis][from];
        }
        for (to, others) in self.samples.iter_mut().zip(&others.samples) {
            to[lane] = others[from];
        }
        self.sought[lane] = others.sought[from];
        self.at[lane] = others.at[from];
    }
}

impl<'a, M: SceneMemory> Pixels<'a, M> {
    /// Pixels that show other things at these depths, or infinitely deep.
    #[inline(always)]
    pub(super) fn new<S: Simd>(
        s: S,
        view: &'a TileView<'a, M>,
        tile: Tile,
        found: &'a mut [FoundByLane; BLOCKS],
        t_max: &[S::F; BLOCKS],
    ) -> Self {
        let mut pixels = Self { view, tile, found, end: [[0.0; LANES]; BLOCKS], waiting: [0.0; BLOCKS] };
        for (block, &t_max) in t_max.iter().enumerate() {
            s.store_f64(s.widen(t_max), &mut pixels.end[block]);
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

impl<S: Simd, M: SceneMemory> Targets<S> for Pixels<'_, M> {
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
    fn limit(&self, s: S, number: usize) -> Limit<S::D> {
        let block = number % BLOCKS;
        Limit { end: s.load_f64(&self.end[block]), open: present_in(self.tile, block) }
    }

    #[inline(always)]
    fn take(&mut self, s: S, names: &Names, roots: &Roots<'_, S>) {
        let found = by_lane(s, roots);
        let mut lanes = roots.lanes;
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let (block, own) = names.of(lane);
            self.found[block % BLOCKS].take(own, &found, lane, roots.at.is_some());
            // What begins behind the cell of a root is of no matter.
            self.end[block % BLOCKS][own % LANES] = found.enter[lane];
        }
        let mut lanes = roots.lanes;
        while lanes != 0 {
            let (block, _) = names.take_packet(&mut lanes);
            let end = s.narrow(s.load_f64(&self.end[block % BLOCKS]));
            self.waiting[block % BLOCKS] = of_no_matter(s, present_in(self.tile, block % BLOCKS), end);
        }
    }
}

/// Roots as numbers.
#[inline(always)]
fn by_lane<S: Simd>(s: S, roots: &Roots<'_, S>) -> FoundByLane {
    let mut found = FoundByLane::NOTHING;
    s.store_f64(roots.places.enter, &mut found.enter);
    s.store_f64(roots.places.exit, &mut found.exit);
    for axis in 0..3 {
        s.store(roots.places.from[axis], &mut found.from[axis]);
        s.store(roots.places.to[axis], &mut found.to[axis]);
    }
    for (to, &sample) in found.samples.iter_mut().zip(roots.samples) {
        s.store(sample, to);
    }
    s.store(roots.sought, &mut found.sought);
    if let Some(at) = roots.at {
        s.store(at, &mut found.at);
    }
    found
}
