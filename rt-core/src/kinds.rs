//! Instances of the kernels: each is compiled for the kinds of primitives that a scene needs.
//!
//! A scene of triangles runs no instruction for spheres, nor the other way round. The instance is chosen once per
//! tile, or once per ray where rays come one by one. The features `triangles`, `spheres` and `volumes` of the crate say
//! which instances there are; [`SceneNeeds::BUILT`] is what they trace, and an image that needs more is refused.

use crate::needs::SceneNeeds;
use crate::triangle_test::TriangleTest;

/// The kinds of primitives that an instance of a kernel traces.
pub trait Kinds {
    /// It traces triangles.
    const TRIANGLES: bool;
    /// It traces spheres.
    const SPHERES: bool;
    /// `T` where triangles are traced; else `()`, which takes no time to prepare.
    type Test<T: TriangleTest>: TriangleTest;
}

/// Triangles and nothing else.
#[derive(Clone, Copy, Debug)]
pub struct OnlyTriangles;

/// Spheres and nothing else.
#[derive(Clone, Copy, Debug)]
pub struct OnlySpheres;

/// Neither: a scene of a volume alone.
#[cfg(feature = "volumes")]
#[derive(Clone, Copy, Debug)]
pub struct NoKinds;

/// Every kind there is.
#[derive(Clone, Copy, Debug)]
pub struct AllKinds;

impl Kinds for OnlyTriangles {
    const TRIANGLES: bool = true;
    const SPHERES: bool = false;
    type Test<T: TriangleTest> = T;
}

impl Kinds for OnlySpheres {
    const TRIANGLES: bool = false;
    const SPHERES: bool = true;
    type Test<T: TriangleTest> = ();
}

#[cfg(feature = "volumes")]
impl Kinds for NoKinds {
    const TRIANGLES: bool = false;
    const SPHERES: bool = false;
    type Test<T: TriangleTest> = ();
}

impl Kinds for AllKinds {
    const TRIANGLES: bool = true;
    const SPHERES: bool = true;
    type Test<T: TriangleTest> = T;
}

/// Every kind that this build traces: for what need not be fast, and has one instance.
#[cfg(all(feature = "triangles", feature = "spheres"))]
pub type BuiltKinds = AllKinds;
/// Every kind that this build traces: for what need not be fast, and has one instance.
#[cfg(not(feature = "spheres"))]
pub type BuiltKinds = OnlyTriangles;
/// Every kind that this build traces: for what need not be fast, and has one instance.
#[cfg(all(feature = "spheres", not(feature = "triangles")))]
pub type BuiltKinds = OnlySpheres;

/// Something to do with the instance of a kernel that fits a scene: a closure over a type.
pub trait ForKinds {
    /// What comes of it.
    type Output;

    /// Does it.
    fn run<K: Kinds>(self) -> Self::Output;
}

/// Does `work` with the smallest instance that traces all primitives that the scene needs.
#[inline]
pub fn dispatch<W: ForKinds>(needs: SceneNeeds, work: W) -> W::Output {
    match (needs.contains(SceneNeeds::TRIANGLES), needs.contains(SceneNeeds::SPHERES)) {
        #[cfg(all(feature = "triangles", feature = "spheres"))]
        (true, true) => work.run::<AllKinds>(),
        #[cfg(all(feature = "triangles", feature = "spheres"))]
        (false, true) => work.run::<OnlySpheres>(),
        #[cfg(feature = "triangles")]
        _ => work.run::<OnlyTriangles>(),
        #[cfg(all(feature = "spheres", not(feature = "triangles")))]
        _ => work.run::<OnlySpheres>(),
        #[cfg(not(any(feature = "triangles", feature = "spheres")))]
        // The header was checked: the scene needs neither.
        _ => work.run::<NoKinds>(),
    }
}

/// The same beside a volume. Most have none; for the others one instance does, since kernels take long to compile.
#[cfg(feature = "volumes")]
#[inline]
pub fn dispatch_beside_volume<W: ForKinds>(needs: SceneNeeds, work: W) -> W::Output {
    #[cfg(any(feature = "triangles", feature = "spheres"))]
    if needs.has_primitives() {
        return work.run::<BuiltKinds>();
    }
    let _ = needs;
    work.run::<NoKinds>()
}

#[cfg(not(any(feature = "triangles", feature = "spheres", feature = "volumes")))]
compile_error!(
    "without `triangles`, `spheres` and `volumes` there is nothing to trace; enable one of the features"
);
