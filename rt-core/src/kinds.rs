//! Instances of the kernels: each is compiled for the kinds of primitives that a scene needs.
//!
//! A scene of triangles runs no instruction for spheres, nor the other way round. The instance is chosen once per
//! tile, or once per ray where rays come one by one. The features `triangles` and `spheres` of the crate say which
//! instances there are; [`SceneNeeds::BUILT`] is what they trace, and an image that needs more is refused.

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

/// Does `work` with the smallest instance that traces all that the scene needs.
#[inline]
pub fn dispatch<W: ForKinds>(needs: SceneNeeds, work: W) -> W::Output {
    match (needs.contains(SceneNeeds::TRIANGLES), needs.contains(SceneNeeds::SPHERES)) {
        #[cfg(all(feature = "triangles", feature = "spheres"))]
        (true, true) => work.run::<AllKinds>(),
        #[cfg(all(feature = "triangles", feature = "spheres"))]
        (false, true) => work.run::<OnlySpheres>(),
        #[cfg(feature = "triangles")]
        _ => work.run::<OnlyTriangles>(),
        #[cfg(not(feature = "triangles"))]
        _ => work.run::<OnlySpheres>(),
    }
}

#[cfg(not(any(feature = "triangles", feature = "spheres")))]
compile_error!(
    "without `triangles` and without `spheres` there is nothing to trace; enable one of the features"
);
