//! Where the rays of a picture meet an isosurface, in double precision and of the samples as they were read.

use anyhow::{Context, Result};
use glam::DVec3;
use rayon::prelude::*;
use rt_core::isosurface_f64::{Crossing, Samples};
use rt_core::{Flat, Frame, Ray, SceneView, Solver};

use super::errors::{Difference, Errors};
use crate::volumes::Subject;

/// The exact places of all rays from the eye.
pub(super) struct Exact<'a> {
    frames: &'a [Frame],
    isovalue: f32,
    lattice: Lattice,
    /// One for each pixel of all frames.
    crossings: Vec<Option<Crossing>>,
}

/// How samples lie in the world.
#[derive(Clone, Copy, Debug)]
struct Lattice {
    origin: DVec3,
    spacing: DVec3,
}

impl<'a> Exact<'a> {
    pub(super) fn of(subject: &Subject, frames: &'a [Frame]) -> Result<Self> {
        let mut source = subject.open()?;
        let shape = source.shape().clone();
        let dims = shape.dims.map(usize::try_from);
        let [Ok(x), Ok(y), Ok(z)] = dims else { anyhow::bail!("{} does not fit in memory", subject.name) };
        let mut samples = vec![0.0; x * y * z];
        source.read_samples(0, &mut samples)?;
        let volume = Samples { dims: [x, y, z], samples: &samples };
        let lattice = Lattice { origin: shape.origin.into(), spacing: shape.spacing.into() };
        let isovalue = subject.isovalue;
        let crossing = |ray: Ray| {
            let (origin, direction) = (lattice.place(ray.origin.as_dvec3()), lattice.way(&ray));
            volume.first_crossing(origin.to_array(), direction.to_array(), f64::INFINITY, isovalue)
        };
        let crossings =
            frames.iter().flat_map(|frame| rays(frame).map(crossing).collect::<Vec<_>>()).collect();
        Ok(Self { frames, isovalue, lattice, crossings })
    }

    /// How far from there a solver finds the surface of the samples as a scene stores them.
    pub(super) fn errors(&self, scene: &SceneView<Flat<'_>>, solver: Solver) -> Result<Errors> {
        let surfaces =
            scene.isosurfaces(&[self.isovalue], solver)?.context("nothing of this value in the volume")?;
        let all_rays: Vec<Ray> =
            self.frames.iter().flat_map(|frame| rays(frame).collect::<Vec<_>>()).collect();
        let differences: Vec<Difference> = all_rays
            .into_par_iter()
            .zip(&self.crossings)
            .map(|(ray, crossing)| {
                let found = surfaces.nearest(&ray, &mut ())?;
                Ok(match (crossing, found) {
                    (None, None) => Difference::Background,
                    (Some(crossing), Some(hit)) => {
                        let voxels = (f64::from(hit.t) - crossing.t).abs() * self.lattice.way(&ray).length();
                        let normal = self.lattice.normal(crossing);
                        Difference::of(voxels, normal.angle_between(hit.normal.as_dvec3()).to_degrees())
                    }
                    _ => Difference::Elsewhere,
                })
            })
            .collect::<Result<_>>()?;
        Ok(Errors::of(&differences))
    }
}

impl Lattice {
    /// A place of the world, in cells.
    fn place(&self, at: DVec3) -> DVec3 {
        (at - self.origin) / self.spacing
    }

    /// A ray's direction, in cells.
    fn way(&self, ray: &Ray) -> DVec3 {
        ray.direction.as_dvec3() / self.spacing
    }

    /// Unit normal of the world, towards lower samples.
    fn normal(&self, crossing: &Crossing) -> DVec3 {
        (-DVec3::from(crossing.gradient) / self.spacing).normalize_or_zero()
    }
}

/// The rays from the eye, row by row.
fn rays(frame: &Frame) -> impl IndexedParallelIterator<Item = Ray> {
    let (camera, width) = (frame.camera, frame.width);
    (0..width * frame.height).into_par_iter().map(move |pixel| {
        let direction = camera.direction(camera.row(pixel / width), pixel % width);
        Ray { origin: camera.eye, direction, t_max: f32::INFINITY }
    })
}
