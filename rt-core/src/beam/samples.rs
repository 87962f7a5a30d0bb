//! The shadow samples of a tile, seen from the light: each looks for anything between itself and the light.

use glam::Vec3;

use super::boxes::SeenBox;
use super::far_triangles::FarSeen;
use super::points::{POINTS_MAX, Points, chunk};
use super::projection::{Projected, Projection};
use super::sample_tests::Around;
use super::triangles::Bounds;
use crate::simd::{LANES, Mask, Simd, each, first_lanes};
use crate::sphere::{Sphere, SphereRay};
use crate::triangle_woop::WoopRay;

/// The samples, in *groups* of sixteen that follow each other in the picture, where light sees them close together too.
pub(super) struct Samples<'a> {
    points: &'a Points,
    pub(super) light: Vec3,
    /// Places on the plane and inverse depths, by group; infinite once a sample is shadowed, and beyond the end.
    x: [[f32; LANES]; GROUPS],
    y: [[f32; LANES]; GROUPS],
    w: [[f32; LANES]; GROUPS],
    /// Samples of each group that are open.
    pub(super) open: [Mask; GROUPS],
    /// The boxes of the groups, and the least inverse depth of an open sample.
    left: [f32; GROUPS],
    right: [f32; GROUPS],
    top: [f32; GROUPS],
    bottom: [f32; GROUPS],
    far: [f32; GROUPS],
    pub(super) shadowed: [bool; POINTS_MAX],
    /// The least inverse depth of all.
    least: f32,
    /// Whether it is out of date.
    is_stale: bool,
    /// Triangles that reach far out, and that every sample was held against.
    pub(super) far_seen: FarSeen,
}

/// Groups of samples.
pub(super) const GROUPS: usize = POINTS_MAX / LANES;

impl<'a> Samples<'a> {
    /// The points as samples of this light, that have no places yet.
    pub(super) const fn new(points: &'a Points, light: Vec3) -> Self {
        Self {
            points,
            light,
            x: [[0.0; LANES]; GROUPS],
            y: [[0.0; LANES]; GROUPS],
            w: [[f32::INFINITY; LANES]; GROUPS],
            open: [0; GROUPS],
            left: [f32::INFINITY; GROUPS],
            right: [f32::NEG_INFINITY; GROUPS],
            top: [f32::INFINITY; GROUPS],
            bottom: [f32::NEG_INFINITY; GROUPS],
            far: [f32::INFINITY; GROUPS],
            shadowed: [false; POINTS_MAX],
            least: 0.0,
            is_stale: true,
            far_seen: FarSeen::new(),
        }
    }

    /// Puts the samples in their places, and finds the boxes of the groups.
    #[inline(always)]
    pub(super) fn place<S: Simd>(&mut self, s: S, projection: &Projection) {
        let zero = s.splat(0.0);
        for group in 0..self.points.count.div_ceil(LANES) {
            let first = group * LANES;
            let lanes = first_lanes(self.points.count - first);
            // Lanes beyond the end repeat the first sample, which does no harm to the box.
            let Projected { x, y, w } = projection.project(s, self.points.load(s, first));
            let w = s.select(lanes, w, s.splat(f32::INFINITY));
            s.store(x, &mut self.x[group]);
            s.store(y, &mut self.y[group]);
            s.store(w, &mut self.w[group]);
            (self.left[group], self.right[group]) = (s.least(x), -s.least(s.sub(zero, x)));
            (self.top[group], self.bottom[group]) = (s.least(y), -s.least(s.sub(zero, y)));
            self.far[group] = s.least(w);
            self.open[group] = lanes;
        }
    }

    /// Notes that a sample, which is still open, lies in shadow.
    #[inline(always)]
    pub(super) fn close<S: Simd>(&mut self, s: S, (group, lane): (usize, usize)) {
        self.w[group][lane] = f32::INFINITY;
        self.shadowed[group * LANES + lane] = true;
        self.is_stale = true;
        self.open[group] &= !(1 << lane);
        self.far[group] = s.least(s.load(&self.w[group]));
    }

    /// The same for samples of a group, open or not.
    #[cfg(feature = "volumes")]
    #[inline(always)]
    pub(super) fn close_all<S: Simd>(&mut self, s: S, group: usize, lanes: Mask) {
        let w = s.select(lanes, s.splat(f32::INFINITY), s.load(&self.w[group]));
        s.store(w, &mut self.w[group]);
        self.far[group] = s.least(w);
        self.open[group] &= !lanes;
        self.is_stale = true;
        let mut left = lanes;
        while left != 0 {
            self.shadowed[group * LANES + left.trailing_zeros() as usize] = true;
            left &= left - 1;
        }
    }

    /// The same for every sample that something else was found to shadow.
    #[cfg(feature = "volumes")]
    #[inline(always)]
    pub(super) fn close_those<S: Simd>(&mut self, s: S, shadowed: &[bool; POINTS_MAX]) {
        for (group, shadowed) in shadowed.as_chunks::<LANES>().0.iter().enumerate() {
            let lanes = (0..LANES).fold(0, |lanes, lane| lanes | Mask::from(shadowed[lane]) << lane);
            if lanes != 0 {
                self.close_all(s, group, lanes);
            }
        }
    }

    #[inline(always)]
    pub(super) fn is_open(&self, (group, lane): (usize, usize)) -> bool {
        self.open[group] >> lane & 1 != 0
    }

    /// The ray of a sample to the light.
    #[inline]
    fn ray(&self, sample: (usize, usize)) -> WoopRay {
        let point = self.point(sample);
        WoopRay::new(point, self.light - point)
    }

    /// The point that a sample is.
    #[inline(always)]
    pub(super) fn point(&self, (group, lane): (usize, usize)) -> Vec3 {
        self.points.get(group * LANES + lane)
    }

    /// Whether, by the sample's ray, a triangle shadows it.
    #[inline(never)]
    pub(super) fn is_shadowed(&self, sample: (usize, usize), corners: [Vec3; 3]) -> bool {
        self.ray(sample).intersect(corners, 1.0).is_some()
    }

    /// Whether, by the sample's ray, a sphere shadows it.
    #[inline(never)]
    pub(super) fn is_shadowed_by(&self, sample: (usize, usize), sphere: &Sphere) -> bool {
        let point = self.point(sample);
        SphereRay::new(point, self.light - point).intersect(sphere, 1.0).is_some()
    }

    /// The points that the samples of a group are.
    #[inline(always)]
    pub(super) fn points_of_group<S: Simd>(&self, s: S, group: usize) -> [S::F; 3] {
        self.points.load(s, group * LANES)
    }

    /// The ways from the light to the samples of a group.
    #[inline(always)]
    fn ways_from_light<S: Simd>(&self, s: S, group: usize) -> [S::F; 3] {
        let (points, light) = (self.points_of_group(s, group), s.splat3(self.light));
        each!(3: [0, 1, 2], axis => s.sub(points[axis], light[axis]))
    }

    /// The points that samples are, by number.
    #[inline(always)]
    pub(super) fn points_numbered<S: Simd>(&self, s: S, numbers: S::I) -> [S::F; 3] {
        self.points.numbered(s, numbers)
    }

    /// The samples of a group.
    #[inline(always)]
    pub(super) fn group<S: Simd>(&self, s: S, group: usize) -> Places<S::F> {
        Places { x: s.load(&self.x[group]), y: s.load(&self.y[group]), w: s.load(&self.w[group]) }
    }

    /// One sample, in all lanes.
    #[inline(always)]
    pub(super) fn sample<S: Simd>(&self, s: S, (group, lane): (usize, usize)) -> Places<S::F> {
        let [x, y, w] = [&self.x, &self.y, &self.w].map(|from| from[group][lane]);
        Places { x: s.splat(x), y: s.splat(y), w: s.splat(w) }
    }

    /// Samples by number: sixteen times the group, plus the lane.
    #[inline(always)]
    pub(super) fn numbered<S: Simd>(&self, s: S, numbers: S::I) -> Places<S::F> {
        let [x, y, w] = each!(3: [&self.x, &self.y, &self.w], from => {
            s.gather(bytemuck::cast_ref::<_, [f32; POINTS_MAX]>(from), numbers)
        });
        Places { x, y, w }
    }

    /// The box of a group, in all lanes: lowest and highest places, the latter with the least inverse depth.
    #[inline(always)]
    pub(super) fn corners_of_group<S: Simd>(&self, s: S, group: usize) -> [Places<S::F>; 2] {
        let w = s.splat(self.far[group]);
        let low = Places { x: s.splat(self.left[group]), y: s.splat(self.top[group]), w };
        [low, Places { x: s.splat(self.right[group]), y: s.splat(self.bottom[group]), w }]
    }
}

/// Samples, one in each lane.
#[derive(Clone, Copy)]
pub(super) struct Places<F> {
    pub(super) x: F,
    pub(super) y: F,
    /// Inverse depths.
    pub(super) w: F,
}

impl Samples<'_> {
    /// The least inverse depth of an open sample; infinite when none is open.
    #[inline(always)]
    pub(super) fn least<S: Simd>(&mut self, s: S) -> f32 {
        if core::mem::take(&mut self.is_stale) {
            let mut least = s.splat(f32::INFINITY);
            for at in (0..GROUPS).step_by(LANES) {
                least = s.min(s.load(chunk(&self.far, at)), least);
            }
            self.least = s.least(least);
        }
        self.least
    }

    /// The groups that the cluster reaches over.
    #[inline(always)]
    pub(super) fn interest<S: Simd>(&self, s: S, bounds: &Bounds) -> u64 {
        let mut groups = 0;
        for (sixteen, at) in (0..GROUPS).step_by(LANES).enumerate() {
            if at * LANES >= self.points.count {
                break;
            }
            let [left, right] = each!(2: [&self.left, &self.right], end => s.load(chunk(end, at)));
            let [top, bottom] = each!(2: [&self.top, &self.bottom], end => s.load(chunk(end, at)));
            let within = s.le(left, s.splat(bounds.right))
                & s.le(s.splat(bounds.left), right)
                & s.le(top, s.splat(bounds.bottom))
                & s.le(s.splat(bounds.top), bottom)
                & s.lt(s.load(chunk(&self.far, at)), s.splat(bounds.near));
            groups |= u64::from(within) << (sixteen * LANES);
        }
        groups
    }

    /// Whether there is an open sample within the bounds, and the box between it and the light.
    #[inline(always)]
    pub(super) fn wants<S: Simd>(&self, s: S, bounds: &Bounds, seen: Option<&SeenBox>) -> bool {
        let mut groups = self.interest(s, bounds);
        while groups != 0 {
            let group = groups.trailing_zeros() as usize % GROUPS;
            groups &= groups - 1;
            let places = self.group(s, group);
            let mut open = Around::of(s, bounds).reaches(s, &[places; 2]);
            if let Some(seen) = seen {
                open &= seen.met_by(s, self.ways_from_light(s, group), s.splat(1.0));
            }
            if open != 0 {
                return true;
            }
        }
        false
    }
}
