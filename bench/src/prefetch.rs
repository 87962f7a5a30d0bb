//! Prefetch in a cluster of processes: what it spares and what it costs, on a camera that moves.
//!
//! A node's whole memory is slots, for a store holds the pages; the pictures of all runs are compared.

use core::num::NonZeroU16;
use core::time::Duration;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use memsavvy::report::{ProcessReport, RunReport};
use memsavvy::run::{self, Options, Prefetch, Source};
use memsavvy::session::{Path as Moments, Way};
use memsavvy::size::{Memory, PictureSize};
use scene::{BuildOptions, build, builtin, read_mesh};

use crate::data;
use crate::experiment::{Effort, Experiment};
use crate::findings::{Aim, Findings};
use crate::images::Images;
use crate::plot::{Axis, Chart, Line, Plot};
use crate::table::{Cell, Table};

pub(crate) const EXPERIMENT: Experiment = Experiment {
    name: "prefetch",
    shows: "blocking misses and bytes of a node at 16 % memory, by what is asked for ahead",
    run,
};

/// The first is what the others are measured by.
const WAYS_AHEAD: [Prefetch; 4] = [Prefetch::None, Prefetch::Neighbours, Prefetch::Tiles, Prefetch::Both];

/// What is asked for ahead unless one says otherwise.
const DEFAULT: Prefetch = Prefetch::Tiles;

/// Memory of a node, of the image.
const SHARE: f64 = 0.16;

/// Bytes that may be moved, of those without prefetch.
const BYTES_MAX: f64 = 1.1;

/// Loads that may have to wait, of those without prefetch.
const MISSES_MAX: f64 = 0.95;

const PAGE_BYTES: u32 = 4 << 10;

/// Cameras that move: how the eye goes, and how many frames a full circle takes.
const CAMERAS: [(&str, Way); 3] =
    [("orbit", Way::Orbit), ("walk", Way::Walk), ("orbit, and a jump to the other side", Way::Jump)];

/// Frames of a full circle: two degrees a frame.
const CIRCLE: u32 = 180;

/// A run, and what was asked for ahead in it.
struct Ran {
    ahead: Prefetch,
    report: RunReport,
}

fn run(effort: Effort) -> Result<Findings> {
    let folder = std::env::temp_dir().join(format!("memsavvy-prefetch-{}", std::process::id()));
    fs::create_dir_all(&folder).with_context(|| format!("cannot write to {}", folder.display()))?;
    let outcome = prepare(&folder, effort).and_then(|(image, name)| measure(&image, name, effort));
    // What cannot be removed lies in the system's temporary folder.
    let _ = fs::remove_dir_all(&folder);
    outcome
}

/// Writes the scene; gives back where it is, and its name.
fn prepare(folder: &Path, effort: Effort) -> Result<(PathBuf, &'static str)> {
    let (mesh, name) = match data::mesh_file("dragon", effort) {
        Some(path) if effort == Effort::Full => (read_mesh(&path)?, "dragon"),
        _ => (builtin::knot(effort.pick(600_000, 60_000)), "knot"),
    };
    let image = folder.join("scene.msv");
    let built = build(mesh, &BuildOptions::default(), &|_| {})?;
    built.write(PAGE_BYTES, &mut BufWriter::new(File::create(&image)?), &|_| {})?;
    Ok((image, name))
}

fn measure(image: &Path, name: &str, effort: Effort) -> Result<Findings> {
    let (nodes, frames, size) = effort.pick((2, 24, 512), (1, 6, 128));
    let title = format!(
        "{name}: {size}x{size}, {frames} frames of two degrees, {nodes} nodes of one thread with slots for 16 % of the image, a store, pages of 4 KB"
    );
    let heads = [
        "camera",
        "prefetch",
        "misses a frame",
        "of none's",
        "MB a frame",
        "of none's",
        "asked",
        "used",
        "wasted",
    ];
    let mut table = Table::new("prefetch", title, &heads);
    let (mut aims, mut lines) = (Vec::new(), Vec::new());
    for (camera, way) in CAMERAS {
        let mut runs = Vec::new();
        for ahead in WAYS_AHEAD {
            effort.say(&format!("{name}, {camera}: {}", name_of(ahead)));
            let options = options(image, (way, frames), ahead, (nodes, size))?;
            runs.push(Ran { ahead, report: run::run(&options, |_| Ok(()))? });
        }
        let mut images = Images::default();
        runs.iter().try_for_each(|ran| images.expect_same(&ran.report))?;
        let none = &runs[0];
        runs.iter().for_each(|ran| table.push(ran.row(camera, none)));
        lines.push(Line {
            name: camera.to_owned(),
            points: (0..).map(f64::from).zip(runs.iter().map(|ran| ran.misses() / none.misses())).collect(),
        });
        aims.extend(runs[1..].iter().flat_map(|ran| ran.aims(camera, none)));
    }
    table.note("misses: loads of all nodes that met an absent page; the first frame, which finds the caches empty, is among the others");
    table.note("asked, used, wasted: pages asked for ahead; those that are neither used nor wasted are still there, in doubt");
    let x = Axis { label: "none, neighbours, tiles, both", is_logarithmic: false };
    let y = Axis { label: "misses over those without prefetch", is_logarithmic: false };
    let chart = Chart { title: format!("{name}: what is asked for ahead"), x, y, lines };
    Ok(Findings { tables: vec![table], aims, plot: Some(Plot { charts: vec![chart] }) })
}

fn options(
    image: &Path,
    (way, frames): (Way, u32),
    prefetch: Prefetch,
    (nodes, size): (u16, u32),
) -> Result<Options> {
    let moments = Moments { way, frames, circle: Some(CIRCLE), radius: 0.75, ..Moments::default() };
    Ok(Options {
        source: Source::Path(image.to_owned()),
        nodes,
        stores: 1,
        threads: Some(NonZeroU16::MIN),
        memory: Some(Memory::Share(SHARE)),
        page_bytes: Some(PAGE_BYTES),
        prefetch,
        size: PictureSize { width: size, height: size },
        session: moments.session()?,
        deadline: Duration::from_secs(60),
        quiet: true,
        ..Options::default()
    })
}

const fn name_of(ahead: Prefetch) -> &'static str {
    match ahead {
        Prefetch::None => "none",
        Prefetch::Neighbours => "neighbours",
        Prefetch::Tiles => "tiles",
        Prefetch::Both => "both",
    }
}

impl Ran {
    /// What its nodes have counted, together.
    fn sum(&self, of: impl Fn(&ProcessReport) -> u64) -> f64 {
        self.report.nodes.iter().map(of).sum::<u64>() as f64
    }

    /// Loads that had to wait for a page, a frame.
    fn misses(&self) -> f64 {
        self.sum(|node| node.faults) / self.report.frames.len() as f64
    }

    /// Megabytes of pages a frame.
    fn megabytes(&self) -> f64 {
        self.sum(|node| node.received_bytes) / 1e6 / self.report.frames.len() as f64
    }

    fn row(&self, camera: &str, none: &Self) -> Vec<Cell> {
        let count = |of: fn(&ProcessReport) -> u64| Cell::Number(self.sum(of), 0);
        vec![
            Cell::text(camera),
            Cell::text(name_of(self.ahead)),
            Cell::Number(self.misses(), 0),
            Cell::Number(self.misses() / none.misses(), 2),
            Cell::Number(self.megabytes(), 2),
            Cell::Number(self.megabytes() / none.megabytes(), 2),
            count(|node| node.prefetched),
            count(|node| node.prefetch_used),
            count(|node| node.prefetch_wasted),
        ]
    }

    /// Whichever is chosen, it costs little; the default spares misses.
    fn aims(&self, camera: &str, none: &Self) -> Vec<Aim> {
        let name = name_of(self.ahead);
        let bytes = self.megabytes() / none.megabytes();
        let mut aims = vec![Aim::at_most(format!("{camera}, {name}: bytes over none's"), bytes, BYTES_MAX)];
        if self.ahead == DEFAULT {
            let misses = self.misses() / none.misses();
            aims.push(Aim::at_most(format!("{camera}, {name}: misses over none's"), misses, MISSES_MAX));
        }
        aims
    }
}
