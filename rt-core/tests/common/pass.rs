//! Whether a ray was allowed to pass a surface.
//!
//! # The argument
//! The kernel shears corners in `f32` and is exact from there on. So what it answers is the truth about a
//! surface each of whose corners was moved, across the ray, by at most the *rounding* of that corner, along
//! straight lines. Take a triangle that the exact ray meets, and with it all triangles that one reaches from
//! it over edges closer to the ray than their rounding. When all of them are interior edges between triangles
//! turned the same way, the ray meets this patch once, and no edge at the patch's rim can be moved over the
//! ray; so it meets the moved patch too: the kernel *must* report a hit. Its `t` is that of a point of one of
//! the triangles within the rounding of the ray.
//!
//! When an edge among them is the rim of the surface or a silhouette, rounding may take the surface off the
//! ray, and nothing follows. All decisions here are exact or in `f64`, whose own rounding is 2^-29 of `f32`'s.

use rt_core::Ray;

use super::exact::side;
use super::surface::{Side, Surface};

/// Why a ray had no hit near the point it was aimed at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pass {
    /// It must have a hit up to this `t`, and has none.
    Leak {
        /// The triangle that the exact ray meets.
        triangle: u32,
        t: f64,
    },
    /// The exact ray meets no triangle: the point it was aimed at, or its direction, was rounded.
    MeetsNothing,
    /// All that the exact ray meets is so close to a silhouette or a rim that rounding decides.
    AtSilhouette,
    /// There is a hit as near as it must be; the surface is steep there.
    HitBehindAim,
}

/// Judges a ray with a nearest hit at `hit`, infinite for none.
pub fn judge(surface: &Surface, ray: &Ray, hit: f32) -> Pass {
    let view = View::new(surface, ray);
    let count = u32::try_from(surface.mesh.triangles.len()).expect("a mesh");
    let mut pass = Pass::MeetsNothing;
    for triangle in (0..count).filter(|&triangle| view.meets(triangle)) {
        match view.certain_t(triangle) {
            Some(t) if f64::from(hit) > t => return Pass::Leak { triangle, t },
            Some(_) => pass = Pass::HitBehindAim,
            None if pass == Pass::MeetsNothing => pass = Pass::AtSilhouette,
            None => {}
        }
    }
    pass
}

/// Whether rounding may move an edge of the surface's first triangle over the ray.
pub fn is_at_an_edge(surface: &Surface, ray: &Ray) -> bool {
    let view = View::new(surface, ray);
    (0..3).any(|corner| view.is_within_rounding(Side { triangle: 0, corner }))
}

/// Lowest and highest `t` that rounding may give to a hit of the surface's first triangle.
pub fn range_of_t(surface: &Surface, ray: &Ray) -> (f64, f64) {
    View::new(surface, ray).range_of_t(0)
}

/// A surface seen along a ray.
struct View<'a> {
    surface: &'a Surface,
    ray: &'a Ray,
    /// Across the ray, across the ray, along it.
    axes: [usize; 3],
}

/// A corner in the sheared space of the ray.
#[derive(Clone, Copy)]
struct Corner {
    at: [f64; 2],
    t: f64,
    /// How far rounding may move it across the ray.
    rounding: f64,
}

impl<'a> View<'a> {
    fn new(surface: &'a Surface, ray: &'a Ray) -> Self {
        let along = ray.direction.abs().max_position();
        Self { surface, ray, axes: [(along + 1) % 3, (along + 2) % 3, along] }
    }

    /// Whether the exact ray meets a triangle, its edges included; not if that is edge-on.
    fn meets(&self, triangle: u32) -> bool {
        let [a, b, c] = self.surface.corners(triangle);
        let (direction, origin) = (self.ray.direction.to_array(), self.ray.origin.to_array());
        let sides = [(a, b), (b, c), (c, a)].map(|(p, q)| side(direction, p, q, origin));
        let (low, high) = (sides.into_iter().min(), sides.into_iter().max());
        let inside = low >= Some(0) || high <= Some(0);
        inside && (low, high) != (Some(0), Some(0)) && self.range_of_t(triangle).0 > 0.0
    }

    /// The `t` up to which the kernel must report a hit, given that the exact ray meets `triangle`; `None`
    /// when rounding may take the surface off the ray.
    fn certain_t(&self, triangle: u32) -> Option<f64> {
        let mut patch = vec![triangle];
        let mut done = 0;
        while let Some(&triangle) = patch.get(done) {
            done += 1;
            for corner in 0..3 {
                let side = Side { triangle, corner };
                if self.is_within_rounding(side) {
                    let beyond = self.surface.across(side)?;
                    if !self.surface.all_turned_alike(&[triangle, beyond], self.ray) {
                        return None;
                    }
                    if !patch.contains(&beyond) {
                        patch.push(beyond);
                    }
                }
            }
        }
        patch.iter().map(|&triangle| self.range_of_t(triangle).1).reduce(f64::max)
    }

    fn is_within_rounding(&self, side: Side) -> bool {
        let [p, q] = self.surface.ends(side).map(|end| self.corner(end.to_array()));
        let edge = [q.at[0] - p.at[0], q.at[1] - p.at[1]];
        let length = edge[0] * edge[0] + edge[1] * edge[1];
        let share = if length > 0.0 { -(p.at[0] * edge[0] + p.at[1] * edge[1]) / length } else { 0.0 };
        let share = share.clamp(0.0, 1.0);
        (p.at[0] + edge[0] * share).hypot(p.at[1] + edge[1] * share) <= p.rounding.max(q.rounding)
    }

    /// Lowest and highest `t` of the triangle within its rounding of the ray.
    fn range_of_t(&self, triangle: u32) -> (f64, f64) {
        let corners = self.surface.corners(triangle).map(|corner| self.corner(corner));
        let [a, b, c] = corners;
        let rounding = corners.iter().map(|corner| corner.rounding).fold(0.0, f64::max);
        let (low, high) = corners.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), corner| {
            (low.min(corner.t), high.max(corner.t))
        });
        let (e, f) = ([b.at[0] - a.at[0], b.at[1] - a.at[1]], [c.at[0] - a.at[0], c.at[1] - a.at[1]]);
        let area = e[0] * f[1] - e[1] * f[0];
        // The plane of the triangle over the ray, and how steep it is.
        let slope = [
            ((b.t - a.t) * f[1] - (c.t - a.t) * e[1]) / area,
            ((c.t - a.t) * e[0] - (b.t - a.t) * f[0]) / area,
        ];
        let middle = a.t - slope[0] * a.at[0] - slope[1] * a.at[1];
        let reach = slope[0].hypot(slope[1]) * rounding;
        // A NaN, where the area is 0, leaves the corners to decide. The last factor is the rounding of `t`.
        let largest = low.abs().max(high.abs()) * (8.0 * E);
        (low.max(middle - reach) - largest, high.min(middle + reach) + largest)
    }

    /// Shears a corner, as [`rt_core::triangle_woop`] does.
    ///
    /// There the shear `s` rounds once, the differences `x - ox` and `z - oz` once each, `s (z - oz)` once,
    /// and the last difference once: together at most `2 e |x - ox| + 4 e |s (z - oz)|`. (Nothing
    /// underflows: a component of a direction is 0 or above 2^-60 of the largest.)
    fn corner(&self, corner: [f32; 3]) -> Corner {
        let [x, y, along] = self.axes.map(|axis| {
            (f64::from(corner[axis]) - f64::from(self.ray.origin[axis]), f64::from(self.ray.direction[axis]))
        });
        let t = along.0 / along.1;
        let sheared = [x, y].map(|(place, step)| {
            let shear = step * t;
            (place - shear, (2.0 * place.abs() + 4.0 * shear.abs()) * (E * 1.000_001))
        });
        let [(x, x_rounding), (y, y_rounding)] = sheared;
        Corner { at: [x, y], t, rounding: x_rounding.hypot(y_rounding) }
    }
}

/// Half the distance from 1 to the next `f32`, which is the rounding of one operation.
const E: f64 = 1.0 / 16_777_216.0;
