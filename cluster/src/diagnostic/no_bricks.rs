//! No bricks: a build without volumes.

use core::marker::PhantomData;

use rt_core::{Frame, Ray, SceneMemory, SceneView};

use super::probe::LastRead;

/// The isosurfaces of a frame: none.
pub(super) struct Bricks<'a, M>(PhantomData<&'a M>);

impl<'a, M: SceneMemory> Bricks<'a, M> {
    pub(super) const fn new(_: &'a SceneView<LastRead<M>>, _: &Frame) -> Self {
        Self(PhantomData)
    }

    pub(super) const fn behind(&self, _: &Ray) -> Option<u64> {
        None
    }
}
