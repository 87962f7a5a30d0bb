//! The shadow samples of a tile, seen from the light: each looks for anything between itself and the light.

use glam::Vec3;

use super::edges::{Extent, Margins, cover};
use super::frustum::{Borders, Depths};
use super::projection::{DEPTH_EPSILON, Projected, Projection};
use super::walk::{Targets, Triangles};
use crate::cluster::{Cluster, Nearest};
use crate::simd::{LANES, Mask, Simd, each};
use crate::triangle_woop::WoopRay;

/// Most samples of a tile.
pub(super) const SAMPLES_MAX: usize = 256;

/// Points that light may fall on.
pub(super) struct Points {
    pub(super) x: [f32; SAMPLES_MAX],
    pub(super) y: [f32; SAMPLES_MAX],
    pub(super) z: [f32; SAMPLES_MAX],
    pub(super) count: usize,
}

/// The samples, in [`BINS`] rows of the projection plane, and among these by column.
pub(super) struct Samples<'a> {
    points: &'a Points,
    light: Vec3,
    /// Places on the plane and inverse depths; infinite once a sample is shadowed, and beyond the end.
    x: [f32; PADDED],
    y: [f32; PADDED],
    w: [f32; PADDED],
    /// Which point a sample is.
    point: [u8; SAMPLES_MAX],
    /// Where the samples of each row begin.
    row: [u16; BINS + 1],
    /// The columns of each row that hold open samples, a bit each.
    columns: [u32; BINS],
    /// The same as bits of `f32`, to be looked up.
    table: [[f32; LANES]; 2],
    pub(super) shadowed: [bool; SAMPLES_MAX],
    depths: Depths,
    /// Samples shadowed since the depths were found.
    news: u32,
    open: u32,
}

/// Rows, and columns, of the projection plane.
const BINS: usize = 32;

const PADDED: usize = SAMPLES_MAX + LANES;

impl Points {
    pub(super) const fn new() -> Self {
        Self { x: [0.0; SAMPLES_MAX], y: [0.0; SAMPLES_MAX], z: [0.0; SAMPLES_MAX], count: 0 }
    }

    #[inline(always)]
    pub(super) fn push(&mut self, [x, y, z]: [f32; 3]) {
        self.x[self.count] = x;
        self.y[self.count] = y;
        self.z[self.count] = z;
        self.count += 1;
    }

    pub(super) const fn get(&self, index: usize) -> Vec3 {
        Vec3::new(self.x[index], self.y[index], self.z[index])
    }

    /// Sixteen points from `first` on; those beyond the count repeat it.
    #[inline(always)]
    fn load<S: Simd>(&self, s: S, first: usize) -> [S::F; 3] {
        let lanes = first_lanes(self.count - first);
        each!(3: [&self.x, &self.y, &self.z], from => s.select(lanes, s.load(chunk(from, first)), s.splat(from[first])))
    }

    /// The projection in which the points fill the plane, or `None` when they are seen from the light in too wide an
    /// angle.
    #[inline(always)]
    pub(super) fn projection<S: Simd>(&self, s: S, light: Vec3) -> Option<Projection> {
        let mut sum = Vec3::ZERO;
        for index in 0..self.count {
            sum += self.get(index);
        }
        let depth = unit(sum / self.count as f32 - light)?;
        let aside = if depth.x.abs() < 0.6 { Vec3::X } else { Vec3::Y };
        let x = unit(depth.cross(aside))?;
        let y = depth.cross(x);
        let plain = Projection::new(light, [x, y, depth], 0.5, 1.0)?;
        let (mut low, mut high, mut slant) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2], 0.0_f32);
        for first in (0..self.count).step_by(LANES) {
            let Projected { x, y, w } = plain.project(s, self.load(s, first));
            if s.lt(s.splat(0.0), w) != Mask::MAX {
                return None;
            }
            low = [low[0].min(s.least(x)), low[1].min(s.least(y))];
            let [x, y] = each!(2: [x, y], value => s.sub(s.splat(0.0), value));
            high = [high[0].max(-s.least(x)), high[1].max(-s.least(y))];
        }
        slant = slant.max(low[0].abs().max(high[0].abs()) + low[1].abs().max(high[1].abs()));
        if slant > 0.75 {
            return None;
        }
        // At least so large that places on the plane can be told apart.
        let unit = [0, 1].map(|axis: usize| ((high[axis] - low[axis]) * (1.0 / 31.0)).max(UNIT_MIN));
        let rows = [(x - depth * low[0]) / unit[0], (y - depth * low[1]) / unit[1], depth];
        Projection::new(light, rows, unit[0].max(unit[1]), 1.0 + slant)
    }
}

impl<'a> Samples<'a> {
    #[inline(always)]
    pub(super) fn new<S: Simd>(s: S, points: &'a Points, projection: &Projection) -> Self {
        let mut place = [[0.0; PADDED]; 3];
        for first in (0..points.count).step_by(LANES) {
            let Projected { x, y, w } = projection.project(s, points.load(s, first));
            s.store(x, chunk_mut(&mut place[0], first));
            s.store(y, chunk_mut(&mut place[1], first));
            s.store(w, chunk_mut(&mut place[2], first));
        }
        let mut samples = Self {
            points,
            light: projection.eye,
            x: [0.0; PADDED],
            y: [0.0; PADDED],
            w: [f32::INFINITY; PADDED],
            point: [0; SAMPLES_MAX],
            row: [0; BINS + 1],
            columns: [0; BINS],
            table: [[0.0; LANES]; 2],
            shadowed: [false; SAMPLES_MAX],
            depths: Depths::new([f32::INFINITY; LANES]),
            news: 0,
            open: points.count as u32,
        };
        samples.sort(&place);
        samples.find_depths();
        samples
    }

    /// The borders of the blocks into which the plane is cut.
    pub(super) fn borders() -> [Borders; 2] {
        [Borders { first: [0.0, 8.0, 16.0, 24.0], last: [8.0, 16.0, 24.0, 32.0] }; 2]
    }

    /// Puts the samples into rows: a counting sort.
    #[inline(always)]
    fn sort(&mut self, [x, y, w]: &[[f32; PADDED]; 3]) {
        let mut count = [0_u16; BINS + 1];
        for &y in &y[..self.points.count] {
            count[bin(y) + 1] += 1;
        }
        for row in 0..BINS {
            self.row[row + 1] = self.row[row] + count[row + 1];
        }
        let mut next = self.row;
        for index in 0..self.points.count {
            let row = bin(y[index]);
            let to = usize::from(next[row]);
            next[row] += 1;
            (self.x[to], self.y[to], self.w[to]) = (x[index], y[index], w[index]);
            self.point[to] = index as u8;
            self.columns[row] |= 1 << bin(x[index]);
        }
        self.refresh_table();
    }

    fn refresh_table(&mut self) {
        for (entry, columns) in self.table.as_flattened_mut().iter_mut().zip(self.columns) {
            *entry = f32::from_bits(columns);
        }
    }

    /// Finds anew what blocks wait for.
    fn find_depths(&mut self) {
        let mut blocks = [f32::INFINITY; LANES];
        for index in 0..self.points.count {
            let block = &mut blocks[bin(self.y[index]) / 8 * 4 + bin(self.x[index]) / 8];
            if self.w[index] < *block {
                *block = self.w[index];
            }
        }
        // A sample does not see what touches it.
        self.depths = Depths::new(blocks.map(|block| block * (1.0 - DEPTH_EPSILON)));
        self.news = 0;
    }

    /// Notes that a sample lies in shadow.
    #[inline(always)]
    fn close(&mut self, index: usize) {
        if self.w[index] == f32::INFINITY {
            return;
        }
        self.w[index] = f32::INFINITY;
        self.shadowed[usize::from(self.point[index])] = true;
        self.open -= 1;
        self.news += 1;
        let row = bin(self.y[index]);
        let (first, end) = (usize::from(self.row[row]), usize::from(self.row[row + 1]));
        let open = (first..end).filter(|&at| self.w[at] < f32::INFINITY);
        self.columns[row] = open.fold(0, |columns, at| columns | 1 << bin(self.x[at]));
        self.table[row / LANES][row % LANES] = f32::from_bits(self.columns[row]);
    }

    /// The ray of a sample to the light.
    #[inline]
    fn ray(&self, index: usize) -> WoopRay {
        let point = self.points.get(usize::from(self.point[index]));
        WoopRay::new(point, self.light - point)
    }

    /// Lets the sample's ray decide whether a triangle shadows it.
    #[inline(never)]
    fn decide(&mut self, index: usize, corners: [Vec3; 3]) {
        if self.ray(index).intersect(corners, 1.0).is_some() {
            self.close(index);
        }
    }

    /// Tests one triangle against the samples of the rows that it reaches over.
    #[inline(always)]
    fn test_one<S: Simd>(&mut self, s: S, triangles: &Triangles<'_, S>, one: &One) {
        let corners =
            each!(3: one.corners, [x, y, w] => Projected { x: s.splat(x), y: s.splat(y), w: s.splat(w) });
        let margins = Margins { edge: s.splat(one.edge), depth: s.splat(one.depth) };
        let [first, last] = one.rows.map(|row| row as usize % BINS);
        let (start, end) = (usize::from(self.row[first]), usize::from(self.row[last + 1]));
        for first in (start..end).step_by(LANES) {
            let depth = s.load(chunk(&self.w, first));
            let lanes = s.lt(depth, s.splat(one.near)) & first_lanes(end - first);
            if lanes == 0 {
                continue;
            }
            let place = (s.load(chunk(&self.x, first)), s.load(chunk(&self.y, first)));
            let lanes = lanes
                & s.le(s.splat(one.columns[0]), place.0)
                & s.le(place.0, s.splat(one.columns[1]))
                & s.le(s.splat(one.heights[0]), place.1)
                & s.le(place.1, s.splat(one.heights[1]));
            if lanes == 0 {
                continue;
            }
            let Some(covered) = cover(s, &corners, place, &margins, lanes) else { continue };
            let margin = s.mul(depth, s.splat(DEPTH_EPSILON));
            let certain = covered.sure & s.lt(s.add(depth, margin), covered.low);
            let behind = s.lt(covered.high, s.sub(depth, margin));
            let mut open = covered.candidates & !behind;
            while open != 0 {
                let lane = open.trailing_zeros() as usize;
                open &= open - 1;
                if certain >> lane & 1 != 0 {
                    self.close(first + lane);
                } else {
                    self.decide(first + lane, triangles.cluster.triangle(triangles.first + one.at));
                }
            }
        }
    }
}

/// One triangle against samples.
struct One {
    corners: [[f32; 3]; 3],
    edge: f32,
    depth: f32,
    /// Its greatest inverse depth, and a little more.
    near: f32,
    /// Its box, and a little more.
    columns: [f32; 2],
    heights: [f32; 2],
    /// First and last row of bins.
    rows: [i32; 2],
    /// Its lane.
    at: usize,
}

impl<S: Simd> Targets<S> for Samples<'_> {
    #[inline(always)]
    fn depths(&mut self, _: S) -> &Depths {
        if self.news > 8 + self.open / 4 || self.open == 0 && self.news > 0 {
            self.find_depths();
        }
        &self.depths
    }

    #[inline(always)]
    fn test(&mut self, s: S, triangles: &Triangles<'_, S>) {
        let extent = Extent::of(s, &triangles.corners);
        let delta = s.splat(triangles.delta);
        let near = s.mul(extent.near, s.splat(1.0 + 4.0 * DEPTH_EPSILON));
        let (zero, end) = (s.splat(0.0), s.splat(BINS as f32 - 1.0));
        let (left, right) = (s.sub(extent.left, delta), s.add(extent.right, delta));
        let (top, bottom) = (s.sub(extent.top, delta), s.add(extent.bottom, delta));
        let lanes = s.le(left, s.splat(BINS as f32))
            & s.le(zero, right)
            & s.le(top, s.splat(BINS as f32))
            & s.le(zero, bottom)
            & s.le(s.splat(self.depths.least), near)
            & triangles.lanes;
        if lanes == 0 {
            return;
        }
        let columns = each!(2: [left, right], value => s.to_int(s.min(s.max(value, zero), end)));
        let rows = each!(2: [top, bottom], value => s.to_int(s.min(s.max(value, zero), end)));
        // The columns between the first and the last, as bits.
        let span = s.sub_int(columns[1], columns[0]);
        let bits = s.sub_int(s.shift_left(s.splat_int(2), span), s.splat_int(1));
        let between = s.min(s.add(s.to_float(rows[0]), s.splat(1.0)), s.to_float(rows[1]));
        let held = each!(3: [rows[0], s.to_int(between), rows[1]], row => s.bits(s.lookup(&self.table, row)));
        let held = s.or(s.or(held[0], held[1]), held[2]);
        let is_tall = s.lt(s.splat(2.0), s.to_float(s.sub_int(rows[1], rows[0])));
        let mut lanes = lanes & (is_tall | s.meet(s.shift_right(held, columns[0]), bits));
        if lanes == 0 {
            return;
        }
        let corners =
            each!(3: triangles.corners, corner => [s.array(corner.x), s.array(corner.y), s.array(corner.w)]);
        let margins = extent.margins(s, triangles.delta);
        let [edge, depth, near] = each!(3: [margins.edge, margins.depth, near], value => s.array(value));
        let [left, right, top, bottom] = each!(4: [left, right, top, bottom], value => s.array(value));
        let rows = each!(2: rows, row => s.int_array(row));
        while lanes != 0 {
            let at = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let one = One {
                corners: [0, 1, 2].map(|corner| [0, 1, 2].map(|axis: usize| corners[corner][axis][at])),
                edge: edge[at],
                depth: depth[at],
                near: near[at],
                columns: [left[at], right[at]],
                heights: [top[at], bottom[at]],
                rows: [rows[0][at], rows[1][at]],
                at,
            };
            self.test_one(s, triangles, &one);
        }
    }

    fn test_by_rays(&mut self, cluster: &Cluster<'_>) {
        for index in 0..self.points.count {
            if self.w[index] < f32::INFINITY {
                let mut nearest = Nearest::none(1.0);
                cluster.intersect::<true>(&self.ray(index), &mut nearest, &mut ());
                if nearest.surface.is_some() {
                    self.close(index);
                }
            }
        }
    }
}

/// The row, or column, of a place.
#[inline(always)]
fn bin(place: f32) -> usize {
    (place.max(0.0) as usize).min(BINS - 1)
}

/// Sixteen entries from `first` on.
#[inline(always)]
fn chunk<const N: usize>(from: &[f32; N], first: usize) -> &[f32; LANES] {
    // Where fewer are left, the last sixteen; no caller gets there.
    let first = first.min(N - LANES);
    from[first..].first_chunk().unwrap_or(&[0.0; LANES])
}

#[inline(always)]
fn chunk_mut<const N: usize>(to: &mut [f32; N], first: usize) -> &mut [f32; LANES] {
    let first = first.min(N - LANES);
    let (head, _) = to[first..].split_at_mut(LANES);
    head.try_into().expect("sixteen entries")
}

#[inline(always)]
const fn first_lanes(count: usize) -> Mask {
    if count >= LANES { Mask::MAX } else { (1 << count) - 1 }
}

fn unit(v: Vec3) -> Option<Vec3> {
    let length = libm::sqrtf(v.dot(v));
    (length.is_finite() && length > 1.0e-18).then(|| v / length)
}

/// Smallest unit, as an angle.
const UNIT_MIN: f32 = 1.0 / 8192.0;
