//! The reference ray-triangle test: everything in double precision, from corners and rays in single.
//!
//! The same construction as [`triangle_woop`](crate::triangle_woop), but the corners are sheared in `f64`
//! too, where they keep 2^-50 of their distance. So it tells the exact answer unless the ray passes an edge
//! within that; and since products are rounded one by one, neighbours still compute exactly opposite values
//! for a common edge.

use glam::Vec3;

use crate::triangle_test::TriangleTest;
use crate::triangle_woop::{Crossing, WoopRay, opposite};

/// A ray as the test wants it; see [`WoopRay`].
#[derive(Clone, Copy, Debug)]
pub struct F64Ray {
    axes: [usize; 3],
    origin: [f64; 3],
    /// How far a corner moves in the first two axes per length of the third, and the third component.
    shear: [f64; 3],
}

impl F64Ray {
    /// Place across the ray, twice, and ray parameter of a corner.
    fn shear(&self, corner: Vec3) -> [f64; 3] {
        let [x, y, z] = [0, 1, 2].map(|i| f64::from(corner[self.axes[i]]) - self.origin[i]);
        [x - self.shear[0] * z, y - self.shear[1] * z, z / self.shear[2]]
    }
}

impl TriangleTest for F64Ray {
    fn new(origin: Vec3, direction: Vec3) -> Self {
        let axes = WoopRay::new(origin, direction).axes;
        let [x, y, along] = axes.map(|axis| f64::from(direction[axis]));
        Self { axes, origin: axes.map(|axis| f64::from(origin[axis])), shear: [x / along, y / along, along] }
    }

    fn intersect(&self, corners: [Vec3; 3], t_max: f32) -> Option<Crossing> {
        let [a, b, c] = corners.map(|corner| self.shear(corner));
        let edge = |p: [f64; 3], q: [f64; 3]| p[0] * q[1] - p[1] * q[0];
        let weights = [edge(c, b), edge(a, c), edge(b, a)];
        let sum = weights[0] + weights[1] + weights[2];
        if opposite(weights, 0.0) || sum == 0.0 {
            return None;
        }
        let t = (weights[0] * a[2] + weights[1] * b[2] + weights[2] * c[2]) / sum;
        #[expect(clippy::cast_possible_truncation, reason = "rounding to single precision is the result")]
        let crossing = Crossing { t: t as f32, u: (weights[1] / sum) as f32, v: (weights[2] / sum) as f32 };
        (crossing.t > 0.0 && crossing.t <= t_max).then_some(crossing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hit_tells_depth_and_weights() {
        let ray = F64Ray::new(Vec3::new(0.25, 0.5, 2.0), Vec3::NEG_Z);
        let triangle = [Vec3::ZERO, Vec3::X, Vec3::Y];
        assert_eq!(ray.intersect(triangle, 2.0), Some(Crossing { t: 2.0, u: 0.25, v: 0.5 }));
        assert_eq!(ray.intersect(triangle, 1.9), None);
    }

    #[test]
    fn a_ray_beside_an_edge_by_less_than_single_precision_misses() {
        let triangle = [Vec3::new(1.0, -1.0, 0.0), Vec3::new(1.0, 1.0, 0.0), Vec3::new(2.0, 0.0, 0.0)];
        let towards = |x: f32| F64Ray::new(Vec3::new(1.0, 0.0, 1.0e6), Vec3::new(x, 0.0, -1.0));
        assert!(towards(0.0).intersect(triangle, f32::INFINITY).is_some());
        assert!(towards(-1.0e-15).intersect(triangle, f32::INFINITY).is_none());
    }
}
