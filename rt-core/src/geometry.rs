//! Which of the things that a scene was made from a primitive belongs to.

use crate::memory::SceneMemory;
use crate::ray::Primitive;
use crate::view::SceneView;

/// Number of a geometry of the scene; embedders that know several call each by it.
///
/// An image holds two geometries so far, either of which may be empty: [`TRIANGLES`](Self::TRIANGLES) and
/// [`SPHERES`](Self::SPHERES).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct GeometryId(pub u32);

impl GeometryId {
    /// All triangles of an image.
    pub const TRIANGLES: Self = Self(0);
    /// All spheres of an image.
    pub const SPHERES: Self = Self(1);
}

impl<M: SceneMemory> SceneView<M> {
    /// The geometry that a primitive belongs to, or `None` when there is no such primitive. Reads the ids segment.
    ///
    /// The number of a triangle in its geometry is its [`original_id`](Self::original_id); that of a sphere is
    /// `header.triangles` less.
    ///
    /// ```
    /// # use rt_core::{Flat, GeometryId, Primitive, Ray, SceneView};
    /// # let mesh = scene::builtin::knot(1000);
    /// # let bytes = scene::build(mesh.clone(), &Default::default(), &|_| {}).unwrap().to_bytes(4096).unwrap();
    /// # let scene = SceneView::new(Flat::new(&bytes))?;
    /// let ray = Ray { origin: [3.0, 0.1, 9.0].into(), direction: [0.0, 0.0, -1.0].into(), t_max: 100.0 };
    /// let hit = scene.nearest(&ray, &mut ())?.expect("a hit");
    /// assert_eq!(scene.geometry_id(hit.primitive), Some(GeometryId::TRIANGLES));
    /// // The number in the mesh, and the weights of the corners, give the point of the hit.
    /// let triangle = scene.original_id(hit.primitive).expect("a triangle") as usize;
    /// let [a, b, c] = mesh.triangles[triangle].map(|v| glam::Vec3::from(mesh.positions[v as usize]));
    /// let point = a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
    /// assert!(point.distance(ray.origin + ray.direction * hit.t) < 1.0e-5);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn geometry_id(&self, primitive: Primitive) -> Option<GeometryId> {
        let is_triangle = u64::from(self.original_id(primitive)?) < self.header().triangles;
        Some(if is_triangle { GeometryId::TRIANGLES } else { GeometryId::SPHERES })
    }
}
