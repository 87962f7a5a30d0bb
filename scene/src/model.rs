//! What a scene is made of.

use glam::Vec3;
use rt_core::Bounds;
use rt_core::sphere::Sphere;
use rt_core::surface::Surface;

use crate::mesh::Mesh;

/// Triangles and spheres, and what a camera should look at.
///
/// # Numbers
/// Triangles are numbered from 0 in the order of the mesh; spheres follow the last triangle.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Model {
    /// Triangles; may have none.
    pub mesh: Mesh,
    /// Spheres, in world units.
    pub spheres: Vec<Sphere>,
    /// What cameras look at, in world units; `None` for the bounds of everything.
    pub view: Option<Bounds>,
}

impl Model {
    /// Bounds of all vertices, unused ones included, and of all spheres; `None` when there is nothing, or when a
    /// coordinate is not finite.
    pub fn bounds(&self) -> Option<Bounds> {
        let of_mesh = if self.mesh.positions.is_empty() { None } else { Some(self.mesh.bounds()?) };
        let of_spheres = self.spheres.iter().map(bounds_of).reduce(union);
        let bounds = of_mesh.into_iter().chain(of_spheres).reduce(union)?;
        // Minima and maxima pass over a NaN.
        let numbers = self.spheres.iter().all(|sphere| !sphere.centre.is_nan() && !sphere.radius.is_nan());
        (numbers && bounds.is_proper()).then_some(bounds)
    }

    /// Number of triangles and spheres.
    pub fn count(&self) -> usize {
        self.mesh.triangles.len() + self.spheres.len()
    }

    /// The triangle or sphere with this number.
    ///
    /// # Panics
    /// When there is none, or a triangle names a vertex that is not there.
    #[inline]
    pub fn surface(&self, id: u32) -> Surface {
        match self.mesh.triangles.get(id as usize) {
            Some(triangle) => {
                Surface::Triangle(triangle.map(|vertex| self.mesh.positions[vertex as usize].into()))
            }
            None => Surface::Sphere(self.spheres[id as usize - self.mesh.triangles.len()]),
        }
    }

    /// Whether the number is one of a sphere.
    #[inline]
    pub fn is_sphere(&self, id: u32) -> bool {
        id as usize >= self.mesh.triangles.len()
    }

    /// Memory of vertices, indices and spheres, in bytes.
    pub fn bytes(&self) -> u64 {
        self.mesh.bytes() + size_of_val(self.spheres.as_slice()) as u64
    }
}

impl From<Mesh> for Model {
    fn from(mesh: Mesh) -> Self {
        Self { mesh, ..Self::default() }
    }
}

impl From<Vec<Sphere>> for Model {
    fn from(spheres: Vec<Sphere>) -> Self {
        Self { spheres, ..Self::default() }
    }
}

/// The box around a sphere, rounded outwards.
fn bounds_of(sphere: &Sphere) -> Bounds {
    let extent = f64::from(sphere.radius);
    let low = sphere.centre.to_array().map(|x| rounded_down(f64::from(x) - extent));
    let high = sphere.centre.to_array().map(|x| -rounded_down(-f64::from(x) - extent));
    Bounds { low: Vec3::from(low), high: Vec3::from(high) }
}

/// The next single-precision number at or below `value`.
fn rounded_down(value: f64) -> f32 {
    #[expect(clippy::cast_possible_truncation, reason = "corrected below")]
    let rounded = value as f32;
    if f64::from(rounded) > value { rounded.next_down() } else { rounded }
}

fn union(a: Bounds, b: Bounds) -> Bounds {
    Bounds { low: a.low.min(b.low), high: a.high.max(b.high) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BALL: Sphere = Sphere { centre: Vec3::new(1.0, 2.0, 3.0), radius: 0.5 };

    #[test]
    fn bounds_are_of_vertices_and_spheres_and_rounded_outwards() {
        assert_eq!(Model::default().bounds(), None);
        let ball = Model::from(vec![BALL]);
        assert_eq!(
            ball.bounds(),
            Some(Bounds { low: Vec3::new(0.5, 1.5, 2.5), high: Vec3::new(1.5, 2.5, 3.5) })
        );
        let mesh = Mesh { positions: vec![[-1.0; 3]], triangles: vec![] };
        let both = Model { mesh, ..ball };
        assert_eq!(both.bounds().map(|bounds| bounds.low), Some(Vec3::NEG_ONE));
        let hair = Model::from(vec![Sphere { radius: 1.0e-9, ..BALL }]).bounds().expect("finite");
        assert!(hair.low.cmplt(BALL.centre).all() && hair.high.cmpgt(BALL.centre).all());
    }

    #[test]
    fn what_is_not_finite_has_no_bounds() {
        for sphere in [
            Sphere { radius: f32::NAN, ..BALL },
            Sphere { radius: f32::INFINITY, ..BALL },
            Sphere { radius: f32::MAX, ..Sphere { centre: Vec3::MAX, radius: 0.0 } },
            Sphere { centre: Vec3::new(0.0, f32::NAN, 0.0), ..BALL },
        ] {
            assert_eq!(Model::from(vec![BALL, sphere]).bounds(), None, "{sphere:?}");
        }
    }

    #[test]
    fn spheres_are_numbered_after_the_triangles() {
        let mesh = Mesh { positions: vec![[0.0; 3], [1.0; 3], [2.0; 3]], triangles: vec![[0, 1, 2]] };
        let model = Model { mesh, spheres: vec![BALL], view: None };
        assert_eq!((model.count(), model.is_sphere(0), model.is_sphere(1)), (2, false, true));
        assert_eq!(model.surface(1), Surface::Sphere(BALL));
    }
}
