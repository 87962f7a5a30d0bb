//! The spheres of a cluster against the pixels of a tile.
//!
//! As for triangles: sixteen spheres at a time are held against the grid of pixels. Small ones are tested with each pixel
//! that they may cover, as *pairs*, sixteen at a time; larger ones, one by one, against blocks of sixteen pixels.

use super::boxes::Boxes;
use super::pixel_tests::{PLACES, chunk, first_place, last_place, pack};
use super::pixels::{COLUMNS, Pixels, ROWS, lanes_in};
use super::projection::Projection;
use super::sphere_cover::Outline;
use super::spheres::{AllBalls, Balls, name_of};
use super::surface::directions_at;
use super::triangles::Corners;
use crate::blocks::{BLOCKS, block_at, first_pixel};
use crate::grid::SPHERES_MAX;
use crate::kinds::Kinds;
use crate::memory::SceneMemory;
use crate::simd::{LANES, Mask, Simd, each, first_lanes};
use crate::sphere::SphereCluster;
use crate::surface::Surface;

/// First and last column and row of pixels that each sphere may cover.
struct Reach<F> {
    left: F,
    right: F,
    top: F,
    bottom: F,
}

/// Pairs of a small sphere and a pixel: the number of the sphere, and column and row of the pixel.
struct Pairs {
    names: [f32; CAPACITY],
    x: [f32; CAPACITY],
    y: [f32; CAPACITY],
    count: usize,
}

/// Up to four pixels for each sphere.
const CAPACITY: usize = 4 * SPHERES_MAX as usize + LANES;

impl<F: Copy> Reach<F> {
    #[inline(always)]
    fn of<S: Simd<F = F>, M, K>(s: S, pixels: &Pixels<'_, M, K>, boxes: &Boxes<F>) -> Self {
        Self {
            left: first_place(s, boxes.left),
            right: last_place(s, boxes.right, pixels.tile.width),
            top: first_place(s, boxes.top),
            bottom: last_place(s, boxes.bottom, pixels.tile.height),
        }
    }
}

impl Pairs {
    /// Adds the lanes of the mask.
    #[inline(always)]
    fn add<S: Simd>(&mut self, s: S, lanes: Mask, first: usize, (x, y): (S::F, S::F)) {
        let names = s.add(s.load(&NUMBERS), s.splat(first as f32));
        let mut count = self.count;
        for (list, values) in [(&mut self.names, names), (&mut self.x, x), (&mut self.y, y)] {
            count = self.count;
            pack(s, lanes, values, list, &mut count);
        }
        self.count = count;
    }
}

impl<M: SceneMemory, K: Kinds> Pixels<'_, M, K> {
    /// Tests the spheres of a cluster.
    #[inline(always)]
    pub(super) fn test_cluster_of_spheres<S: Simd>(
        &mut self,
        s: S,
        projection: &Projection,
        cluster: &SphereCluster<'_>,
    ) {
        self.begin(&name_of(cluster.place()));
        let all = AllBalls::of(s, cluster);
        let mut pairs = Pairs { names: [0.0; CAPACITY], x: [0.0; CAPACITY], y: [0.0; CAPACITY], count: 0 };
        let one = s.splat(1.0);
        let mut half = 0;
        while half * LANES < all.count {
            let (balls, lanes) = all.half(s, half);
            let boxes = projection.boxes_of_balls(s, balls.from(s, self.eye), balls.radius);
            let lanes = lanes & projection.shows(s, &boxes, self.least);
            let reach = Reach::of(s, self, &boxes);
            let (wide, high) = (s.sub(reach.right, reach.left), s.sub(reach.bottom, reach.top));
            let lanes = lanes & s.le(s.splat(0.0), wide) & s.le(s.splat(0.0), high);
            let lanes = self.seen.new_ones(cluster, half, lanes);
            let small = lanes & s.le(wide, one) & s.le(high, one);
            let (x, y) = ([reach.left, reach.right], [reach.top, reach.bottom]);
            let (wide, high) = (s.le(one, wide) & small, s.le(one, high) & small);
            pairs.add(s, small, half * LANES, (x[0], y[0]));
            if wide | high != 0 {
                pairs.add(s, wide, half * LANES, (x[1], y[0]));
                pairs.add(s, high, half * LANES, (x[0], y[1]));
                pairs.add(s, wide & high, half * LANES, (x[1], y[1]));
            }
            if lanes & !small != 0 {
                self.test_large_spheres(s, cluster, (balls, half, lanes & !small), (&reach, boxes.near));
            }
            half += 1;
        }
        self.test_pairs(s, cluster, &all, &pairs);
    }

    /// Tests spheres one at a time, against the blocks they reach over.
    #[inline(always)]
    fn test_large_spheres<S: Simd>(
        &mut self,
        s: S,
        cluster: &SphereCluster<'_>,
        (balls, half, lanes): (&Balls<S::F>, usize, Mask),
        (reach, near): (&Reach<S::F>, S::F),
    ) {
        let near = s.array(near);
        let [left, right, top, bottom] =
            each!(4: [reach.left, reach.right, reach.top, reach.bottom], end => s.int_array(s.to_int(end)));
        let [x, y, z] = each!(3: balls.from(s, self.eye), value => s.array(value));
        let radius = s.array(balls.radius);
        let mut left_over = lanes;
        while left_over != 0 {
            let at = left_over.trailing_zeros() as usize;
            left_over &= left_over - 1;
            let centre = [s.splat(x[at]), s.splat(y[at]), s.splat(z[at])];
            let one = Outline::new(s, centre, s.splat(radius[at]));
            for row in top[at] / 4..=bottom[at] / 4 {
                for column in left[at] / 4..=right[at] / 4 {
                    let block = block_at(column as usize, row as usize);
                    if self.waiting[block] <= near[at] {
                        let (columns, rows) = ((left[at], right[at]), (top[at], bottom[at]));
                        let within = lanes_in(columns, rows, (column * 4, row * 4));
                        self.test_sphere_in_block(s, (&one, cluster, half * LANES + at), (block, within));
                    }
                }
            }
        }
    }

    /// Tests one sphere, in all lanes, against pixels of a block.
    #[inline(always)]
    fn test_sphere_in_block<S: Simd>(
        &mut self,
        s: S,
        (one, cluster, index): (&Outline<S::F>, &SphereCluster<'_>, usize),
        (block, within): (usize, Mask),
    ) {
        let (x, y) = first_pixel(block);
        let (x, y) = (s.add(s.load(&COLUMNS), s.splat(x as f32)), s.add(s.load(&ROWS), s.splat(y as f32)));
        let covered = one.cover(s, self.directions(s, (x, y)));
        let name = Corners::of(index as u32);
        let mut open = self.settle(s, &covered, name, (block, within));
        while open != 0 {
            let pixel = (block, open.trailing_zeros() as usize);
            self.decide_between(pixel, Surface::Sphere(cluster.sphere(index)), name);
            open &= open - 1;
        }
    }

    /// Tests pairs.
    #[inline(always)]
    fn test_pairs<S: Simd>(
        &mut self,
        s: S,
        cluster: &SphereCluster<'_>,
        all: &AllBalls<S::F>,
        pairs: &Pairs,
    ) {
        for first in (0..pairs.count).step_by(LANES) {
            let names = s.to_int(s.load(chunk(&pairs.names, first)));
            let (x, y) = (s.load(chunk(&pairs.x, first)), s.load(chunk(&pairs.y, first)));
            let balls = all.named(s, names);
            let outline = Outline::new(s, balls.from(s, self.eye), balls.radius);
            let covered = outline.cover(s, self.directions(s, (x, y)));
            let places = [s.lookup(&PLACES[0], s.to_int(x)), s.lookup(&PLACES[1], s.to_int(y))];
            let pixels = s.int_array(s.to_int(s.add(places[0], places[1])));
            let names = s.int_array(names);
            let (low, high) = (s.array(covered.low), s.array(covered.high));
            let mut candidates = covered.candidates & first_lanes(pairs.count - first);
            while candidates != 0 {
                let at = candidates.trailing_zeros() as usize;
                candidates &= candidates - 1;
                let pixel = (pixels[at] as usize / LANES % BLOCKS, pixels[at] as usize % LANES);
                let found = &self.blocks[pixel.0];
                if high[at] < found.low[pixel.1] {
                    continue;
                }
                let name = Corners::of(names[at] as u32);
                if covered.sure >> at & 1 != 0 && low[at] > found.high[pixel.1] {
                    self.take(pixel, name, low[at], high[at]);
                } else {
                    self.decide_between(pixel, Surface::Sphere(cluster.sphere(names[at] as usize)), name);
                }
            }
        }
    }

    /// Directions of the rays of pixels of the tile.
    #[inline(always)]
    pub(super) fn directions<S: Simd>(&self, s: S, (x, y): (S::F, S::F)) -> [S::F; 3] {
        let (x, y) = (s.add(x, s.splat(self.tile.x as f32)), s.add(y, s.splat(self.tile.y as f32)));
        directions_at(s, self.camera, x, y)
    }
}

/// Numbers of lanes.
pub(super) const NUMBERS: [f32; LANES] =
    [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0];
