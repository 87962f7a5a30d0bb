//! The traces that policies are compared on.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use memsavvy::run::Source;
use memsavvy::session::{Path, Way};
use memsavvy::size::PictureSize;
use memsavvy::trace::{self, Trace, record};
use rt_core::Solver;
use scene::builtin::BuiltIn;

use super::volume::Volume;
use crate::data;
use crate::experiment::Effort;

/// A trace and its name.
#[derive(Debug)]
pub(crate) struct Named {
    pub(crate) name: String,
    pub(crate) trace: Trace,
}

/// What is traced of a scene.
struct Plan {
    scene: &'static str,
    way: Way,
    nodes: u16,
    page_bytes: u32,
}

const fn plan(scene: &'static str, way: Way, nodes: u16, page_bytes: u32) -> Plan {
    Plan { scene, way, nodes, page_bytes }
}

/// The bunny has 85 pages of 16 KB, of which 4 % are three: it is traced with small pages.
const PLANS: [Plan; 7] = [
    plan("knot", Way::Orbit, 1, 16 << 10),
    plan("bunny", Way::Orbit, 1, 4 << 10),
    plan("bunny", Way::Walk, 1, 4 << 10),
    plan("dragon", Way::Orbit, 1, 16 << 10),
    plan("dragon", Way::Walk, 1, 16 << 10),
    plan("dragon", Way::Orbit, 4, 16 << 10),
    plan("dragon", Way::Walk, 4, 16 << 10),
];

/// Two degrees a frame.
const CIRCLE: u32 = 180;

pub(crate) fn traces(effort: Effort) -> Result<Vec<Named>> {
    let (size, frames) = effort.pick((512, 12), (96, 3));
    let mut traces = Vec::new();
    for plan in PLANS {
        let Some(source) = plan.source(effort)? else { continue };
        let Plan { scene, way, nodes, page_bytes } = plan;
        let name =
            if nodes == 1 { format!("{scene} {way}") } else { format!("{scene} {way}, {nodes} nodes") };
        effort.say(&format!("tracing {name}"));
        let path = Path { way, frames, circle: Some(CIRCLE), radius: 0.75, ..Path::default() };
        let options = trace::Options {
            source,
            page_bytes: Some(page_bytes),
            nodes,
            kernel: None,
            size: PictureSize { width: size, height: size },
            session: path.session()?,
            isosurfaces: Vec::new(),
            solver: Solver::default(),
            quiet: true,
        };
        traces.push(Named { name, trace: through_a_file(&record(&options)?)? });
    }
    let volume = Volume { bricks: effort.pick(16, 8), frames, size };
    traces.push(Named { name: "volume scan".to_owned(), trace: volume.trace() });
    Ok(traces)
}

/// What is replayed is what can be read back from a file.
fn through_a_file(trace: &Trace) -> Result<Trace> {
    let read = Trace::from_bytes(&trace.to_bytes())?;
    ensure!(read == *trace, "a trace reads otherwise than it was written");
    Ok(read)
}

impl Plan {
    fn source(&self, effort: Effort) -> Result<Option<Source>> {
        if self.scene == "knot" {
            return Ok(Some(Source::BuiltIn(BuiltIn::Knot { triangles: effort.pick(600_000, 60_000) })));
        }
        let path: Option<PathBuf> = data::mesh_file(self.scene, effort);
        path.map_or(Ok(None), |path| {
            ensure!(path.exists(), "MEMSAVVY_DATA is set and there is no {}", path.display());
            Ok(Some(Source::Path(path)))
        })
    }
}
