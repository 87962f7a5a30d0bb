//! What is drawn: meshes, and the sphereflake.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use anyhow::{Context, Result};
use rt_core::camera::OrbitPlace;
use rt_core::sphere::Sphere;
use rt_core::{Bounds, Frame, Orbit};
use scene::{Mesh, Model, builtin, read_mesh};

use super::Amount;
use crate::data;
use crate::experiment::Effort;

/// A scene, where it is looked at from, and what is asked of us on it.
#[derive(Debug)]
pub(super) struct Subject {
    pub(super) name: String,
    pub(super) model: Model,
    /// What the orbit goes around, in world units.
    view: Bounds,
    /// Height of the eye, in degrees above the horizon.
    elevation: f64,
    /// Distances of the eye, in diagonals of the view: far, near.
    pub(super) radii: [f32; 2],
    /// How many times Embree's rays a second ours are to be, with the widest vectors; `None` when nothing is asked.
    pub(super) ratio_min: Option<f64>,
}

/// The meshes of the data folder, and how many times Embree's rays a second are asked for.
const MESHES: [(&str, f64); 3] = [("bunny", 2.0), ("buddha-100k", 1.7), ("dragon", 1.5)];

const SPHEREFLAKE_RATIO_MIN: f64 = 3.0;

/// 820 spheres.
const SPHEREFLAKE_DEPTH: u32 = 3;

/// Meshes from the data folder, or the knot where there are none; and the sphereflake.
pub(super) fn all(effort: Effort) -> Result<Vec<Subject>> {
    let mut subjects = Vec::new();
    // A quick look does with what is built in.
    for (name, ratio_min) in MESHES.into_iter().filter(|_| !effort.is_quick()) {
        match data::mesh_file(name, effort).filter(|path| path.exists()) {
            Some(path) => subjects.push(Subject::of_mesh(name, read_mesh(&path)?, Some(ratio_min))?),
            None => effort.say(&format!("{name} is left out: it is not in the data folder")),
        }
    }
    if subjects.is_empty() {
        subjects.push(Subject::of_mesh("knot", builtin::knot(effort.pick(100_000, 20_000)), None)?);
    }
    subjects.push(Subject::sphereflake()?);
    Ok(subjects)
}

impl Subject {
    fn of_mesh(name: &str, mesh: Mesh, ratio_min: Option<f64>) -> Result<Self> {
        let view = mesh.bounds().with_context(|| format!("{name} has no bounds"))?;
        let (name, model) = (name.to_owned(), mesh.into());
        Ok(Self { name, model, view, elevation: 0.0, radii: [1.5, 0.75], ratio_min })
    }

    /// The flake itself fills the view; the ground goes on.
    fn sphereflake() -> Result<Self> {
        let model = builtin::sphereflake(SPHEREFLAKE_DEPTH);
        let view = model.view.context("the sphereflake has no view")?;
        let (name, ratio_min) = ("sphereflake".to_owned(), Some(SPHEREFLAKE_RATIO_MIN));
        Ok(Self { name, model, view, elevation: 20.0, radii: [0.75, 0.5], ratio_min })
    }

    /// Triangles and spheres.
    pub(super) fn primitives(&self) -> usize {
        self.model.count()
    }

    /// The frames of an orbit.
    pub(super) fn frames(&self, radius: f32, Amount { size, frames, .. }: Amount) -> Result<Vec<Frame>> {
        let orbit = Orbit::around(&self.view);
        let frame = |frame| {
            let place = OrbitPlace { radius, elevation: self.elevation, frame, frames };
            Ok(Frame::on_orbit(&orbit, &place, size, size)?)
        };
        (0..frames).map(frame).collect()
    }

    /// Writes the file that `peers/embree.cpp` reads: counts, vertices, triangles, spheres.
    pub(super) fn write(&self, path: &Path) -> Result<()> {
        let Model { mesh: Mesh { positions, triangles }, spheres, .. } = &self.model;
        let counts = [positions.len(), triangles.len(), spheres.len()];
        let mut file = BufWriter::new(File::create(path)?);
        for count in counts {
            file.write_all(&u32::try_from(count)?.to_le_bytes())?;
        }
        file.write_all(bytemuck::cast_slice(positions))?;
        file.write_all(bytemuck::cast_slice(triangles))?;
        for Sphere { centre, radius } in spheres {
            file.write_all(bytemuck::bytes_of(&centre.extend(*radius).to_array()))?;
        }
        Ok(file.flush()?)
    }
}
