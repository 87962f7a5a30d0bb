//! The ray-triangle test of Möller and Trumbore, in single precision: a documented option.
//!
//! # Source
//! Möller and Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection", Journal of Graphics Tools 2(1),
//! 1997, without its culling branch and its epsilon.
//!
//! # What it loses against the default
//! - *Shared edges leak.* Two neighbours compute the weight of their common edge from different corners, so
//!   both may call a ray outside. Of rays aimed at edges 4.5 % slip through from two sizes away, as through
//!   Embree's fast test, and a little more from farther off; of random rays none in 20,000. Counted by
//!   `tests/triangle_tests.rs`.
//! - *Needles lose all digits* of `t`, `u` and `v`: the determinant is a difference of products that cancel.
//! - *Small triangles vanish* where the determinant underflows: edges below some 1e-19 of the scene.
//!
//! It is not faster here: a cluster's vertices are shared, so the default shears each once for all triangles.

use glam::Vec3;

use crate::simd::{Mask, Simd, each};
use crate::triangle_test::{InLanes, TriangleTest};
use crate::triangle_woop::Crossing;

/// A ray as the test wants it: as it is.
#[derive(Clone, Copy, Debug)]
pub struct MollerRay {
    /// Where the ray starts.
    pub origin: Vec3,
    /// Where it goes.
    pub direction: Vec3,
}

impl TriangleTest for MollerRay {
    #[inline]
    fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, direction }
    }

    #[inline(always)]
    fn in_lanes(&self) -> InLanes<'_> {
        InLanes::Moller(self)
    }

    /// # Edge cases
    /// A determinant of exactly 0 is a miss, and so is a NaN from an overflow.
    fn intersect(&self, [a, b, c]: [Vec3; 3], t_max: f32) -> Option<Crossing> {
        let (e, f) = (b - a, c - a);
        let p = self.direction.cross(f);
        let determinant = e.dot(p);
        if determinant == 0.0 {
            return None;
        }
        let from_a = self.origin - a;
        let q = from_a.cross(e);
        let (u, v) = (from_a.dot(p) / determinant, self.direction.dot(q) / determinant);
        let t = f.dot(q) / determinant;
        // Written so that a NaN fails.
        let inside = u >= 0.0 && v >= 0.0 && u + v <= 1.0;
        (inside && t > 0.0 && t <= t_max).then_some(Crossing { t, u, v })
    }
}

impl MollerRay {
    /// Of sixteen triangles those that [`intersect`](TriangleTest::intersect) finds the ray to pass through, at any `t`:
    /// the same arithmetic, lane by lane.
    #[inline(always)]
    pub(crate) fn candidates<S: Simd>(&self, s: S, [a, b, c]: [[S::F; 3]; 3]) -> Mask {
        let (origin, direction) = (s.splat3(self.origin), s.splat3(self.direction));
        let (e, f) = (difference(s, b, a), difference(s, c, a));
        let p = cross(s, direction, f);
        let determinant = s.dot(e, p);
        let from_a = difference(s, origin, a);
        let q = cross(s, from_a, e);
        let [u, v] = each!(2: [s.dot(from_a, p), s.dot(direction, q)], weight => s.div(weight, determinant));
        let zero = s.splat(0.0);
        // A determinant of 0 makes infinities and NaN, which fail.
        s.le(zero, u) & s.le(zero, v) & s.le(s.add(u, v), s.splat(1.0))
    }
}

#[inline(always)]
fn difference<S: Simd>(s: S, a: [S::F; 3], b: [S::F; 3]) -> [S::F; 3] {
    [s.sub(a[0], b[0]), s.sub(a[1], b[1]), s.sub(a[2], b[2])]
}

#[inline(always)]
fn cross<S: Simd>(s: S, a: [S::F; 3], b: [S::F; 3]) -> [S::F; 3] {
    each!(3: [(1, 2), (2, 0), (0, 1)], (i, j) => s.sub(s.mul(a[i], b[j]), s.mul(b[i], a[j])))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: [Vec3; 3] = [Vec3::ZERO, Vec3::X, Vec3::Y];

    #[test]
    fn a_hit_tells_depth_and_weights() {
        let ray = MollerRay::new(Vec3::new(0.25, 0.5, 2.0), Vec3::NEG_Z);
        assert_eq!(ray.intersect(TRIANGLE, 2.0), Some(Crossing { t: 2.0, u: 0.25, v: 0.5 }));
        assert_eq!(ray.intersect(TRIANGLE, 1.9), None);
    }

    #[test]
    fn collapsed_edge_on_and_tiny_triangles_are_missed() {
        let ray = MollerRay::new(Vec3::new(0.0, 0.0, 1.0), Vec3::NEG_Z);
        assert_eq!(ray.intersect([Vec3::ZERO, Vec3::X, Vec3::X], 9.0), None);
        assert_eq!(ray.intersect([Vec3::ZERO, Vec3::X, Vec3::Z], 9.0), None);
        assert_eq!(ray.intersect(TRIANGLE.map(|corner| corner * 1.0e-25), 9.0), None);
    }
}
