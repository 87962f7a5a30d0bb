//! Hits of which only the place is wanted: nothing is computed for a normal.

use core::marker::PhantomData;

use crate::count::Count;
use crate::grid_ray::GridRay;
use crate::kinds::{ForKinds, Kinds, dispatch};
use crate::memory::SceneMemory;
use crate::ray::{Primitive, Ray};
use crate::triangle_woop::WoopRay;
use crate::view::{Damaged, OfKinds, SceneView, Trace};

/// A [`Hit`](crate::Hit) without its normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HitPlace {
    /// Distance from the ray's origin, in lengths of its direction.
    pub t: f32,
    /// Weight of the triangle's second corner; 0 on a sphere.
    pub u: f32,
    /// Weight of the third corner; 0 on a sphere.
    pub v: f32,
    /// The triangle or sphere, or one of the places where it is stored.
    pub primitive: Primitive,
}

impl<M: SceneMemory> SceneView<M> {
    /// The place of the nearest hit of a ray: as [`nearest`](Self::nearest), for who wants depths, ids or weights and no normal,
    /// which is not computed.
    ///
    /// ```
    /// # use rt_core::{Flat, Ray, SceneView};
    /// # let mesh = scene::builtin::knot(1000);
    /// # let bytes = scene::build(mesh, &Default::default(), &|_| {}).unwrap().to_bytes(4096).unwrap();
    /// # let scene = SceneView::new(Flat::new(&bytes))?;
    /// let ray = Ray { origin: [3.0, 0.1, 9.0].into(), direction: [0.0, 0.0, -1.0].into(), t_max: 100.0 };
    /// let place = scene.nearest_place(&ray, &mut ())?.expect("a hit");
    /// let hit = scene.nearest(&ray, &mut ())?.expect("the same");
    /// assert_eq!((place.t, place.u, place.v, place.primitive), (hit.t, hit.u, hit.v, hit.primitive));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`Damaged`] when the image lies or a page cannot be had.
    #[inline]
    pub fn nearest_place<C: Count>(&self, ray: &Ray, count: &mut C) -> Result<Option<HitPlace>, Damaged> {
        let Some(ray) = GridRay::from_world(ray, self.header()) else { return Ok(None) };
        dispatch(self.header().needs, FindPlace { scene: self, ray: &ray, count })
    }
}

/// A ray whose hit's place is wanted.
struct FindPlace<'a, M, C> {
    scene: &'a SceneView<M>,
    ray: &'a GridRay,
    count: &'a mut C,
}

impl<M: SceneMemory, C: Count> ForKinds for FindPlace<'_, M, C> {
    type Output = Result<Option<HitPlace>, Damaged>;

    #[inline]
    fn run<K: Kinds>(self) -> Self::Output {
        let Self { scene, ray, count } = self;
        let trace =
            Trace::<_, WoopRay, _, _, false> { scene, ray, filter: &mut (), count, test: PhantomData };
        let nearest = scene.lanes().run(OfKinds::<_, _, _, _, K, false>(trace, PhantomData))?;
        let crossing = nearest.crossing;
        let place = |(primitive, _)| HitPlace {
            t: ray.caller_t(crossing.t),
            u: crossing.u,
            v: crossing.v,
            primitive,
        };
        Ok(nearest.surface.map(place))
    }
}
