//! The pixels of a tile, each looking for its nearest triangle.

use glam::Vec3;

use super::edges::{Extent, Margins, cover};
use super::frustum::{Borders, Depths};
use super::projection::Projected;
use super::walk::{Bounds, Targets, Triangles};
use super::winners::{Winner, Winners};
use crate::camera::Camera;
use crate::cluster::{Cluster, Nearest};
use crate::simd::{LANES, Mask, Simd, each};
use crate::surface::Surface;
use crate::tile::Tile;
use crate::triangle_woop::WoopRay;

/// A value for each pixel of a tile, by *block* of 4x4 pixels, row by row, and within it row by row.
pub(super) type ByBlock<T> = [[T; LANES]; LANES];

/// The pixels of a tile.
pub(super) struct Pixels<'a> {
    camera: &'a Camera,
    eye: Vec3,
    tile: Tile,
    /// Least and greatest inverse depth of the nearest hit so far; 0 where there is none.
    low: ByBlock<f32>,
    high: ByBlock<f32>,
    /// Places of the nearest triangles among the winners.
    place: ByBlock<u32>,
    /// Pixels that have hit something, pixels that there are.
    pub(super) hit: [Mask; LANES],
    present: [Mask; LANES],
    winners: Winners,
    depths: Depths,
    /// Full blocks whose depth is out of date.
    stale: Mask,
    /// Relative uncertainty of inverse depths.
    depth_epsilon: f32,
}

/// The borders of a tile's columns and rows of blocks.
pub(super) fn borders(tile: Tile) -> [Borders; 2] {
    [tile.width, tile.height].map(|length| {
        let end = length as f32 - 1.0;
        let first = [0.0_f32, 4.0, 8.0, 12.0];
        Borders { first: first.map(|at| at.min(end)), last: first.map(|at| (at + 3.0).min(end)) }
    })
}

/// Sixteen triangles under test.
struct Batch<'a, 'b, S: Simd> {
    triangles: &'a Triangles<'b, S>,
    margins: Margins<S::F>,
    /// Greatest inverse depths, and a little more.
    near: S::F,
    /// Places among the winners, once they have won anything, and how often places had moved then.
    places: [Option<(u32, u32)>; LANES],
}

/// First and last column and row of pixels that each triangle may cover.
struct Reach<S: Simd> {
    left: S::I,
    right: S::I,
    top: S::I,
    bottom: S::I,
}

impl<'a> Pixels<'a> {
    pub(super) fn new(camera: &'a Camera, eye: Vec3, tile: Tile, depth_epsilon: f32) -> Self {
        let present: [Mask; LANES] = core::array::from_fn(|block| {
            let count = |length: u32, at: usize| length as i32 - 4 * at as i32;
            let columns = in_range(0, count(tile.width, block % 4) - 1, 0);
            let rows = in_range(0, count(tile.height, block / 4) - 1, 0);
            spread(rows) & (columns * 0x1111)
        });
        let blocks = present.map(|present| if present == 0 { f32::INFINITY } else { 0.0 });
        Self {
            camera,
            eye,
            tile,
            low: [[0.0; LANES]; LANES],
            high: [[0.0; LANES]; LANES],
            place: [[0; LANES]; LANES],
            hit: [0; LANES],
            present,
            winners: Winners::new(),
            depths: Depths::new(blocks),
            stale: 0,
            depth_epsilon,
        }
    }

    /// The triangle that a pixel shows.
    #[inline(always)]
    pub(super) fn winner(&self, block: usize, lane: usize) -> &Winner {
        self.winners.get(self.place[block][lane])
    }

    /// The ray of a pixel.
    #[inline]
    fn ray(&self, block: usize, lane: usize) -> WoopRay {
        let x = self.tile.x + (block % 4 * 4 + lane % 4) as u32;
        let y = self.tile.y + (block / 4 * 4 + lane / 4) as u32;
        WoopRay::new(self.eye, self.camera.direction(self.camera.row(y), x))
    }

    /// Lets the pixel's ray decide whether it hits a triangle of a cluster, and which of two is nearer.
    #[inline(always)]
    fn decide(&mut self, (block, lane): (usize, usize), cluster: &Cluster<'_>, index: usize) {
        let held = self.hit[block] >> lane & 1 != 0;
        // Often it is another copy of the triangle that the pixel shows.
        if !held || !cluster.is_triangle(index, &self.winner(block, lane).corners) {
            self.decide_by_ray((block, lane), &Winner::of(cluster, index));
        }
    }

    #[inline(never)]
    fn decide_by_ray(&mut self, (block, lane): (usize, usize), winner: &Winner) {
        let ray = self.ray(block, lane);
        let Some(crossing) = ray.intersect(winner.corners, f32::INFINITY) else { return };
        if self.hit[block] >> lane & 1 != 0 {
            let before = self.winner(block, lane);
            let mut nearest = Nearest::none(f32::INFINITY);
            if let Some(crossing) = ray.intersect(before.corners, f32::INFINITY) {
                nearest.offer(crossing, before.primitive, before.corners);
            }
            if crossing.t > nearest.crossing.t {
                return;
            }
            nearest.offer(crossing, winner.primitive, winner.corners);
            if nearest.surface.is_none_or(|(_, surface)| surface != Surface::Triangle(winner.corners)) {
                return;
            }
        }
        let place = self.place_of(winner);
        let inverse_depth = 1.0 / crossing.t;
        let margin = inverse_depth * self.depth_epsilon;
        self.take((block, lane), place, inverse_depth - margin, inverse_depth + margin);
    }

    #[inline(always)]
    fn take(&mut self, (block, lane): (usize, usize), place: u32, low: f32, high: f32) {
        self.low[block][lane] = low;
        self.high[block][lane] = high;
        self.place[block][lane] = place;
        self.mark(block, 1 << lane);
    }

    /// Notes that pixels of a block have a nearer hit.
    #[inline(always)]
    fn mark(&mut self, block: usize, lanes: Mask) {
        self.hit[block] |= lanes;
        if self.hit[block] == self.present[block] {
            self.stale |= 1 << block;
        }
    }

    fn place_of(&mut self, winner: &Winner) -> u32 {
        if self.winners.is_full() {
            let hit = self.hit;
            let used = self.place.iter_mut().zip(hit).flat_map(|(places, hit)| {
                places
                    .iter_mut()
                    .enumerate()
                    .filter(move |(lane, _)| hit >> lane & 1 != 0)
                    .map(|(_, place)| place)
            });
            self.winners.clear_out(used);
        }
        self.winners.add(*winner)
    }

    /// Tests triangles that reach over at most 2x2 pixels: one pixel of each at a time.
    #[inline(always)]
    fn test_small<S: Simd>(&mut self, s: S, batch: &mut Batch<'_, '_, S>, reach: &Reach<S>, small: Mask) {
        let [left, right, top, bottom] =
            each!(4: [reach.left, reach.right, reach.top, reach.bottom], end => s.to_float(end));
        let (wide, high) = (s.lt(left, right) & small, s.lt(top, bottom) & small);
        for (x, y, lanes) in
            [(left, top, small), (right, top, wide), (left, bottom, high), (right, bottom, wide & high)]
        {
            if lanes == 0 {
                continue;
            }
            let Some(covered) = cover(s, batch.triangles, (x, y), &batch.margins, lanes) else { continue };
            let (low, high) = (s.array(covered.low), s.array(covered.high));
            let pixel = s.int_array(s.to_int(s.add(s.mul(y, s.splat(16.0)), x)));
            let mut candidates = covered.candidates;
            while candidates != 0 {
                let at = candidates.trailing_zeros() as usize;
                candidates &= candidates - 1;
                let pixel = pixel[at] as usize;
                let (block, lane) = (pixel >> 4 & 12 | pixel >> 2 & 3, pixel >> 2 & 12 | pixel & 3);
                if high[at] < self.low[block][lane] {
                    continue;
                }
                if covered.sure >> at & 1 != 0 && low[at] > self.high[block][lane] {
                    let place = self.place_in_batch(batch, at);
                    self.take((block, lane), place, low[at], high[at]);
                } else {
                    self.decide((block, lane), batch.triangles.cluster, batch.triangles.first + at);
                }
            }
        }
    }

    /// Tests triangles that reach over more, one at a time, against the blocks they reach over.
    #[inline(always)]
    fn test_large<S: Simd>(&mut self, s: S, batch: &mut Batch<'_, '_, S>, reach: &Reach<S>, mut large: Mask) {
        let of = batch.triangles;
        let corners =
            each!(3: of.corners, corner => [s.array(corner.x), s.array(corner.y), s.array(corner.w)]);
        let (edge, depth, near) =
            (s.array(batch.margins.edge), s.array(batch.margins.depth), s.array(batch.near));
        let [left, right, top, bottom] =
            each!(4: [reach.left, reach.right, reach.top, reach.bottom], end => s.int_array(end));
        while large != 0 {
            let at = large.trailing_zeros() as usize;
            large &= large - 1;
            let corners = each!(3: corners, [x, y, w] => Projected {
                x: s.splat(x[at]),
                y: s.splat(y[at]),
                w: s.splat(w[at]),
            });
            let one = Triangles { corners, ..*of };
            let margins = Margins { edge: s.splat(edge[at]), depth: s.splat(depth[at]) };
            for row in top[at] / 4..=bottom[at] / 4 {
                for column in left[at] / 4..=right[at] / 4 {
                    let block = (row * 4 + column) as usize & 15;
                    let lanes = (in_range(left[at], right[at], column * 4) * 0x1111)
                        & spread(in_range(top[at], bottom[at], row * 4))
                        & self.present[block];
                    if self.depths.blocks[block] <= near[at] {
                        self.test_block(s, batch, (&one, at), &margins, (block, lanes));
                    }
                }
            }
        }
    }

    /// Tests one triangle of a batch, in all lanes, against pixels of a block.
    #[inline(always)]
    fn test_block<S: Simd>(
        &mut self,
        s: S,
        batch: &mut Batch<'_, '_, S>,
        (one, at): (&Triangles<'_, S>, usize),
        margins: &Margins<S::F>,
        (block, lanes): (usize, Mask),
    ) {
        let x = s.add(s.load(&COLUMNS), s.splat((block % 4 * 4) as f32));
        let y = s.add(s.load(&ROWS), s.splat((block / 4 * 4) as f32));
        let Some(covered) = cover(s, one, (x, y), margins, lanes) else { return };
        let (low, high) = (s.load(&self.low[block]), s.load(&self.high[block]));
        let candidates = covered.candidates & s.le(low, covered.high);
        let wins = candidates & covered.sure & s.lt(high, covered.low);
        if wins != 0 {
            let place = self.place_in_batch(batch, at);
            s.store(s.select(wins, covered.low, low), &mut self.low[block]);
            s.store(s.select(wins, covered.high, high), &mut self.high[block]);
            let places = bytemuck::cast_mut::<_, [f32; LANES]>(&mut self.place[block]);
            s.store(s.select(wins, s.splat(f32::from_bits(place)), s.load(places)), places);
            self.mark(block, wins);
        }
        let mut open = candidates & !wins;
        while open != 0 {
            self.decide((block, open.trailing_zeros() as usize), one.cluster, one.first + at);
            open &= open - 1;
        }
    }

    /// The place of a triangle of the batch among the winners.
    #[inline(always)]
    fn place_in_batch<S: Simd>(&mut self, batch: &mut Batch<'_, '_, S>, at: usize) -> u32 {
        if let Some((place, moves)) = batch.places[at]
            && moves == self.winners.moves
        {
            return place;
        }
        let place = self.place_of(&Winner::of(batch.triangles.cluster, batch.triangles.first + at));
        batch.places[at] = Some((place, self.winners.moves));
        place
    }
}

impl<S: Simd> Targets<S> for Pixels<'_> {
    #[inline(always)]
    fn depths(&mut self, s: S) -> &Depths {
        if self.stale != 0 {
            while self.stale != 0 {
                let block = self.stale.trailing_zeros() as usize;
                self.stale &= self.stale - 1;
                let lanes = self.present[block];
                let low = s.select(lanes, s.load(&self.low[block]), s.splat(f32::INFINITY));
                self.depths.blocks[block] = s.least(low);
            }
            self.depths.refresh();
        }
        &self.depths
    }

    /// The blocks that the cluster reaches over and may be nearest in.
    #[inline(always)]
    fn interest(&mut self, s: S, bounds: &Bounds) -> u64 {
        let end = [self.tile.width, self.tile.height].map(|length| length as f32 - 1.0);
        if bounds.right < 0.0 || bounds.bottom < 0.0 || bounds.left > end[0] || bounds.top > end[1] {
            return 0;
        }
        let line = |place: f32| place.clamp(0.0, 15.0) as i32 / 4;
        let columns = in_range(line(bounds.left), line(bounds.right), 0);
        let rows = in_range(line(bounds.top), line(bounds.bottom), 0);
        let waiting = s.le(s.load(&self.depths(s).blocks), s.splat(bounds.near));
        u64::from(spread(rows) & (columns * 0x1111) & waiting)
    }

    /// Whether there is a pixel within the bounds that shows nothing nearer.
    #[inline(always)]
    fn wants(&mut self, s: S, bounds: &Bounds) -> bool {
        // Nearly the next whole number: a pixel too many does not matter, one too few would.
        let first = |place: f32| (place.max(0.0) + 0.999_99).min(16.0) as i32;
        let last = |place: f32, length: u32| (place.min(length as f32 - 1.0) + 1.0).max(0.0) as i32 - 1;
        let (left, right) = (first(bounds.left), last(bounds.right, self.tile.width));
        let (top, bottom) = (first(bounds.top), last(bounds.bottom, self.tile.height));
        for row in top / 4..=bottom >> 2 {
            for column in left / 4..=right >> 2 {
                let block = (row * 4 + column) as usize % LANES;
                let lanes =
                    (in_range(left, right, column * 4) * 0x1111) & spread(in_range(top, bottom, row * 4));
                let waiting = s.le(s.load(&self.low[block]), s.splat(bounds.near)) & self.present[block];
                if lanes & waiting != 0 {
                    return true;
                }
            }
        }
        false
    }

    #[inline(always)]
    fn test(&mut self, s: S, triangles: &Triangles<'_, S>) {
        let extent = Extent::of(s, &triangles.corners);
        let delta = s.splat(triangles.delta);
        let near = s.mul(extent.near, s.splat(1.0 + triangles.depth_epsilon));
        let (width, height) = (self.tile.width as f32 - 1.0, self.tile.height as f32 - 1.0);
        let zero = s.splat(0.0);
        let (left, right) =
            (s.max(s.sub(extent.left, delta), zero), s.min(s.add(extent.right, delta), s.splat(width)));
        let (top, bottom) =
            (s.max(s.sub(extent.top, delta), zero), s.min(s.add(extent.bottom, delta), s.splat(height)));
        // Nearly the next whole number: a pixel too many does not matter, one too few would.
        let up = s.splat(0.999_99);
        let reach = Reach {
            left: s.to_int(s.add(left, up)),
            right: s.to_int(right),
            top: s.to_int(s.add(top, up)),
            bottom: s.to_int(bottom),
        };
        let wide = s.to_float(s.sub_int(reach.right, reach.left));
        let high = s.to_float(s.sub_int(reach.bottom, reach.top));
        let lanes = s.le(left, right)
            & s.le(top, bottom)
            & s.le(s.splat(self.depths.least), near)
            & s.le(zero, wide)
            & s.le(zero, high)
            & triangles.lanes;
        if lanes == 0 {
            return;
        }
        let one = s.splat(1.0);
        let small = lanes & s.le(wide, one) & s.le(high, one);
        let margins = extent.margins(s, triangles);
        let mut batch = Batch { triangles, margins, near, places: [None; LANES] };
        if small != 0 {
            self.test_small(s, &mut batch, &reach, small);
        }
        if lanes & !small != 0 {
            self.test_large(s, &mut batch, &reach, lanes & !small);
        }
    }

    fn test_by_rays(&mut self, s: S, cluster: &Cluster<'_>) {
        for block in 0..LANES {
            for lane in 0..LANES {
                if self.present[block] >> lane & 1 == 0 {
                    continue;
                }
                let mut nearest = Nearest::none(f32::INFINITY);
                cluster.intersect::<S, false>(s, &self.ray(block, lane), &mut nearest);
                if let Some((primitive, Surface::Triangle(corners))) = nearest.surface {
                    self.decide_by_ray((block, lane), &Winner { corners, primitive });
                }
            }
        }
    }
}

/// Four bits: which of the pixels `at..at + 4` lie in a range.
#[inline(always)]
const fn in_range(first: i32, last: i32, at: i32) -> Mask {
    let from = if first > at { first - at } else { 0 };
    let until = if last < at + 3 { last - at } else { 3 };
    if from > 3 || until < 0 { 0 } else { (0xf << from & 0xf >> (3 - until)) as Mask }
}

/// Each of four bits four times.
#[inline(always)]
const fn spread(bits: Mask) -> Mask {
    ((bits & 1) | (bits & 2) << 3 | (bits & 4) << 6 | (bits & 8) << 9) * 0xf
}

const COLUMNS: [f32; LANES] =
    [0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0];
const ROWS: [f32; LANES] = [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 3.0, 3.0, 3.0, 3.0];
