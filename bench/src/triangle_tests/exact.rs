//! What is right, in double precision.

use glam::{DVec3, Vec3};
use rt_core::Ray;

/// Where a ray crosses a triangle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Exact {
    pub(super) t: f64,
    pub(super) u: f64,
    pub(super) v: f64,
}

impl Exact {
    /// The answer from single-precision corners and rays; off by some 2^-50, and nothing is decided closer to an edge than
    /// that. By Cramer's rule from `a`, not by the way of any of the tests.
    pub(super) fn of(ray: &Ray, [a, b, c]: [Vec3; 3]) -> Option<Self> {
        let double = |v: Vec3| DVec3::new(v.x.into(), v.y.into(), v.z.into());
        let (origin, direction) = (double(ray.origin), double(ray.direction));
        let (e, f, from_a) = (double(b) - double(a), double(c) - double(a), origin - double(a));
        let normal = e.cross(f);
        let along = direction.dot(normal);
        if along == 0.0 {
            return None;
        }
        let t = -from_a.dot(normal) / along;
        let point = from_a + direction * t;
        let per_area = 1.0 / normal.dot(normal);
        let (u, v) = (point.cross(f).dot(normal) * per_area, e.cross(point).dot(normal) * per_area);
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0).then_some(Self { t, u, v })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hit_tells_depth_and_weights() {
        let ray = Ray { origin: Vec3::new(0.25, 0.5, 2.0), direction: Vec3::NEG_Z, t_max: 9.0 };
        let exact = Exact::of(&ray, [Vec3::ZERO, Vec3::X, Vec3::Y]).expect("inside");
        assert_eq!((exact.t, exact.u, exact.v), (2.0, 0.25, 0.5));
        assert!(Exact::of(&ray, [Vec3::X, Vec3::ONE, Vec3::X * 2.0]).is_none());
    }
}
