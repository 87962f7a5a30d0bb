//! Where rays meet spheres: the very arithmetic of [`sphere`](crate::sphere), lane by lane.

use glam::Vec3;

use super::surface::unit;
use crate::simd::{Simd, each};

/// The ray parameters at which sixteen rays meet the spheres that they are known to meet, and the normals there.
#[inline(always)]
pub(super) fn sphere_surface<S: Simd>(
    s: S,
    eye: Vec3,
    direction: [S::F; 3],
    [x, y, z, radius]: [S::F; 4],
) -> (S::F, [S::F; 3]) {
    let along = each!(3: direction, component => s.widen(component));
    let to_centre = each!(3: [(x, eye.x), (y, eye.y), (z, eye.z)], (centre, eye) => {
        s.sub_f64(s.widen(centre), s.widen(s.splat(eye)))
    });
    let radius = s.widen(radius);
    let length_squared = dot(s, along, along);
    let middle = s.div_f64(dot(s, to_centre, along), length_squared);
    let across = each!(3: [0, 1, 2], axis => s.sub_f64(to_centre[axis], s.mul_f64(middle, along[axis])));
    let under = s.sub_f64(s.mul_f64(radius, radius), dot(s, across, across));
    let half = s.sqrt_f64(s.div_f64(under, length_squared));
    let is_first = s.lt(s.splat(0.0), s.narrow(s.sub_f64(middle, half)));
    // A product with one is exact, and so is one with minus one.
    let sign = s.widen(s.select(is_first, s.splat(-1.0), s.splat(1.0)));
    let t = s.add_f64(middle, s.mul_f64(sign, half));
    let outwards = each!(3: [0, 1, 2], axis => s.sub_f64(s.mul_f64(t, along[axis]), to_centre[axis]));
    (s.narrow(t), normal(s, outwards, along))
}

/// The unit vector outwards, or against the ray where there is none.
#[inline(always)]
fn normal<S: Simd>(s: S, outwards: [S::D; 3], along: [S::D; 3]) -> [S::F; 3] {
    let is_zero = each!(3: outwards, component => s.is_zero_f64(component));
    let is_zero = is_zero[0] & is_zero[1] & is_zero[2];
    let normal = unit(s, outwards);
    if is_zero == 0 {
        return normal;
    }
    let zero = s.widen(s.splat(0.0));
    let against = unit(s, each!(3: along, component => s.sub_f64(zero, component)));
    each!(3: [0, 1, 2], axis => s.select(is_zero, against[axis], normal[axis]))
}

#[inline(always)]
fn dot<S: Simd>(s: S, a: [S::D; 3], b: [S::D; 3]) -> S::D {
    s.add_f64(s.add_f64(s.mul_f64(a[0], b[0]), s.mul_f64(a[1], b[1])), s.mul_f64(a[2], b[2]))
}
