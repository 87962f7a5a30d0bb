//! Which of the things that a scene was made from a primitive belongs to.

use crate::memory::SceneMemory;
use crate::ray::Primitive;
use crate::view::SceneView;

/// Number of a geometry of the scene; embedders that know several call each by it.
///
/// An image holds one geometry so far, [`GeometryId::FIRST`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct GeometryId(pub u32);

impl GeometryId {
    /// The first, and so far only, geometry of an image.
    pub const FIRST: Self = Self(0);
}

impl<M: SceneMemory> SceneView<M> {
    /// The geometry that a primitive belongs to, or `None` when there is no such primitive. Its number there
    /// is [`original_id`](Self::original_id).
    ///
    /// ```
    /// # use rt_core::{Flat, GeometryId, Primitive, Ray, SceneView};
    /// # let mesh = scene::builtin::knot(1000);
    /// # let bytes = scene::build(mesh.clone(), &Default::default(), &|_| {}).unwrap().to_bytes(4096).unwrap();
    /// # let scene = SceneView::new(Flat::new(&bytes))?;
    /// let ray = Ray { origin: [3.0, 0.1, 9.0].into(), direction: [0.0, 0.0, -1.0].into(), t_max: 100.0 };
    /// let hit = scene.nearest(&ray, &mut ())?.expect("a hit");
    /// assert_eq!(scene.geometry_id(hit.primitive), Some(GeometryId::FIRST));
    /// // The number in the mesh, and the weights of the corners, give the point of the hit.
    /// let triangle = scene.original_id(hit.primitive).expect("a triangle") as usize;
    /// let [a, b, c] = mesh.triangles[triangle].map(|v| glam::Vec3::from(mesh.positions[v as usize]));
    /// let point = a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
    /// assert!(point.distance(ray.origin + ray.direction * hit.t) < 1.0e-5);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn geometry_id(&self, Primitive(index): Primitive) -> Option<GeometryId> {
        (index < self.header().primitives).then_some(GeometryId::FIRST)
    }
}
