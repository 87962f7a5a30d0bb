//! The shadow samples of a tile, seen from the light: each looks for anything between itself and the light.

use glam::Vec3;

use super::edges::{Extent, Margins, cover};
use super::frustum::{Borders, Depths};
use super::projection::{Projected, Projection};
use super::walk::{Bounds, Targets, Triangles};
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

/// The samples, sorted into 8x8 *bins* of the projection plane.
pub(super) struct Samples<'a> {
    points: &'a Points,
    light: Vec3,
    /// Places on the plane and inverse depths; infinite once a sample is shadowed, and beyond the end.
    x: [f32; PADDED],
    y: [f32; PADDED],
    w: [f32; PADDED],
    /// Which point a sample is.
    point: [u8; SAMPLES_MAX],
    /// Where the samples of each bin begin, row by row.
    bin: [u16; BINS * BINS + 1],
    /// Bins that hold open samples, a bit each.
    open_bins: u64,
    pub(super) shadowed: [bool; SAMPLES_MAX],
    depths: Depths,
    /// Samples shadowed since the depths were found.
    news: u32,
    open: u32,
}

/// Rows of bins, and columns; a bin is one unit wide and high.
const BINS: usize = 8;

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
        let infinite = s.splat(f32::INFINITY);
        let (mut low, mut high) = ([infinite; 2], [infinite; 2]);
        for first in (0..self.count).step_by(LANES) {
            let Projected { x, y, w } = plain.project(s, self.load(s, first));
            if s.lt(s.splat(0.0), w) != Mask::MAX {
                return None;
            }
            low = [s.min(low[0], x), s.min(low[1], y)];
            let [x, y] = each!(2: [x, y], value => s.sub(s.splat(0.0), value));
            high = [s.min(high[0], x), s.min(high[1], y)];
        }
        let low = each!(2: low, value => s.least(value));
        let high = each!(2: high, value => -s.least(value));
        let slant = low[0].abs().max(high[0].abs()) + low[1].abs().max(high[1].abs());
        if slant > 0.75 {
            return None;
        }
        // At least so large that places on the plane can be told apart.
        let unit = [0, 1].map(|axis: usize| ((high[axis] - low[axis]) * (1.0 / 7.875)).max(UNIT_MIN));
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
            bin: [0; BINS * BINS + 1],
            open_bins: 0,
            shadowed: [false; SAMPLES_MAX],
            depths: Depths::new([f32::INFINITY; LANES]),
            news: 0,
            open: points.count as u32,
        };
        samples.sort(&place);
        samples.find_depths();
        samples
    }

    /// The borders of the blocks into which the plane is cut: two bins each.
    pub(super) fn borders() -> [Borders; 2] {
        [Borders { first: [0.0, 2.0, 4.0, 6.0], last: [2.0, 4.0, 6.0, 8.0] }; 2]
    }

    /// Puts the samples into bins: a counting sort.
    #[inline(always)]
    fn sort(&mut self, [x, y, w]: &[[f32; PADDED]; 3]) {
        let mut bins = [0_u8; SAMPLES_MAX];
        let mut count = [0_u16; BINS * BINS];
        for index in 0..self.points.count {
            let bin = bin(x[index], y[index]);
            bins[index] = bin as u8;
            count[bin] += 1;
        }
        for bin in 0..BINS * BINS {
            self.bin[bin + 1] = self.bin[bin] + count[bin];
            self.open_bins |= u64::from(count[bin] > 0) << bin;
        }
        let mut next = self.bin;
        for index in 0..self.points.count {
            let next = &mut next[usize::from(bins[index])];
            let to = usize::from(*next);
            *next += 1;
            (self.x[to], self.y[to], self.w[to]) = (x[index], y[index], w[index]);
            self.point[to] = index as u8;
        }
    }

    /// Finds anew what blocks wait for.
    #[inline(always)]
    fn find_depths(&mut self) {
        let mut blocks = [f32::INFINITY; LANES];
        let mut bins = self.open_bins;
        while bins != 0 {
            let bin = bins.trailing_zeros() as usize;
            bins &= bins - 1;
            let block = &mut blocks[bin / 16 * 4 + bin % 8 / 2];
            for &w in &self.w[usize::from(self.bin[bin])..usize::from(self.bin[bin + 1])] {
                *block = if w < *block { w } else { *block };
            }
        }
        self.depths = Depths::new(blocks);
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
        let bin = bin(self.x[index], self.y[index]);
        let of_bin = &self.w[usize::from(self.bin[bin])..usize::from(self.bin[bin + 1])];
        if of_bin.iter().all(|&w| w == f32::INFINITY) {
            self.open_bins &= !(1 << bin);
        }
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

    /// Tests a sample against the triangles in whose box it lies.
    #[inline(always)]
    fn test_sample<S: Simd>(
        &mut self,
        s: S,
        index: usize,
        triangles: &Triangles<'_, S>,
        margins: &Margins<S::F>,
        lanes: Mask,
    ) {
        let place = (s.splat(self.x[index]), s.splat(self.y[index]));
        let Some(covered) = cover(s, triangles, place, margins, lanes) else { return };
        let depth = s.splat(self.w[index]);
        let candidates = covered.candidates & s.le(depth, covered.high);
        if candidates & covered.sure & s.lt(depth, covered.low) != 0 {
            self.close(index);
            return;
        }
        let mut open = candidates;
        while open != 0 && self.w[index] < f32::INFINITY {
            let lane = open.trailing_zeros() as usize;
            open &= open - 1;
            self.decide(index, triangles.cluster.triangle(triangles.first + lane));
        }
    }
}

impl<S: Simd> Targets<S> for Samples<'_> {
    #[inline(always)]
    fn depths(&mut self, _: S) -> &Depths {
        if self.news > 8 + self.open / 4 || self.open == 0 && self.news > 0 {
            self.find_depths();
        }
        &self.depths
    }

    /// The open bins that the cluster reaches over.
    #[inline(always)]
    fn interest(&mut self, _: S, bounds: &Bounds) -> u64 {
        if bounds.near < self.depths.least {
            return 0;
        }
        let (Some((left, right)), Some((top, bottom))) =
            (lines(bounds.left, bounds.right), lines(bounds.top, bounds.bottom))
        else {
            return 0;
        };
        let columns = (0xff >> (BINS - 1 - (right - left)) << left) * 0x0101_0101_0101_0101;
        let rows = u64::MAX >> (BINS * (BINS - 1 - (bottom - top))) << (BINS * top);
        self.open_bins & rows & columns
    }

    #[inline(always)]
    fn test(&mut self, s: S, triangles: &Triangles<'_, S>) {
        let extent = Extent::of(s, &triangles.corners);
        let delta = s.splat(triangles.delta);
        let near = s.mul(extent.near, s.splat(1.0 + triangles.depth_epsilon));
        let (left, right) = (s.sub(extent.left, delta), s.add(extent.right, delta));
        let (top, bottom) = (s.sub(extent.top, delta), s.add(extent.bottom, delta));
        let margins = extent.margins(s, triangles.delta);
        let mut bins = triangles.interest & self.open_bins;
        while bins != 0 {
            let bin = bins.trailing_zeros() as usize % (BINS * BINS);
            bins &= bins - 1;
            for index in usize::from(self.bin[bin])..usize::from(self.bin[bin + 1]) {
                let (x, y) = (s.splat(self.x[index]), s.splat(self.y[index]));
                let lanes = s.le(left, x)
                    & s.le(x, right)
                    & s.le(top, y)
                    & s.le(y, bottom)
                    & s.lt(s.splat(self.w[index]), near)
                    & triangles.lanes;
                if lanes != 0 {
                    self.test_sample(s, index, triangles, &margins, lanes);
                }
            }
        }
    }

    fn test_by_rays(&mut self, cluster: &Cluster<'_>) {
        for index in 0..self.points.count {
            if self.w[index] < f32::INFINITY {
                let mut nearest = Nearest::none(1.0);
                cluster.intersect::<true>(&self.ray(index), &mut nearest, &mut ());
                if nearest.triangle.is_some() {
                    self.close(index);
                }
            }
        }
    }
}

/// The first and last row, or column, from one place to another.
#[inline(always)]
fn lines(first: f32, last: f32) -> Option<(usize, usize)> {
    (last >= 0.0 && first <= BINS as f32).then(|| (line(first), line(last)))
}

/// The bin of a place.
#[inline(always)]
fn bin(x: f32, y: f32) -> usize {
    line(y) * BINS + line(x)
}

/// The row, or column, of a place.
#[inline(always)]
fn line(place: f32) -> usize {
    place.max(0.0).min(BINS as f32 - 1.0) as usize
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
const UNIT_MIN: f32 = 1.0 / 2048.0;
