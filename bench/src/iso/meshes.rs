//! The peer: flying edges make a mesh of an isosurface, and Embree draws it.

use std::fs;

use anyhow::{Context, Result, ensure};
use rt_core::{Flat, SceneView};

use super::flying_edges::{Extracted, FlyingEdges, NOT_HERE, write_samples};
use crate::peers::embree::{Built, Edges, Peer, Quality, Structure};
use crate::peers::folder::Folder;
use crate::peers::level::Level;
use crate::peers::program::Programs;
use crate::volumes::Subject;

/// VTK with a volume, and every Embree with the mesh that was extracted last.
pub(super) struct Meshes {
    pub(super) edges: FlyingEdges,
    pub(super) embrees: Vec<Peer>,
    pub(super) extracted: Extracted,
    /// Of each Embree: what each of [`STRUCTURES`] took.
    pub(super) built: Vec<[Built; STRUCTURES.len()]>,
}

/// What Embree builds: both as fast as it can be drawn, the first as fast as it can be built too.
pub(super) const STRUCTURES: [Structure; 2] = [Edges::Fast.of(Quality::Low), Edges::Fast.of(Quality::Medium)];

/// Triangles that flying edges of VTK 9.7 make of some of our volumes.
const TRIANGLES: [(&str, u64); 3] =
    [("gyroid 256", 1_023_740), ("ml 256", 1_093_084), ("gyroid 512", 4_109_156)];

impl Meshes {
    /// Starts everybody, extracts the surface and builds structures; `None` when VTK or every Embree is missing, which
    /// is then in the notes.
    pub(super) fn start(
        programs: &Programs,
        subject: &Subject,
        scene: &SceneView<Flat<'_>>,
        folder: &Folder,
        notes: &mut Vec<String>,
    ) -> Result<Option<Self>> {
        let volume = scene.header().volume.context("no volume in the image of one")?;
        let samples = folder.path("samples.raw");
        write_samples(&mut *subject.open()?, volume.sample, &samples)?;
        let edges = FlyingEdges::start(&samples, &volume, folder.path("surface.scene"))?;
        fs::remove_file(&samples)?;
        let Some(mut edges) = edges else {
            if !notes.iter().any(|note| note == NOT_HERE) {
                notes.push(NOT_HERE.to_owned());
            }
            return Ok(None);
        };
        let extracted = edges.extract(subject.isovalue)?;
        check(subject, extracted.triangles)?;
        let widest = &Level::compared()[..1];
        let start = |(level, program)| Peer::start(program, &edges.mesh, level);
        let mut embrees: Vec<Peer> = programs.at_levels(widest).map(start).collect::<Result<_>>()?;
        let built = embrees.iter_mut().map(build_all).collect::<Result<Vec<_>>>()?;
        Ok((!embrees.is_empty()).then_some(Self { edges, embrees, extracted, built }))
    }

    /// Extracts the surface of another isovalue.
    pub(super) fn extract(&mut self, isovalue: f32) -> Result<Extracted> {
        self.edges.extract(isovalue)
    }

    /// Has an Embree read the mesh that was extracted last, and build a structure.
    pub(super) fn rebuild(&mut self, embree: usize, structure: Structure) -> Result<Built> {
        self.embrees[embree].load(&self.edges.mesh)?;
        self.embrees[embree].build(structure)
    }
}

fn build_all(embree: &mut Peer) -> Result<[Built; STRUCTURES.len()]> {
    Ok([embree.build(STRUCTURES[0])?, embree.build(STRUCTURES[1])?])
}

/// That the mesh is the one that others have made of this volume.
fn check(subject: &Subject, triangles: u64) -> Result<()> {
    let Some((_, expected)) = TRIANGLES.into_iter().find(|(name, _)| *name == subject.name) else {
        return Ok(());
    };
    let allowed = expected / 1000;
    ensure!(
        triangles.abs_diff(expected) <= allowed,
        "flying edges made {triangles} triangles of {}, instead of {expected}",
        subject.name
    );
    Ok(())
}
