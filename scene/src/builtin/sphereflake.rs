//! Spheres on spheres.

use core::f64::consts::{FRAC_PI_3, FRAC_PI_6};

use glam::Vec3;
use rt_core::Bounds;
use rt_core::sphere::Sphere;

use crate::mesh::Mesh;
use crate::model::Model;

/// A sphere of radius 1 with nine of a third of its radius on it, and nine on each of these, to some depth; over
/// a square of two triangles.
///
/// Has `1 + 9 + ... + 9^depth` spheres: 820 at depth 3, 597,871 at depth 6. The view is `[-2, 2]^3`.
///
/// # Source
/// Haines, "A Proposal for Standard Graphics Environments", IEEE CG&A 7(11), 1987, with the angles of our peer
/// measurements: six children around the equator, three 60 degrees up; each child's axis points away from its
/// parent.
///
/// # Panics
/// When `depth` is above [`DEPTH_MAX`].
pub fn sphereflake(depth: u32) -> Model {
    assert!(depth <= DEPTH_MAX, "a sphereflake of depth {depth} has too many spheres");
    let mut spheres = Vec::new();
    let root = Bud { centre: [0.0; 3], radius: 1.0, axis: [0.0, 1.0, 0.0] };
    root.grow(depth, &mut spheres);
    let ground = Mesh {
        positions: vec![[-8.0, -1.0, -8.0], [8.0, -1.0, -8.0], [8.0, -1.0, 8.0], [-8.0, -1.0, 8.0]],
        triangles: vec![[0, 2, 1], [0, 3, 2]],
    };
    let view = Bounds { low: Vec3::splat(-2.0), high: Vec3::splat(2.0) };
    Model { mesh: ground, spheres, view: Some(view) }
}

/// A sphere that may have others on it.
struct Bud {
    centre: [f64; 3],
    radius: f64,
    /// Unit vector away from the sphere it sits on.
    axis: [f64; 3],
}

impl Bud {
    /// Appends the sphere, then each child with what is on it.
    fn grow(&self, depth: u32, spheres: &mut Vec<Sphere>) {
        spheres.push(Sphere { centre: Vec3::from(self.centre.map(single)), radius: single(self.radius) });
        if depth > 0 {
            for axis in self.directions() {
                let distance = self.radius * 4.0 / 3.0;
                let centre = [0, 1, 2].map(|i| self.centre[i] + axis[i] * distance);
                Self { centre, radius: self.radius / 3.0, axis }.grow(depth - 1, spheres);
            }
        }
    }

    /// Where the children are.
    fn directions(&self) -> [[f64; 3]; 9] {
        let aside = if self.axis[0].abs() > 0.9 { [0.0, 1.0, 0.0] } else { [1.0, 0.0, 0.0] };
        let u = unit(cross(self.axis, aside));
        let v = cross(self.axis, u);
        core::array::from_fn(|child| {
            let (around, up) = match child {
                0..6 => (FRAC_PI_3 * child as f64, 0.0),
                _ => (FRAC_PI_6 + 2.0 * FRAC_PI_3 * (child - 6) as f64, FRAC_PI_3),
            };
            let ((sin, cos), (sin_up, cos_up)) = (libm::sincos(around), libm::sincos(up));
            [0, 1, 2].map(|i| (u[i] * cos + v[i] * sin) * cos_up + self.axis[i] * sin_up)
        })
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = libm::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    v.map(|x| x / length)
}

const fn single(value: f64) -> f32 {
    #[expect(clippy::cast_possible_truncation, reason = "rounded once, to the precision of a model")]
    let single = value as f32;
    single
}

/// Deepest sphereflake; one more would have five million spheres.
pub const DEPTH_MAX: u32 = 6;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_as_many_spheres_as_the_sum_says() {
        for (depth, count) in [(0, 1), (1, 10), (3, 820), (5, 66_430)] {
            assert_eq!(sphereflake(depth).spheres.len(), count);
        }
    }

    #[test]
    fn every_child_touches_its_parent() {
        let spheres = sphereflake(2).spheres;
        // Depth first: a child of the root and its nine children are ten in a row.
        for (parent, child) in spheres[1..].chunks(10).flat_map(|family| {
            let own = family[1..].iter().map(|child| (family[0], *child));
            own.chain([(spheres[0], family[0])])
        }) {
            let distance = (child.centre - parent.centre).length();
            assert!((distance - parent.radius - child.radius).abs() < 1.0e-6, "{parent:?} {child:?}");
        }
    }
}
