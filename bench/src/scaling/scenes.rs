//! The scenes, prepared once: the built-in knot, and real meshes where the data folder has them.

use std::fs::{self, File};
use std::io::BufWriter;
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use memsavvy::run::Source;
use scene::{BuildOptions, Mesh, build, builtin, read_mesh};

use crate::data;
use crate::experiment::Effort;

/// Scene images in a folder of their own, removed on drop.
#[derive(Debug)]
pub(crate) struct Scenes {
    folder: PathBuf,
    scenes: Vec<Scene>,
}

/// A scene image, and how far away the eye is.
#[derive(Clone, Debug)]
pub(crate) struct Scene {
    pub(crate) name: String,
    /// In diagonals of the scene.
    pub(crate) radius: f32,
    image: PathBuf,
}

const PAGE_BYTES: u32 = 16 << 10;
const MESHES: [&str; 2] = ["bunny", "dragon"];

/// From near, most of the picture is covered.
const NEAR: f32 = 0.75;

/// From afar, most of it is background.
const FAR: f32 = 1.5;

impl Scenes {
    /// Writes the images.
    pub(crate) fn prepare(effort: Effort) -> Result<Self> {
        let folder = std::env::temp_dir().join(format!("memsavvy-bench-{}", std::process::id()));
        fs::create_dir_all(&folder).with_context(|| format!("cannot write to {}", folder.display()))?;
        let mut scenes = Self { folder, scenes: Vec::new() };
        effort.say("preparing scenes");
        scenes.add("knot", builtin::knot(effort.pick(600_000, 60_000)))?;
        for (name, path) in MESHES.iter().filter_map(|name| Some((name, data::mesh_file(name, effort)?))) {
            ensure!(path.exists(), "MEMSAVVY_DATA is set and there is no {}", path.display());
            scenes.add(name, read_mesh(&path)?)?;
        }
        Ok(scenes)
    }

    /// Every scene, from near.
    pub(crate) fn near(&self) -> &[Scene] {
        &self.scenes
    }

    /// Every scene, from afar and from near.
    pub(crate) fn far_and_near(&self) -> Vec<Scene> {
        let at = |scene: &Scene| [FAR, NEAR].map(|radius| Scene { radius, ..scene.clone() });
        self.scenes.iter().flat_map(at).collect()
    }

    fn add(&mut self, name: &str, mesh: Mesh) -> Result<()> {
        let image = self.folder.join(format!("{name}.msv"));
        let built = build(mesh, &BuildOptions::default(), &|_| {})?;
        built.write(PAGE_BYTES, &mut BufWriter::new(File::create(&image)?), &|_| {})?;
        self.scenes.push(Scene { name: name.to_owned(), radius: NEAR, image });
        Ok(())
    }
}

impl Scene {
    pub(crate) fn source(&self) -> Source {
        Source::Path(self.image.clone())
    }
}

impl Drop for Scenes {
    fn drop(&mut self) {
        // What cannot be removed lies in the system's temporary folder.
        let _ = fs::remove_dir_all(&self.folder);
    }
}
