//! The paper's Figure 7: misses and frame rate over the memory of a node, by balancer.
//!
//! Real processes: nodes of one thread, and a store that holds all pages, so that a node's whole memory is slots. Bunny
//! and dragon stand beside each other, as in the paper's session, and the camera goes around them.

use core::num::NonZeroU16;
use core::time::Duration;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use memsavvy::report::RunReport;
use memsavvy::run::{self, Options, Source};
use memsavvy::session::Path as Way;
use memsavvy::size::{Memory, PictureSize};
use rt_core::schedule::Balancer;
use scene::{BuildOptions, Mesh, build, builtin, read_mesh};

use crate::data;
use crate::experiment::{Effort, Experiment};
use crate::findings::{Aim, Findings};
use crate::images::Images;
use crate::plot::{Axis, Chart, Line, Plot};
use crate::spread::Spread;
use crate::table::{Cell, Table};

pub(crate) const EXPERIMENT: Experiment = Experiment {
    name: "fig7",
    shows: "misses and frame rate over the memory of a node, by balancer, as in the paper's Figure 7",
    run,
};

/// What a node may hold, in per cent of the image.
const SHARES: [u32; 6] = [4, 8, 16, 32, 64, 100];

/// The last is what the others are measured by.
const BALANCERS: [Balancer; 5] = [
    Balancer::Demand { window: 1 },
    Balancer::Demand { window: 3 },
    Balancer::Steal,
    Balancer::StealNear,
    Balancer::Static,
];

const NODES: u16 = 4;
const PAGE_BYTES: u32 = 4 << 10;

/// The runs of one balancer with one memory.
struct Runs {
    balancer: Balancer,
    share: u32,
    runs: Vec<RunReport>,
}

fn run(effort: Effort) -> Result<Findings> {
    let folder = std::env::temp_dir().join(format!("memsavvy-fig7-{}", std::process::id()));
    fs::create_dir_all(&folder).with_context(|| format!("cannot write to {}", folder.display()))?;
    let outcome = prepare(&folder, effort).and_then(|(image, name)| measure(&image, name, effort));
    // What cannot be removed lies in the system's temporary folder.
    let _ = fs::remove_dir_all(&folder);
    outcome
}

/// Writes the scene; gives back where it is, and its name.
fn prepare(folder: &Path, effort: Effort) -> Result<(PathBuf, &'static str)> {
    let files = ["bunny", "dragon"].map(|name| data::mesh_file(name, effort));
    let (mesh, name) = match files {
        [Some(bunny), Some(dragon)] if effort == Effort::Full => {
            (beside(read_mesh(&bunny)?, read_mesh(&dragon)?), "bunny + dragon")
        }
        _ => (builtin::knot(effort.pick(600_000, 20_000)), "knot"),
    };
    let image = folder.join("scene.msv");
    let built = build(mesh, &BuildOptions::default(), &|_| {})?;
    built.write(PAGE_BYTES, &mut BufWriter::new(File::create(&image)?), &|_| {})?;
    Ok((image, name))
}

/// Both meshes in one, the second to the right of the first.
fn beside(mut left: Mesh, right: Mesh) -> Mesh {
    let edge = |mesh: &Mesh, better: fn(f32, f32) -> f32, start: f32| {
        mesh.positions.iter().map(|position| position[0]).fold(start, better)
    };
    let (low, high) = (edge(&right, f32::min, f32::INFINITY), edge(&left, f32::max, f32::NEG_INFINITY));
    let first = u32::try_from(left.positions.len()).unwrap_or(u32::MAX);
    left.positions.extend(right.positions.iter().map(|[x, y, z]| [x - low + high, *y, *z]));
    left.triangles.extend(right.triangles.iter().map(|corners| corners.map(|corner| corner + first)));
    left
}

fn measure(image: &Path, name: &str, effort: Effort) -> Result<Findings> {
    let (frames, size, reps) = effort.pick((60, 512, 3), (3, 96, 1));
    let mut all = Vec::new();
    for share in effort.pick(&SHARES[..], &[16, 100]) {
        effort.say(&format!("{name}, {share} % memory"));
        let mut runs: Vec<Runs> =
            BALANCERS.map(|balancer| Runs { balancer, share: *share, runs: Vec::new() }).into();
        // In turns, so that what else the machine does meets all of them.
        for _ in 0..reps {
            for of in &mut runs {
                of.runs.push(run::run(&options(image, of.balancer, *share, frames, size)?, |_| Ok(()))?);
            }
        }
        all.extend(runs);
    }
    let mut images = Images::default();
    all.iter().flat_map(|of| &of.runs).try_for_each(|run| images.expect_same(run))?;
    Ok(Findings {
        tables: vec![table(&all, name, frames, size, reps)],
        aims: aims(&all),
        plot: Some(Plot {
            charts: vec![
                chart(&all, "misses a frame", Runs::misses),
                chart(&all, "frames a second", Runs::rate),
            ],
        }),
    })
}

fn options(image: &Path, balance: Balancer, share: u32, frames: u32, size: u32) -> Result<Options> {
    let way = Way { frames, circle: Some(180), radius: 0.75, ..Way::default() };
    Ok(Options {
        source: Source::Path(image.to_owned()),
        nodes: NODES,
        stores: 1,
        threads: Some(NonZeroU16::MIN),
        memory: Some(Memory::Share(f64::from(share) / 100.0)),
        page_bytes: Some(PAGE_BYTES),
        balance,
        size: PictureSize { width: size, height: size },
        session: way.session()?,
        deadline: Duration::from_secs(60),
        quiet: true,
        ..Options::default()
    })
}

impl Runs {
    fn median(&self, of: impl Fn(&RunReport) -> f64) -> f64 {
        Spread::of(&self.runs.iter().map(of).collect::<Vec<_>>()).median
    }

    /// Pages fetched a frame, over all nodes.
    fn misses(&self) -> f64 {
        self.median(|run| run.totals.fetched_pages as f64 / run.frames.len() as f64)
    }

    /// Frames a second, without the first, which finds the caches empty.
    fn rate(&self) -> f64 {
        self.median(|run| {
            let warm = &run.frames[1..];
            warm.len() as f64 / warm.iter().map(|frame| frame.ms / 1e3).sum::<f64>()
        })
    }

    fn moved(&self) -> f64 {
        let moved =
            |run: &RunReport| run.frames.iter().map(|frame| f64::from(frame.moved_tiles)).sum::<f64>();
        self.median(|run| moved(run) / run.frames.len() as f64)
    }
}

fn find(all: &[Runs], balancer: Balancer, share: u32) -> Option<&Runs> {
    all.iter().find(|of| of.balancer == balancer && of.share == share)
}

fn table(all: &[Runs], name: &str, frames: u32, size: u32, reps: usize) -> Table {
    let title = format!(
        "{name}: {size}x{size}, {frames} frames of an orbit of two degrees a frame, {NODES} nodes of one thread, a store, pages of 4 KB, median of {reps}"
    );
    let heads = ["memory %", "balancer", "misses a frame", "over demand:1", "fps", "tiles moved a frame"];
    let mut table = Table::new("fig7", title, &heads);
    for of in all {
        let demand = find(all, BALANCERS[0], of.share).map_or(0.0, Runs::misses);
        table.push(vec![
            Cell::Count(of.share.into()),
            Cell::text(of.balancer.to_string()),
            Cell::Number(of.misses(), 0),
            Cell::Number(of.misses() / demand, 2),
            Cell::Number(of.rate(), 2),
            Cell::Number(of.moved(), 1),
        ]);
    }
    table.note("misses: pages fetched by all nodes, with the first frame; fps without it");
    table.note("demand:K sends K tiles at a time to each thread; demand:1 is the paper's central queue");
    table.note("steal begins with tiles dealt like static's, steal-near with pieces of the curve on which tiles are drawn");
    table
}

fn aims(all: &[Runs]) -> Vec<Aim> {
    let over = |one: Balancer, other: Balancer, share: u32| {
        let misses = |balancer| find(all, balancer, share).map(Runs::misses);
        misses(one).zip(misses(other)).map(|(one, other)| one / other.max(1.0))
    };
    let mut aims = Vec::new();
    for share in SHARES.into_iter().filter(|share| *share <= 16) {
        if let Some(ratio) = over(Balancer::Steal, BALANCERS[0], share) {
            aims.push(Aim::at_most(format!("misses of steal over demand:1 at {share} %"), ratio, 0.8));
        }
    }
    for share in [8, 16] {
        if let Some(ratio) = over(Balancer::StealNear, Balancer::Steal, share) {
            aims.push(Aim::at_most(format!("misses of steal-near over steal at {share} %"), ratio, 0.7));
        }
    }
    if let Some(ratio) = over(Balancer::Steal, BALANCERS[0], 100) {
        aims.push(Aim::at_most("misses of steal over demand:1 at 100 %", ratio, 1.1));
    }
    aims
}

fn chart(all: &[Runs], label: &'static str, of: fn(&Runs) -> f64) -> Chart {
    let line = |balancer: Balancer| {
        let points = all.iter().filter(|runs| runs.balancer == balancer);
        let points = points.map(|runs| (f64::from(runs.share), of(runs))).collect();
        Line { name: balancer.to_string(), points }
    };
    Chart {
        title: format!("{label}, by memory"),
        x: Axis { label: "memory of a node, % of the image", is_logarithmic: true },
        y: Axis { label, is_logarithmic: false },
        lines: BALANCERS.map(line).into(),
    }
}
