//! Filters: which hits count.
//!
//! A refused hit is passed through, as if the triangle or sphere had a hole there: for cut-out textures, for geometry
//! that one kind of ray does not see, for collecting all hits of a ray by refusing each.

use crate::count::Count;
use crate::grid_ray::GridRay;
use crate::kinds::AllKinds;
use crate::memory::SceneMemory;
use crate::ray::{Hit, Primitive, Ray};
use crate::surface::Surface;
use crate::triangle_woop::{Crossing, WoopRay};
use crate::view::{Damaged, SceneView};

/// Decides about hits inside a kernel, in grid units; the `Filter` of `()` accepts all and compiles away.
pub trait Filter {
    /// Whether the hit counts.
    fn accepts(&mut self, crossing: &Crossing, primitive: Primitive, surface: &Surface) -> bool;
}

impl Filter for () {
    #[inline]
    fn accepts(&mut self, _: &Crossing, _: Primitive, _: &Surface) -> bool {
        true
    }
}

/// A filter that shows the caller's closure each hit in the caller's units.
///
/// It does not know the closure's type: kernels are compiled once for all closures, and a hit is rare enough for a call.
struct HitFilter<'a> {
    ray: &'a GridRay,
    accept: &'a mut dyn FnMut(&Hit) -> bool,
}

impl Filter for HitFilter<'_> {
    fn accepts(&mut self, crossing: &Crossing, primitive: Primitive, surface: &Surface) -> bool {
        let hit = self.ray.hit_at::<AllKinds>(crossing, primitive, surface);
        hit.is_some_and(|hit| (self.accept)(&hit))
    }
}

impl<M: SceneMemory> SceneView<M> {
    /// The nearest hit of a ray that `accept` does not refuse.
    ///
    /// `accept` sees hits in any order, possibly the same more than once (what is stored in several
    /// cells), and none behind the nearest that it accepted. When its answer depends on the hit alone, the
    /// result does not depend on that order. Of triangles with equal corners, and of equal spheres,
    /// only the first of the model exists.
    ///
    /// ```
    /// # use rt_core::{Flat, Ray, SceneView};
    /// # let mesh = scene::builtin::knot(1000);
    /// # let bytes = scene::build(mesh, &Default::default(), &|_| {}).unwrap().to_bytes(4096).unwrap();
    /// # let scene = SceneView::new(Flat::new(&bytes))?;
    /// let ray = Ray { origin: [3.0, 0.1, 9.0].into(), direction: [0.0, 0.0, -1.0].into(), t_max: 100.0 };
    /// let front = scene.nearest(&ray, &mut ())?.expect("the rope's upper side");
    /// let back = scene.nearest_filtered(&ray, |hit| hit.t > front.t, &mut ())?.expect("its lower side");
    /// assert!(front.normal.dot(back.normal) < 0.0);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`Damaged`] when the image lies or a page cannot be had.
    pub fn nearest_filtered<C: Count>(
        &self,
        ray: &Ray,
        mut accept: impl FnMut(&Hit) -> bool,
        count: &mut C,
    ) -> Result<Option<Hit>, Damaged> {
        let Some(ray) = GridRay::from_world(ray, self.header()) else { return Ok(None) };
        let mut filter = HitFilter { ray: &ray, accept: &mut accept };
        self.nearest_with::<WoopRay, _, _>(&ray, &mut filter, count)
    }

    /// Whether a ray has any hit that `accept` does not refuse; see
    /// [`nearest_filtered`](Self::nearest_filtered).
    ///
    /// ```
    /// # use rt_core::{Flat, Ray, SceneView};
    /// # let mesh = scene::builtin::knot(1000);
    /// # let bytes = scene::build(mesh, &Default::default(), &|_| {}).unwrap().to_bytes(4096).unwrap();
    /// # let scene = SceneView::new(Flat::new(&bytes))?;
    /// let ray = Ray { origin: [3.0, 0.1, 9.0].into(), direction: [0.0, 0.0, -1.0].into(), t_max: 100.0 };
    /// let mut depths = Vec::new();
    /// let any = scene.any_filtered(&ray, |hit| { depths.push(hit.t); false }, &mut ())?;
    /// assert!(!any && depths.len() >= 2, "a filter that refuses all has seen all");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`Damaged`] when the image lies or a page cannot be had.
    pub fn any_filtered<C: Count>(
        &self,
        ray: &Ray,
        mut accept: impl FnMut(&Hit) -> bool,
        count: &mut C,
    ) -> Result<bool, Damaged> {
        let Some(ray) = GridRay::from_world(ray, self.header()) else { return Ok(false) };
        let mut filter = HitFilter { ray: &ray, accept: &mut accept };
        self.any_with::<WoopRay, _, _>(&ray, &mut filter, count)
    }
}
