//! The points of a tile that light may fall on, and the plane on which the light sees them.

use glam::Vec3;

use super::projection::{Projected, Projection};
use crate::blocks::BLOCKS;
use crate::simd::{LANES, Mask, Simd, each, first_lanes};

/// Most points of a tile.
pub(super) const POINTS_MAX: usize = BLOCKS * LANES;

/// Points that light may fall on. There is room for sixteen more than there can be, since whole registers are stored.
pub(super) struct Points {
    x: [f32; POINTS_MAX + LANES],
    y: [f32; POINTS_MAX + LANES],
    z: [f32; POINTS_MAX + LANES],
    pub(super) count: usize,
}

impl Points {
    pub(super) const fn new() -> Self {
        const NONE: [f32; POINTS_MAX + LANES] = [0.0; POINTS_MAX + LANES];
        Self { x: NONE, y: NONE, z: NONE, count: 0 }
    }

    /// Adds the points of the lanes of a mask.
    #[inline(always)]
    pub(super) fn push<S: Simd>(&mut self, s: S, lanes: Mask, point: [S::F; 3]) {
        for (to, value) in [&mut self.x, &mut self.y, &mut self.z].into_iter().zip(point) {
            if let Some(to) = to.get_mut(self.count..).and_then(<[f32]>::first_chunk_mut) {
                s.store_packed(lanes, value, to);
            }
        }
        self.count += lanes.count_ones() as usize;
    }

    pub(super) const fn get(&self, index: usize) -> Vec3 {
        Vec3::new(self.x[index], self.y[index], self.z[index])
    }

    /// Points by number.
    #[inline(always)]
    pub(super) fn numbered<S: Simd>(&self, s: S, numbers: S::I) -> [S::F; 3] {
        each!(3: [&self.x, &self.y, &self.z], from => {
            s.gather(from.first_chunk::<POINTS_MAX>().unwrap_or(&[0.0; POINTS_MAX]), numbers)
        })
    }

    /// Sixteen points from `first` on; those beyond the count repeat it.
    #[inline(always)]
    pub(super) fn load<S: Simd>(&self, s: S, first: usize) -> [S::F; 3] {
        let lanes = first_lanes(self.count - first);
        each!(3: [&self.x, &self.y, &self.z], from => s.select(lanes, s.load(chunk(from, first)), s.splat(from[first])))
    }

    /// The projection in which the points fill the plane, or `None` when they are seen from the light in too wide an
    /// angle.
    #[inline(always)]
    pub(super) fn projection<S: Simd>(&self, s: S, light: Vec3) -> Option<Projection> {
        let depth = unit(self.middle(s) - light)?;
        let aside = if depth.x.abs() < 0.6 { Vec3::X } else { Vec3::Y };
        let x = unit(depth.cross(aside))?;
        let y = depth.cross(x);
        let plain = Projection::new(light, [x, y, depth], [0.0; 2], 0.5, 1.0)?;
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
        let unit = [0, 1].map(|axis: usize| ((high[axis] - low[axis]) / (LINES - 0.25)).max(UNIT_MIN));
        let rows = [(x - depth * low[0]) / unit[0], (y - depth * low[1]) / unit[1], depth];
        Projection::new(light, rows, [LINES; 2], unit[0].max(unit[1]), 1.0 + slant)
    }
}

impl Points {
    /// About the middle of the points.
    #[inline(always)]
    fn middle<S: Simd>(&self, s: S) -> Vec3 {
        let mut sums = [s.splat(0.0); 3];
        for first in (0..self.count).step_by(LANES) {
            let points = self.load(s, first);
            sums = each!(3: [0, 1, 2], axis => s.add(sums[axis], points[axis]));
        }
        let lanes = self.count.next_multiple_of(LANES) as f32;
        let [x, y, z] = each!(3: sums, sum => s.array(sum).iter().sum::<f32>() / lanes);
        Vec3::new(x, y, z)
    }
}

/// Sixteen entries from `first` on.
#[inline(always)]
pub(super) fn chunk<const N: usize>(from: &[f32; N], first: usize) -> &[f32; LANES] {
    // Where fewer are left, the last sixteen; no caller gets there.
    let first = first.min(N - LANES);
    from[first..].first_chunk().unwrap_or(&[0.0; LANES])
}

fn unit(v: Vec3) -> Option<Vec3> {
    let length = libm::sqrtf(v.dot(v));
    (length.is_finite() && length > 1.0e-18).then(|| v / length)
}

/// Edge of the plane that the points fill.
pub(super) const LINES: f32 = 16.0;

/// Smallest unit, as an angle.
const UNIT_MIN: f32 = 1.0 / 4096.0;
