//! The watertight ray-triangle test.
//!
//! # Source
//! Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013. A shear takes the ray to
//! the axis along which it points most; there the three edge functions are cross products of 2D corners, and
//! neighbours that share an edge compute exactly opposite values for it, so no ray slips between them.
//!
//! # How we differ
//! The paper computes edge functions in single precision and again in double precision where one is 0. We
//! state the same decision in two steps: *single precision rejects, double precision decides*.
//! - Products are rounded separately and rounding is monotone, so `a * b - c * d` in `f32` never has the
//!   wrong sign; it is at worst 0 where the true value is not. Two strictly opposite signs in `f32` are
//!   therefore a certain miss.
//! - In `f64` the products of two `f32` are exact, so the signs are exact, and so nearly are the weights. The
//!   paper's weights lose all digits on needles; ours keep `t` within 2^-22 of the point whose corners were
//!   sheared, whatever the triangle's aspect, which the walk through the grid relies on.

use glam::Vec3;

/// A ray as the test wants it: corners are sheared along it, so that it becomes the vertical axis through 0.
#[derive(Clone, Copy, Debug)]
pub struct WoopRay {
    /// The axis along which the ray points most, last; the order of the others keeps the winding.
    pub axes: [usize; 3],
    /// Origin, in the order of `axes`.
    pub origin: [f32; 3],
    /// How far a corner moves in the first two axes per length of the third, and the inverse of the third
    /// component.
    pub shear: [f32; 3],
}

/// A corner in the sheared space of a ray.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sheared {
    /// Place across the ray, first axis.
    pub x: f32,
    /// Place across the ray, second axis.
    pub y: f32,
    /// Ray parameter at the corner's height.
    pub t: f32,
}

/// A ray's parameter at a triangle, and the weights of its second and third corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Ray parameter, in lengths of the direction.
    pub t: f32,
    /// Weight of the second corner.
    pub u: f32,
    /// Weight of the third corner.
    pub v: f32,
}

impl WoopRay {
    /// Prepares a ray. Origin and direction are finite and the direction is not zero.
    #[inline]
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        let (last, is_backwards) = Self::main_axis(direction);
        let (mut first, mut second) = ((last + 1) % 3, (last + 2) % 3);
        if is_backwards {
            (first, second) = (second, first);
        }
        let along = direction[last];
        Self {
            axes: [first, second, last],
            origin: [origin[first], origin[second], origin[last]],
            shear: [direction[first] / along, direction[second] / along, 1.0 / along],
        }
    }

    /// The axis along which a direction points most, and whether backwards.
    #[inline]
    pub(crate) fn main_axis(direction: Vec3) -> (usize, bool) {
        let size = direction.abs();
        let axis = if size.x > size.y {
            if size.x > size.z { 0 } else { 2 }
        } else if size.y > size.z {
            1
        } else {
            2
        };
        (axis, direction[axis] < 0.0)
    }

    /// Shears one corner, given in the order of `axes`.
    #[inline]
    pub fn shear(&self, [x, y, z]: [f32; 3]) -> Sheared {
        let height = z - self.origin[2];
        Sheared {
            x: (x - self.origin[0]) - self.shear[0] * height,
            y: (y - self.origin[1]) - self.shear[1] * height,
            t: self.shear[2] * height,
        }
    }

    /// Where the ray crosses the triangle `a b c` with `0 < t <= t_max`; for both sides of it.
    ///
    /// # Edge cases
    /// A ray through an edge or corner hits every triangle there. A triangle seen exactly edge-on, and one
    /// with two equal corners, is missed. A triangle of no area whose corners differ may be hit: rounded
    /// shearing gives it an area, and it closes the gap that the same rounding opens between its neighbours.
    pub fn intersect(&self, [a, b, c]: [Vec3; 3], t_max: f32) -> Option<Crossing> {
        let shear = |corner: Vec3| self.shear(self.axes.map(|axis| corner[axis]));
        cross(shear(a), shear(b), shear(c), t_max)
    }
}

/// Where the vertical axis crosses the sheared triangle `a b c` with `0 < t <= t_max`.
#[inline]
pub fn cross(a: Sheared, b: Sheared, c: Sheared, t_max: f32) -> Option<Crossing> {
    if certainly_outside(a, b, c) { None } else { decide(a, b, c, t_max) }
}

/// Whether two edge functions have strictly opposite signs, in `f32`.
#[inline]
fn certainly_outside(a: Sheared, b: Sheared, c: Sheared) -> bool {
    let weights = [c.x * b.y - c.y * b.x, a.x * c.y - a.y * c.x, b.x * a.y - b.y * a.x];
    opposite(weights, 0.0)
}

/// As [`cross`], where single precision has not rejected yet.
#[inline(always)]
pub(crate) fn cross_at(a: Sheared, b: Sheared, c: Sheared, t_max: f32) -> Option<Crossing> {
    let is_beyond = a.t > t_max && b.t > t_max && c.t > t_max;
    let is_behind = a.t <= 0.0 && b.t <= 0.0 && c.t <= 0.0;
    if is_beyond || is_behind { None } else { decide(a, b, c, t_max) }
}

/// The exact test, in `f64`.
#[inline]
fn decide(a: Sheared, b: Sheared, c: Sheared, t_max: f32) -> Option<Crossing> {
    let edge = |p: Sheared, q: Sheared| f64::from(p.x) * f64::from(q.y) - f64::from(p.y) * f64::from(q.x);
    let weights = [edge(c, b), edge(a, c), edge(b, a)];
    let sum = weights[0] + weights[1] + weights[2];
    if opposite(weights, 0.0) || sum == 0.0 {
        return None;
    }
    let t = weights[0] * f64::from(a.t) + weights[1] * f64::from(b.t) + weights[2] * f64::from(c.t);
    #[expect(clippy::cast_possible_truncation, reason = "rounding to single precision is the result")]
    let crossing =
        Crossing { t: (t / sum) as f32, u: (weights[1] / sum) as f32, v: (weights[2] / sum) as f32 };
    (crossing.t > 0.0 && crossing.t <= t_max).then_some(crossing)
}

/// Whether the weights lie strictly on both sides of `zero`.
#[inline]
pub(crate) fn opposite<F: PartialOrd>([u, v, w]: [F; 3], zero: F) -> bool {
    (u < zero || v < zero || w < zero) && (u > zero || v > zero || w > zero)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: [Vec3; 3] = [Vec3::ZERO, Vec3::X, Vec3::Y];

    fn down(x: f32, y: f32) -> WoopRay {
        WoopRay::new(Vec3::new(x, y, 2.0), Vec3::NEG_Z)
    }

    #[test]
    fn a_hit_tells_depth_and_weights() {
        let crossing = down(0.25, 0.5).intersect(TRIANGLE, 10.0).expect("inside");
        assert_eq!(crossing, Crossing { t: 2.0, u: 0.25, v: 0.5 });
        let [a, b, c] = TRIANGLE;
        let back = down(0.25, 0.5).intersect([a, c, b], 10.0).expect("both sides count");
        assert_eq!(back, Crossing { t: 2.0, u: 0.5, v: 0.25 });
    }

    #[test]
    fn edges_and_corners_belong_to_the_triangle() {
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5)] {
            assert!(down(x, y).intersect(TRIANGLE, 10.0).is_some(), "{x} {y}");
        }
        assert!(down(0.500_000_1, 0.5).intersect(TRIANGLE, 10.0).is_none());
        assert!(down(-1.0e-30, 0.5).intersect(TRIANGLE, 10.0).is_none());
    }

    #[test]
    fn t_max_is_inclusive_and_the_origin_is_not() {
        assert!(down(0.25, 0.25).intersect(TRIANGLE, 2.0).is_some());
        assert!(down(0.25, 0.25).intersect(TRIANGLE, 1.999_999_9).is_none());
        let on_it = WoopRay::new(Vec3::new(0.25, 0.25, 0.0), Vec3::NEG_Z);
        assert!(on_it.intersect(TRIANGLE, 10.0).is_none());
    }

    #[test]
    fn collapsed_and_edge_on_triangles_are_missed() {
        let [a, b, _] = TRIANGLE;
        assert!(down(0.5, 0.0).intersect([a, b, b], 10.0).is_none());
        assert!(down(0.0, 0.0).intersect([a, a, a], 10.0).is_none());
        let edge_on = WoopRay::new(Vec3::new(-1.0, 0.25, 0.0), Vec3::X);
        assert!(edge_on.intersect(TRIANGLE, 10.0).is_none());
    }

    #[test]
    fn a_ray_through_a_shared_edge_hits_a_side_even_when_products_underflow() {
        let tiny = 1.0e-25;
        let corners = [Vec3::new(-tiny, -tiny, 0.0), Vec3::new(tiny, tiny, 0.0)];
        let left = [corners[0], corners[1], Vec3::new(-tiny, tiny, 0.0)];
        let right = [corners[1], corners[0], Vec3::new(tiny, -tiny, 0.0)];
        let ray = WoopRay::new(Vec3::new(0.0, 0.0, 1.0), Vec3::NEG_Z);
        assert!(ray.intersect(left, 10.0).is_some() && ray.intersect(right, 10.0).is_some());
    }
}
