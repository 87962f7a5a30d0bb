//! The triangles of a cluster against the pixels of a tile.
//!
//! Sixteen triangles at a time are held against the grid of pixels; most miss every one. What is left is written down, so
//! that what follows has full lanes and few branches: small triangles with each pixel that they may cover, tested as
//! *pairs*, sixteen at a time; middling ones with each block of pixels that they may reach over, sixteen pairs of which are
//! sifted at a time, and those that do tested one by one against sixteen pixels; large ones one by one.

use super::edges::{Edges, Extent};
use super::pixels::{COLUMNS, Pixels, ROWS, lanes_in};
use super::triangles::{Corners, Triangles};
use crate::blocks::{BLOCKS, block_at, first_pixel};
use crate::grid::TRIANGLES_MAX;
use crate::kinds::Kinds;
use crate::memory::SceneMemory;
use crate::simd::{LANES, Mask, Simd, each, first_lanes};
use crate::tile::TILE_SIZE;

/// Triangles that need a closer look, by name.
pub(super) struct Lists {
    /// Small ones. Added is which of their up to four pixels is meant, times [`Corners::COUNT`]: 1 for the right, 2 for the
    /// lower.
    small: [f32; 4 * TRIANGLES_MAX as usize + LANES],
    small_count: usize,
    /// Middling ones. Added is which of their up to four blocks is meant, in the same way.
    middling: [f32; 4 * TRIANGLES_MAX as usize + LANES],
    middling_count: usize,
    large: [f32; TRIANGLES_MAX as usize + LANES],
    large_count: usize,
}

/// First and last column and row of pixels that each triangle may cover.
struct Reach<F> {
    left: F,
    right: F,
    top: F,
    bottom: F,
}

impl Lists {
    pub(super) const fn new() -> Self {
        Self {
            small: [0.0; 4 * TRIANGLES_MAX as usize + LANES],
            small_count: 0,
            middling: [0.0; 4 * TRIANGLES_MAX as usize + LANES],
            middling_count: 0,
            large: [0.0; TRIANGLES_MAX as usize + LANES],
            large_count: 0,
        }
    }
}

impl<F: Copy> Reach<F> {
    #[inline(always)]
    fn of<S: Simd<F = F>, M, K>(s: S, pixels: &Pixels<'_, M, K>, extent: &Extent<F>, delta: f32) -> Self {
        let delta = s.splat(delta);
        Self {
            left: first_place(s, s.sub(extent.left, delta)),
            right: last_place(s, s.add(extent.right, delta), pixels.tile.width),
            top: first_place(s, s.sub(extent.top, delta)),
            bottom: last_place(s, s.add(extent.bottom, delta), pixels.tile.height),
        }
    }

    /// How many columns and rows of blocks lie between the first and the last.
    #[inline(always)]
    fn blocks<S: Simd<F = F>>(&self, s: S) -> [F; 2] {
        each!(2: [(self.left, self.right), (self.top, self.bottom)], (first, last) => {
            s.sub(block_of(s, last), block_of(s, first))
        })
    }
}

impl<F: Copy> Reach<F> {
    /// The pixels of a block that lie in the columns, and those that lie in the rows, reached over. The block, in this
    /// column and row of blocks, is one that is reached over.
    #[inline(always)]
    fn within_blocks<S: Simd<F = F>>(&self, s: S, [column, row]: [F; 2]) -> [[i32; LANES]; 2] {
        let four = s.splat(4.0);
        let [columns, rows] = each!(2: [(self.left, self.right, column), (self.top, self.bottom, row)], (first, last, block) => {
            let from = s.mul(block, four);
            let first = s.max(s.sub(first, from), s.splat(0.0));
            let last = s.min(s.sub(last, from), s.splat(3.0));
            s.to_int(s.add(s.mul(first, four), last))
        });
        each!(2: [(&WITHIN[0], columns), (&WITHIN[1], rows)], (table, range) => {
            s.int_array(s.to_int(s.lookup(table, range)))
        })
    }
}

/// The column, or row, of blocks that a column, or row, of pixels is in.
#[inline(always)]
fn block_of<S: Simd>(s: S, place: S::F) -> S::F {
    s.to_float(s.to_int(s.mul(place, s.splat(0.25))))
}

/// Lanes that have a first, a right, a lower, and a lower right one of four.
#[inline(always)]
const fn quarters(lanes: Mask, is_wide: Mask, is_high: Mask) -> [Mask; 4] {
    [lanes, lanes & is_wide, lanes & is_high, lanes & is_wide & is_high]
}

/// The names of triangles, with which of four is meant added.
#[inline(always)]
fn meant<S: Simd>(s: S, names: S::F, which: usize) -> S::F {
    s.add(names, s.splat((which as u32 * Corners::COUNT) as f32))
}

/// Steps to the right and down from the first of four to that which is meant.
#[inline(always)]
fn steps<S: Simd>(s: S, names: S::I) -> [S::F; 2] {
    let (zero, one, two) = (s.splat(0.0), s.splat(1.0), s.splat(2.0));
    let which = s.to_float(s.shift_right::<15>(names));
    let is_lower = s.le(two, which);
    [s.sub(which, s.select(is_lower, two, zero)), s.select(is_lower, one, zero)]
}

/// The first pixel that does not lie before a place.
#[inline(always)]
pub(super) fn first_place<S: Simd>(s: S, place: S::F) -> S::F {
    let place = s.min(s.max(place, s.splat(0.0)), s.splat(2.0 * TILE_SIZE as f32));
    // Nearly the next whole number: a pixel too many does not matter, one too few would.
    s.to_float(s.to_int(s.add(place, s.splat(0.999_99))))
}

/// The last pixel that does not lie behind a place, or -1.
#[inline(always)]
pub(super) fn last_place<S: Simd>(s: S, place: S::F, length: u32) -> S::F {
    let place = s.max(s.min(place, s.splat(length as f32 - 1.0)), s.splat(-1.0));
    // One more, cut off, one less: cutting off goes towards 0.
    let next = s.to_float(s.to_int(s.add(place, s.splat(1.0))));
    s.sub(next, s.splat(1.0))
}

impl<M: SceneMemory, K: Kinds> Pixels<'_, M, K> {
    /// Tests the triangles of a cluster.
    #[inline(always)]
    pub(super) fn test_triangles<S: Simd>(&mut self, s: S, triangles: &Triangles<'_, S>) {
        if self.is_outside(&triangles.bounds) {
            return;
        }
        self.list(s, triangles);
        self.begin(triangles.cluster.place());
        self.test_small(s, triangles);
        if self.lists.large_count > 0 {
            self.list_middling(s, triangles);
            self.test_middling(s, triangles);
            self.test_large(s, triangles);
        }
    }

    /// Lists the triangles that reach over pixels.
    #[inline(always)]
    fn list<S: Simd>(&mut self, s: S, triangles: &Triangles<'_, S>) {
        let (zero, one, two) = (s.splat(0.0), s.splat(1.0), s.splat(2.0));
        let nearer = 1.0 + triangles.depth_epsilon;
        let (mut small_count, mut large_count) = (0, 0);
        for first in (0..triangles.count()).step_by(LANES) {
            let batch = triangles.batch(s, first);
            let extent = Extent::of(s, &batch.corners);
            let reach = Reach::of(s, self, &extent, triangles.delta);
            let wide = s.sub(reach.right, reach.left);
            let high = s.sub(reach.bottom, reach.top);
            let lanes = s.le(zero, wide)
                & s.le(zero, high)
                & s.le(s.splat(self.least), s.mul(extent.near, s.splat(nearer)))
                & batch.lanes;
            let small = lanes & s.lt(wide, two) & s.lt(high, two);
            for (which, lanes) in quarters(small, s.le(one, wide), s.le(one, high)).into_iter().enumerate() {
                pack(s, lanes, meant(s, batch.names, which), &mut self.lists.small, &mut small_count);
            }
            pack(s, lanes & !small, batch.names, &mut self.lists.large, &mut large_count);
        }
        (self.lists.small_count, self.lists.large_count) = (small_count, large_count);
    }

    /// Lists the blocks of middling triangles, of up to 2x2 blocks, among the larger ones. Leaves the others.
    #[inline(always)]
    fn list_middling<S: Simd>(&mut self, s: S, triangles: &Triangles<'_, S>) {
        let (one, two) = (s.splat(1.0), s.splat(2.0));
        let (count, mut middling_count, mut large_count) = (self.lists.large_count, 0, 0);
        for first in (0..count).step_by(LANES) {
            let names = s.load(chunk(&self.lists.large, first));
            let extent = Extent::of(s, &triangles.named(s, s.to_int(names)));
            let [columns, rows] = Reach::of(s, self, &extent, triangles.delta).blocks(s);
            let lanes = first_lanes(count - first);
            let middling = lanes & s.lt(columns, two) & s.lt(rows, two);
            for (which, lanes) in
                quarters(middling, s.le(one, columns), s.le(one, rows)).into_iter().enumerate()
            {
                pack(s, lanes, meant(s, names, which), &mut self.lists.middling, &mut middling_count);
            }
            // Not beyond what has been read.
            pack(s, lanes & !middling, names, &mut self.lists.large, &mut large_count);
        }
        (self.lists.middling_count, self.lists.large_count) = (middling_count, large_count);
    }

    /// Tests triangles that reach over at most 2x2 pixels.
    #[inline(always)]
    fn test_small<S: Simd>(&mut self, s: S, triangles: &Triangles<'_, S>) {
        let count = self.lists.small_count;
        for first in (0..count).step_by(LANES) {
            let names = s.to_int(s.load(chunk(&self.lists.small, first)));
            let corners = triangles.named(s, names);
            let extent = Extent::of(s, &corners);
            let edges = extent.edges(s, &corners, triangles.delta);
            let reach = Reach::of(s, self, &extent, triangles.delta);
            let [right, down] = steps(s, names);
            let (x, y) = (s.add(reach.left, right), s.add(reach.top, down));
            let covered = edges.cover(s, (x, y), triangles.depth_epsilon);
            let places = [s.lookup(&PLACES[0], s.to_int(x)), s.lookup(&PLACES[1], s.to_int(y))];
            let pixels = s.int_array(s.to_int(s.add(places[0], places[1])));
            let names = s.int_array(names);
            let (low, high) = (s.array(covered.low), s.array(covered.high));
            let mut candidates = covered.candidates & first_lanes(count - first);
            while candidates != 0 {
                let at = candidates.trailing_zeros() as usize;
                candidates &= candidates - 1;
                let corners = Corners::of(names[at] as u32);
                let pixel = pixels[at] as usize;
                let pixel = (pixel / LANES % BLOCKS, pixel % LANES);
                let found = &self.blocks[pixel.0];
                if high[at] < found.low[pixel.1] {
                    continue;
                }
                if covered.sure >> at & 1 != 0 && low[at] > found.high[pixel.1] {
                    self.take(pixel, corners, low[at], high[at]);
                } else {
                    self.decide(pixel, triangles.cluster, corners);
                }
            }
        }
    }

    /// Tests triangles that reach over more pixels, but at most 2x2 blocks.
    #[inline(always)]
    fn test_middling<S: Simd>(&mut self, s: S, triangles: &Triangles<'_, S>) {
        let count = self.lists.middling_count;
        for first in (0..count).step_by(LANES) {
            let names = s.to_int(s.load(chunk(&self.lists.middling, first)));
            let corners = triangles.named(s, names);
            let extent = Extent::of(s, &corners);
            let edges = extent.edges(s, &corners, triangles.delta);
            let reach = Reach::of(s, self, &extent, triangles.delta);
            let [right, down] = steps(s, names);
            let column = s.add(block_of(s, reach.left), right);
            let row = s.add(block_of(s, reach.top), down);
            let blocks = s.to_int(s.add(column, s.mul(row, s.splat(8.0))));
            let near = s.mul(extent.near, s.splat(1.0 + triangles.depth_epsilon));
            let mut left = s.le(s.gather(&self.waiting, blocks), near)
                & edges.may_cover_block(s, [column, row])
                & first_lanes(count - first);
            let edges = edges.by_lane(s);
            let [columns, rows] = reach.within_blocks(s, [column, row]);
            let (names, blocks) = (s.int_array(names), s.int_array(blocks));
            while left != 0 {
                let at = left.trailing_zeros() as usize;
                left &= left - 1;
                let (block, within) = (blocks[at] as usize % BLOCKS, (columns[at] & rows[at]) as Mask);
                let corners = Corners::of(names[at] as u32);
                self.test_block(s, triangles, (&edges.splat(s, at), corners), (block, within));
            }
        }
    }

    /// Tests triangles that reach over even more, one at a time, against the blocks they reach over.
    #[inline(always)]
    fn test_large<S: Simd>(&mut self, s: S, triangles: &Triangles<'_, S>) {
        for first in (0..self.lists.large_count).step_by(LANES) {
            let names = s.to_int(s.load(chunk(&self.lists.large, first)));
            let corners = triangles.named(s, names);
            let extent = Extent::of(s, &corners);
            let edges = extent.edges(s, &corners, triangles.delta).by_lane(s);
            let reach = Reach::of(s, self, &extent, triangles.delta);
            let near = s.array(s.mul(extent.near, s.splat(1.0 + triangles.depth_epsilon)));
            let [left, right, top, bottom] = each!(4: [reach.left, reach.right, reach.top, reach.bottom], end => s.int_array(s.to_int(end)));
            let names = s.int_array(names);
            for at in 0..LANES.min(self.lists.large_count - first) {
                let one = edges.splat(s, at);
                let corners = Corners::of(names[at] as u32);
                for row in top[at] / 4..=bottom[at] / 4 {
                    for column in left[at] / 4..=right[at] / 4 {
                        let block = block_at(column as usize, row as usize);
                        if self.waiting[block] <= near[at] {
                            let (columns, rows) = ((left[at], right[at]), (top[at], bottom[at]));
                            let within = lanes_in(columns, rows, (column * 4, row * 4));
                            self.test_block(s, triangles, (&one, corners), (block, within));
                        }
                    }
                }
            }
        }
    }

    /// Tests one triangle, in all lanes, against pixels of a block.
    #[inline(always)]
    fn test_block<S: Simd>(
        &mut self,
        s: S,
        triangles: &Triangles<'_, S>,
        (one, corners): (&Edges<S::F>, Corners),
        (block, within): (usize, Mask),
    ) {
        let (x, y) = first_pixel(block);
        let (x, y) = (s.add(s.load(&COLUMNS), s.splat(x as f32)), s.add(s.load(&ROWS), s.splat(y as f32)));
        let covered = one.cover(s, (x, y), triangles.depth_epsilon);
        let mut open = self.settle(s, &covered, corners, (block, within));
        while open != 0 {
            self.decide((block, open.trailing_zeros() as usize), triangles.cluster, corners);
            open &= open - 1;
        }
    }
}

/// Adds the lanes of the mask to a list.
#[inline(always)]
pub(super) fn pack<S: Simd, const N: usize>(
    s: S,
    lanes: Mask,
    values: S::F,
    list: &mut [f32; N],
    count: &mut usize,
) {
    if let Some(to) = list.get_mut(*count..).and_then(<[f32]>::first_chunk_mut) {
        s.store_packed(lanes, values, to);
    }
    *count += lanes.count_ones() as usize;
}

/// Sixteen entries from `first` on.
#[inline(always)]
pub(super) fn chunk<const N: usize>(list: &[f32; N], first: usize) -> &[f32; LANES] {
    // Lists end before the last sixteen.
    let first = first.min(N - LANES);
    list[first..].first_chunk().unwrap_or(&[0.0; LANES])
}

/// What a column, and a row, add to the number of a pixel, which is that of its block times sixteen plus its lane.
pub(super) const PLACES: [[[f32; LANES]; 2]; 2] = {
    let mut places = [[[0.0; LANES]; 2]; 2];
    let mut at = 0;
    while at < 2 * LANES {
        places[0][at / LANES][at % LANES] = (block_at(at / 4, 0) * LANES + at % 4) as f32;
        places[1][at / LANES][at % LANES] = (block_at(0, at / 4) * LANES + at % 4 * 4) as f32;
        at += 1;
    }
    places
};

/// The pixels of a block from one column, or row, to another: at four times the first plus the last.
const WITHIN: [[[f32; LANES]; 2]; 2] = {
    let mut within = [[[0.0; LANES]; 2]; 2];
    let mut at = 0;
    while at < LANES {
        let (first, last) = ((at / 4) as i32, (at % 4) as i32);
        within[0][0][at] = lanes_in((first, last), (0, 3), (0, 0)) as f32;
        within[1][0][at] = lanes_in((0, 3), (first, last), (0, 0)) as f32;
        at += 1;
    }
    within
};
