//! The bricks behind pixels, of scenes with a volume.

use rt_core::{Frame, ISOVALUES_MAX, Isosurfaces, Ray, SceneMemory, SceneView};

use super::probe::LastRead;

/// The isosurfaces of a frame.
pub(super) struct Bricks<'a, M> {
    scene: &'a SceneView<LastRead<M>>,
    isosurfaces: Option<Isosurfaces<'a, LastRead<M>>>,
}

impl<'a, M: SceneMemory> Bricks<'a, M> {
    pub(super) fn new(scene: &'a SceneView<LastRead<M>>, frame: &Frame) -> Self {
        let mut values = [0.0; ISOVALUES_MAX];
        let surfaces = frame.isosurfaces();
        values.iter_mut().zip(surfaces).for_each(|(value, surface)| *value = surface.value);
        let isosurfaces = scene.isosurfaces(&values[..surfaces.len()], frame.solver());
        Self { scene, isosurfaces: isosurfaces.ok().flatten() }
    }

    /// Where in the image the brick lies in which a ray ends.
    pub(super) fn behind(&self, ray: &Ray) -> Option<u64> {
        let isosurfaces = self.isosurfaces.as_ref()?;
        let read = self.scene.memory().of(self.scene.header().segments.bricks);
        isosurfaces.nearest(ray, &mut ()).ok()??;
        Some(read.last())
    }
}
