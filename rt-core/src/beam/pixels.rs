//! The pixels of a tile, each looking for its nearest triangle.

use glam::Vec3;

use super::edges::{Extent, Margins, cover};
use super::frustum::{Borders, Depths};
use super::projection::{DEPTH_EPSILON, Projected};
use super::walk::{Targets, Triangles};
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
}

/// Sixteen triangles under test.
struct Batch<'a, 'b, S: Simd> {
    triangles: &'a Triangles<'b, S>,
    extent: Extent<S::F>,
    /// First and last column and row of pixels that each triangle may cover.
    columns: [[i32; LANES]; 2],
    rows: [[i32; LANES]; 2],
    /// The same: left, right, top, bottom.
    pixels: [S::F; 4],
    /// Places among the winners, once they have won anything, and how often places had moved then.
    places: [Option<(u32, u32)>; LANES],
}

impl<'a> Pixels<'a> {
    pub(super) fn new(camera: &'a Camera, eye: Vec3, tile: Tile) -> Self {
        let present: [Mask; LANES] = core::array::from_fn(|block| {
            let (x, y) = (block as u32 % 4 * 4, block as u32 / 4 * 4);
            (0..16).fold(0, |mask, lane| {
                let is_present = x + lane % 4 < tile.width && y + lane / 4 < tile.height;
                mask | Mask::from(is_present) << lane
            })
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
        }
    }

    /// The borders of the tile's columns and rows.
    pub(super) fn borders(&self) -> [Borders; 2] {
        [self.tile.width, self.tile.height].map(|length| {
            let end = length as f32 - 1.0;
            let first = [0.0_f32, 4.0, 8.0, 12.0];
            Borders { first: first.map(|at| at.min(end)), last: first.map(|at| (at + 3.0).min(end)) }
        })
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

    /// Lets the pixel's ray decide whether it hits a triangle, and which of two is nearer.
    #[inline(never)]
    fn decide(&mut self, (block, lane): (usize, usize), winner: &Winner) {
        let held = self.hit[block] >> lane & 1 != 0;
        if held && self.winner(block, lane).corners == winner.corners {
            // Another copy of the triangle that the pixel shows.
            return;
        }
        let ray = self.ray(block, lane);
        let Some(crossing) = ray.intersect(winner.corners, f32::INFINITY) else { return };
        if held {
            let before = *self.winner(block, lane);
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
        let margin = inverse_depth * DEPTH_EPSILON;
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
    fn test_small<S: Simd>(&mut self, s: S, batch: &mut Batch<'_, '_, S>, small: Mask) {
        let margins = batch.extent.margins(s, batch.triangles.delta);
        let [left, right, top, bottom] = batch.pixels;
        let (wide, high) = (s.lt(left, right) & small, s.lt(top, bottom) & small);
        for (x, y, lanes) in
            [(left, top, small), (right, top, wide), (left, bottom, high), (right, bottom, wide & high)]
        {
            if lanes == 0 {
                continue;
            }
            let Some(covered) = cover(s, &batch.triangles.corners, (x, y), &margins, lanes) else { continue };
            let (low, high) = (s.array(covered.low), s.array(covered.high));
            let (columns, rows) = (s.int_array(s.to_int(x)), s.int_array(s.to_int(y)));
            let mut candidates = covered.candidates;
            while candidates != 0 {
                let at = candidates.trailing_zeros() as usize;
                candidates &= candidates - 1;
                let (x, y) = (columns[at] as usize & 15, rows[at] as usize & 15);
                let (block, lane) = (y / 4 * 4 + x / 4, y % 4 * 4 + x % 4);
                if high[at] < self.low[block][lane] {
                    continue;
                }
                if covered.sure >> at & 1 != 0 && low[at] > self.high[block][lane] {
                    let place = self.place_in_batch(batch, at);
                    self.take((block, lane), place, low[at], high[at]);
                } else {
                    self.decide((block, lane), &batch.winner(at));
                }
            }
        }
    }

    /// Tests one triangle against the blocks it reaches over.
    #[inline(always)]
    fn test_large<S: Simd>(&mut self, s: S, batch: &mut Batch<'_, '_, S>, at: usize, large: &Large) {
        let corners =
            each!(3: large.corners, [x, y, w] => Projected { x: s.splat(x), y: s.splat(y), w: s.splat(w) });
        let margins = Margins { edge: s.splat(large.edge), depth: s.splat(large.depth) };
        let (columns, rows) = (batch.columns.map(|ends| ends[at]), batch.rows.map(|ends| ends[at]));
        for row in rows[0] / 4..=rows[1] / 4 {
            for column in columns[0] / 4..=columns[1] / 4 {
                let block = (row * 4 + column) as usize & 15;
                if self.depths.blocks[block] > large.near {
                    continue;
                }
                let lanes = (in_range(columns, column * 4) * 0x1111) & spread(in_range(rows, row * 4));
                let x = s.add(s.load(&COLUMNS), s.splat((column * 4) as f32));
                let y = s.add(s.load(&ROWS), s.splat((row * 4) as f32));
                let Some(covered) = cover(s, &corners, (x, y), &margins, lanes & self.present[block]) else {
                    continue;
                };
                let behind = s.lt(covered.high, s.load(&self.low[block]));
                let before = s.lt(s.load(&self.high[block]), covered.low);
                let candidates = covered.candidates & !behind;
                let wins = candidates & covered.sure & before;
                if wins != 0 {
                    let place = self.place_in_batch(batch, at);
                    s.store(s.select(wins, covered.low, s.load(&self.low[block])), &mut self.low[block]);
                    s.store(s.select(wins, covered.high, s.load(&self.high[block])), &mut self.high[block]);
                    let mut lanes = wins;
                    while lanes != 0 {
                        self.place[block][lanes.trailing_zeros() as usize & 15] = place;
                        lanes &= lanes - 1;
                    }
                    self.mark(block, wins);
                }
                let mut open = candidates & !wins;
                while open != 0 {
                    self.decide((block, open.trailing_zeros() as usize), &batch.winner(at));
                    open &= open - 1;
                }
            }
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
        let place = self.place_of(&batch.winner(at));
        batch.places[at] = Some((place, self.winners.moves));
        place
    }
}

/// A triangle that reaches over more than 2x2 pixels.
struct Large {
    corners: [[f32; 3]; 3],
    edge: f32,
    depth: f32,
    /// Its greatest inverse depth, and a little more.
    near: f32,
}

impl<S: Simd> Batch<'_, '_, S> {
    #[inline(always)]
    fn winner(&self, at: usize) -> Winner {
        let index = self.triangles.first + at;
        let cluster = self.triangles.cluster;
        Winner { corners: cluster.triangle(index), primitive: cluster.primitive(index) }
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

    #[inline(always)]
    fn test(&mut self, s: S, triangles: &Triangles<'_, S>) {
        let extent = Extent::of(s, &triangles.corners);
        let delta = s.splat(triangles.delta);
        let near = s.mul(extent.near, s.splat(1.0 + 2.0 * DEPTH_EPSILON));
        let (width, height) = (self.tile.width as f32 - 1.0, self.tile.height as f32 - 1.0);
        let zero = s.splat(0.0);
        let (left, right) =
            (s.max(s.sub(extent.left, delta), zero), s.min(s.add(extent.right, delta), s.splat(width)));
        let (top, bottom) =
            (s.max(s.sub(extent.top, delta), zero), s.min(s.add(extent.bottom, delta), s.splat(height)));
        let lanes =
            s.le(left, right) & s.le(top, bottom) & s.le(s.splat(self.depths.least), near) & triangles.lanes;
        if lanes == 0 {
            return;
        }
        // Nearly the next whole number: a pixel too many does not matter, one too few would.
        let up = s.splat(0.999_99);
        let columns = [s.to_int(s.add(left, up)), s.to_int(right)];
        let rows = [s.to_int(s.add(top, up)), s.to_int(bottom)];
        let wide = s.to_float(s.sub_int(columns[1], columns[0]));
        let high = s.to_float(s.sub_int(rows[1], rows[0]));
        let lanes = lanes & s.le(zero, wide) & s.le(zero, high);
        if lanes == 0 {
            return;
        }
        let one = s.splat(1.0);
        let small = lanes & s.le(wide, one) & s.le(high, one);
        let mut batch = Batch {
            triangles,
            extent,
            columns: each!(2: columns, end => s.int_array(end)),
            rows: each!(2: rows, end => s.int_array(end)),
            pixels: each!(4: [columns[0], columns[1], rows[0], rows[1]], end => s.to_float(end)),
            places: [None; LANES],
        };
        if small != 0 {
            self.test_small(s, &mut batch, small);
        }
        let mut large = lanes & !small;
        if large == 0 {
            return;
        }
        let corners =
            each!(3: triangles.corners, corner => [s.array(corner.x), s.array(corner.y), s.array(corner.w)]);
        let margins = extent.margins(s, triangles.delta);
        let [edge, depth, near] = each!(3: [margins.edge, margins.depth, near], value => s.array(value));
        while large != 0 {
            let at = large.trailing_zeros() as usize;
            large &= large - 1;
            let of = Large {
                corners: [0, 1, 2].map(|corner| [0, 1, 2].map(|axis: usize| corners[corner][axis][at])),
                edge: edge[at],
                depth: depth[at],
                near: near[at],
            };
            self.test_large(s, &mut batch, at, &of);
        }
    }

    fn test_by_rays(&mut self, cluster: &Cluster<'_>) {
        for block in 0..LANES {
            for lane in 0..LANES {
                if self.present[block] >> lane & 1 == 0 {
                    continue;
                }
                let mut nearest = Nearest::none(f32::INFINITY);
                cluster.intersect::<false>(&self.ray(block, lane), &mut nearest, &mut ());
                if let Some((primitive, Surface::Triangle(corners))) = nearest.surface {
                    self.decide((block, lane), &Winner { corners, primitive });
                }
            }
        }
    }
}

/// Four bits: which of the pixels `at..at + 4` lie in a range.
#[inline(always)]
const fn in_range([first, last]: [i32; 2], at: i32) -> Mask {
    let from = if first > at { first - at } else { 0 };
    let until = if last < at + 3 { last - at } else { 3 };
    (0xf << from & 0xf >> (3 - until)) as Mask
}

/// Each of four bits four times.
#[inline(always)]
const fn spread(bits: Mask) -> Mask {
    ((bits & 1) | (bits & 2) << 3 | (bits & 4) << 6 | (bits & 8) << 9) * 0xf
}

const COLUMNS: [f32; LANES] =
    [0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0];
const ROWS: [f32; LANES] = [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 3.0, 3.0, 3.0, 3.0];
