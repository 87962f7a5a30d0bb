//! A running `peers/flying_edges.py`: a child that extracts isosurfaces when it is told to.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use rt_core::volume::{SampleKind, Volume};
use scene::volume::VolumeSource;
use serde::Deserialize;

use crate::peers::child::Obedient;
use crate::peers::stopwatch::Elapsed;

/// VTK with a volume.
#[derive(Debug)]
pub(super) struct FlyingEdges {
    program: Obedient,
    /// Where meshes go.
    pub(super) mesh: PathBuf,
    /// Of the volume that it holds.
    pub(super) volume_bytes: u64,
}

/// What extracting a surface took, and what came out.
#[derive(Clone, Copy, Debug, Deserialize)]
pub(super) struct Extracted {
    #[serde(flatten)]
    pub(super) time: Elapsed,
    pub(super) vertices: u64,
    pub(super) triangles: u64,
}

/// The first answer.
#[derive(Debug, Deserialize)]
struct Hello {
    /// "9.7.2".
    version: String,
}

const PROGRAM: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/peers/flying_edges.py");

/// How the program ends when VTK is not installed.
const NO_VTK: i32 = 3;

pub(super) const NOT_HERE: &str =
    "VTK is not here and not measured; to install it: pip install vtk, for the python3 on the PATH";

impl FlyingEdges {
    /// Starts it on the samples of a file; `None` when VTK is not here.
    pub(super) fn start(samples: &Path, volume: &Volume, mesh: PathBuf) -> Result<Option<Self>> {
        let mut command = Command::new("python3");
        command
            .arg(PROGRAM)
            .arg(samples)
            .arg(name_of(volume.sample))
            .args(volume.dims.map(|count| count.to_string()));
        let mut program = match Obedient::start("flying edges", &mut command) {
            Err(error) if is_missing(&error) => return Ok(None),
            program => program?,
        };
        match program.answer() {
            Ok(Hello { version }) => program.name = format!("VTK {version}"),
            Err(_) if program.end()? == Some(NO_VTK) => return Ok(None),
            Err(error) => return Err(error),
        }
        let samples: u64 = volume.dims.iter().map(|&count| u64::from(count)).product();
        Ok(Some(Self { program, mesh, volume_bytes: samples * volume.sample.bytes() as u64 }))
    }

    /// "VTK 9.7.2".
    pub(super) fn name(&self) -> &str {
        &self.program.name
    }

    /// Extracts the surface of an isovalue to the file of the mesh.
    pub(super) fn extract(&mut self, isovalue: f32) -> Result<Extracted> {
        self.program.ask(&format!("extract {isovalue} {}", self.mesh.display()))
    }
}

impl Extracted {
    /// The arrays that Embree reads, 12 bytes for each vertex and each triangle.
    pub(super) const fn bytes(&self) -> u64 {
        12 * (self.vertices + self.triangles)
    }
}

/// Whether there was no such program.
fn is_missing(error: &anyhow::Error) -> bool {
    error.downcast_ref::<io::Error>().is_some_and(|error| error.kind() == io::ErrorKind::NotFound)
}

const fn name_of(sample: SampleKind) -> &'static str {
    match sample {
        SampleKind::U8 => "u8",
        SampleKind::U16 => "u16",
        SampleKind::F32 => "f32",
    }
}

/// Writes the samples of a volume, as small as ours stores them.
pub(super) fn write_samples(source: &mut dyn VolumeSource, kind: SampleKind, path: &Path) -> Result<()> {
    let mut file =
        BufWriter::new(File::create(path).with_context(|| format!("cannot write {}", path.display()))?);
    let [x, y, z] = source.shape().dims;
    let mut slice = vec![0.0; usize::try_from(x * y)?];
    for z in 0..z {
        source.read_slices(z, &mut slice)?;
        for sample in &slice {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "ours lose nothing either"
            )]
            match kind {
                SampleKind::U8 => file.write_all(&[*sample as u8])?,
                SampleKind::U16 => file.write_all(&(*sample as u16).to_le_bytes())?,
                SampleKind::F32 => file.write_all(&sample.to_le_bytes())?,
            }
        }
    }
    Ok(file.flush()?)
}
