//! Frame rate over nodes and memory, on one machine, misses by kernel, and what one thread's ray kernel does.

mod kernel;
mod misses;
mod scenes;

use core::num::NonZeroU16;
use core::time::Duration;

use anyhow::Result;
use fault_linux::BackendKind;
use memsavvy::report::RunReport;
use memsavvy::run::{self, Options};
use memsavvy::session::Path;
use memsavvy::size::{Memory, PictureSize};

use crate::experiment::{Effort, Experiment};
use crate::findings::{Aim, Findings};
use crate::images::Images;
use crate::machine;
use crate::plot::{Axis, Chart, Line, Plot};
use crate::quiet;
use crate::spread::Spread;
use crate::table::{Cell, Table};
use scenes::{Scene, Scenes};

pub(crate) const EXPERIMENT: Experiment = Experiment {
    name: "scaling",
    shows: "frame rate with 1, 2 and 4 nodes, with all memory and with 16 %",
    run,
};

/// What a node may hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Holds {
    /// The whole image, nothing paged: the baseline.
    Replica,
    /// The whole image: home pages, and a slot for every page of others.
    All,
    /// The paper's 16 %; a store holds the home pages.
    Sixteen,
}

/// A cluster of this shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Shape {
    nodes: u16,
    holds: Holds,
}

/// How much is rendered.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Amount {
    nodes: &'static [u16],
    size: u32,
    frames: u32,
    reps: usize,
}

/// The runs of one cluster on one scene.
#[derive(Debug)]
struct Measured {
    shape: Shape,
    runs: Vec<RunReport>,
}

/// Two nodes that hold little of the scene are to lose little of what two cores allow.
const TWO: Shape = Shape { nodes: 2, holds: Holds::Sixteen };
const EFFICIENCY_MIN: f64 = 85.0;

const FULL: Amount = Amount { nodes: &[1, 2, 4], size: 512, frames: 9, reps: 5 };
const QUICK: Amount = Amount { nodes: &[1, 2], size: 48, frames: 2, reps: 1 };

fn run(effort: Effort) -> Result<Findings> {
    let amount = effort.pick(FULL, QUICK);
    let scenes = Scenes::prepare(effort)?;
    let mut findings = Findings::default();
    let (mut table, mut charts) = (table(amount), Vec::new());
    for scene in scenes.near() {
        let mut images = Images::default();
        let rounds = quiet::rounds(effort, &scene.name, amount.reps, |_| round(scene, amount, &mut images))?;
        let measured = Measured::by_shape(amount, &rounds.rounds);
        measured.iter().for_each(|of| table.push(of.row(scene, &measured)));
        let two = measured.iter().find(|of| of.shape == TWO).map_or(0.0, |two| two.efficiency(&measured));
        let what = format!("{}: efficiency of two nodes at 16 % memory, in %", scene.name);
        findings.aims.push(Aim::at_least(what, two, EFFICIENCY_MIN));
        table.note(format!("{}: {}", scene.name, rounds.note()));
        charts.push(chart(scene, &measured));
    }
    let (misses, aims) = misses::count(&scenes, amount)?;
    findings.aims.extend(aims);
    findings.tables = vec![table, misses, kernel::measure(&scenes, amount, effort)?];
    findings.plot = Some(Plot { charts });
    Ok(findings)
}

/// Runs every shape once.
fn round(scene: &Scene, amount: Amount, images: &mut Images) -> Result<Vec<RunReport>> {
    let run = |shape: Shape| {
        let run = run::run(&shape.options(scene, amount)?, |_| Ok(()))?;
        images.expect_same(&run)?;
        Ok(run)
    };
    amount.shapes().map(run).collect()
}

impl Amount {
    fn shapes(self) -> impl Iterator<Item = Shape> {
        let of = move |holds| self.nodes.iter().map(move |&nodes| Shape { nodes, holds });
        Holds::ALL.into_iter().flat_map(of)
    }
}

impl Holds {
    const ALL: [Self; 3] = [Self::Replica, Self::All, Self::Sixteen];

    const fn name(self) -> &'static str {
        match self {
            Self::Replica => "replicated",
            Self::All => "100 %",
            Self::Sixteen => "16 %",
        }
    }
}

impl Shape {
    fn options(self, scene: &Scene, amount: Amount) -> Result<Options> {
        let path = Path { frames: amount.frames, radius: scene.radius.into(), ..Path::default() };
        let session = path.session()?;
        let memory = match self.holds {
            Holds::Replica => None,
            Holds::All => Some(Memory::Share(1.0)),
            Holds::Sixteen => Some(Memory::Share(0.16)),
        };
        Ok(Options {
            source: scene.source(),
            nodes: self.nodes,
            stores: u16::from(self.holds == Holds::Sixteen),
            threads: Some(NonZeroU16::MIN),
            memory,
            backend: (self.holds == Holds::Replica).then_some(BackendKind::Replicated),
            size: PictureSize { width: amount.size, height: amount.size },
            session,
            deadline: Duration::from_secs(30),
            quiet: true,
            ..Options::default()
        })
    }
}

impl Measured {
    /// Sorts the runs of all rounds by the shape of their cluster.
    fn by_shape(amount: Amount, rounds: &[Vec<RunReport>]) -> Vec<Self> {
        let of = |(index, shape)| {
            let runs = rounds.iter().filter_map(|runs: &Vec<RunReport>| runs.get(index)).cloned().collect();
            Self { shape, runs }
        };
        amount.shapes().enumerate().map(of).collect()
    }

    /// Frames a second of each run. The first frame, which finds the caches empty, is left out.
    fn rates(&self) -> Vec<f64> {
        let rate = |run: &RunReport| {
            let warm = &run.frames[1..];
            warm.len() as f64 / warm.iter().map(|frame| frame.ms / 1e3).sum::<f64>()
        };
        self.runs.iter().map(rate).collect()
    }

    fn row(&self, scene: &Scene, all: &[Self]) -> Vec<Cell> {
        let Shape { nodes, holds } = self.shape;
        let rates = self.rates();
        let per_frame = |of: fn(&RunReport) -> u64| {
            let counts = self.runs.iter().map(|run| of(run) as f64 / run.frames.len() as f64);
            Spread::of(&counts.collect::<Vec<_>>()).median
        };
        vec![
            Cell::text(&*scene.name),
            Cell::text(holds.name()),
            Cell::Count(nodes.into()),
            Cell::Spread(Spread::of(&rates), 2),
            Cell::Number(rates.iter().copied().fold(0.0, f64::max), 2),
            Cell::Number(per_frame(|run| run.totals.fetched_pages), 0),
            Cell::Number(per_frame(|run| run.totals.received_bytes) / 1024.0, 0),
            Cell::Number(self.speed_up(all), 2),
            Cell::Number(self.efficiency(all), 0),
        ]
    }

    /// The frame rate, times that of one node with the same memory.
    fn speed_up(&self, all: &[Self]) -> f64 {
        let alone = Shape { nodes: 1, holds: self.shape.holds };
        let alone = all.iter().find(|of| of.shape == alone);
        alone.map_or(0.0, |alone| median(&self.rates()) / median(&alone.rates()))
    }

    /// The speed-up in % of what the cores allow.
    fn efficiency(&self, all: &[Self]) -> f64 {
        let usable = usize::from(self.shape.nodes).min(machine::cores());
        100.0 * self.speed_up(all) / usable as f64
    }
}

fn median(samples: &[f64]) -> f64 {
    Spread::of(samples).median
}

fn table(amount: Amount) -> Table {
    let Amount { size, frames, reps, .. } = amount;
    let title = format!(
        "frame rate: {size}x{size}, {frames} frames around the scene, {reps} repetitions, one thread a node"
    );
    let heads = [
        "scene",
        "memory",
        "nodes",
        "fps",
        "best fps",
        "misses/frame",
        "KB/frame",
        "speed-up",
        "efficiency %",
    ];
    let mut table = Table::new("scaling", title, &heads);
    table.note("fps without the first frame, which finds the caches empty; misses and bytes with it");
    table.note("16 %: the home pages lie in a store, a process more that renders nothing");
    table.note(format!(
        "efficiency: speed-up over one node with the same memory, of what {} cores allow",
        machine::cores()
    ));
    table
}

fn chart(scene: &Scene, measured: &[Measured]) -> Chart {
    let line = |holds: Holds| {
        let of = measured.iter().filter(|of| of.shape.holds == holds);
        let points = of.map(|of| (f64::from(of.shape.nodes), median(&of.rates())));
        Line { name: holds.name().to_owned(), points: points.collect() }
    };
    Chart {
        title: scene.name.clone(),
        x: Axis { label: "nodes, one thread each", is_logarithmic: false },
        y: Axis { label: "frames a second", is_logarithmic: false },
        lines: Holds::ALL.map(line).into(),
    }
}
