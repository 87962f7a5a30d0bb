//! What a thread does when it meets a page that is absent: it waits; others draw while it waits; or it has asked before.
//!
//! Real processes, runs in turns. Where a thread only waits, its core is idle for as long as the page is under way, unless
//! there are more threads than cores; a tile whose pages were asked for ahead finds most of them there.

use core::num::NonZeroU16;
use core::time::Duration;

use anyhow::Result;
use memsavvy::report::RunReport;
use memsavvy::run::{self, Options, Prefetch, Source, TransportKind};
use memsavvy::session::{Path, Session};
use memsavvy::size::{Memory, PictureSize};
use scene::builtin::BuiltIn;

use crate::data;
use crate::experiment::{Effort, Experiment};
use crate::findings::{Aim, Findings};
use crate::images::Images;
use crate::machine::cores;
use crate::plot::{Axis, Chart, Line, Plot};
use crate::spread::Spread;
use crate::table::{Cell, Table};

pub(crate) const EXPERIMENT: Experiment = Experiment {
    name: "step-aside",
    shows: "threads that miss a page: waiting, more threads than cores, or asking before they trace",
    run,
};

/// What threads do about pages that are absent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Way {
    name: &'static str,
    threads: u16,
    prefetch: Prefetch,
}

/// The last is the default.
const WAYS: [Way; 4] = [
    Way { name: "wait", threads: 1, prefetch: Prefetch::None },
    Way { name: "2 threads", threads: 2, prefetch: Prefetch::None },
    Way { name: "4 threads", threads: 4, prefetch: Prefetch::None },
    Way { name: "ask first", threads: 1, prefetch: Prefetch::Tiles },
];

/// A cluster: its nodes, and how pages travel.
#[derive(Clone, Copy, Debug)]
struct Place {
    nodes: u16,
    transport: TransportKind,
}

/// Direct reads take some microseconds; a server thread in between, some tens.
const PLACES: [Place; 3] = [
    Place { nodes: 4, transport: TransportKind::Shm },
    Place { nodes: 4, transport: TransportKind::ShmRing },
    Place { nodes: 2, transport: TransportKind::ShmRing },
];

/// What a node may hold, of the image.
const SHARE: f64 = 0.16;

/// Runs of one way at one place.
struct Runs {
    place: Place,
    way: Way,
    runs: Vec<RunReport>,
}

fn run(effort: Effort) -> Result<Findings> {
    let (frames, size, reps) = effort.pick((40, 512, 5), (3, 96, 1));
    let (name, source) = source(effort);
    let session = Path { frames, circle: Some(180), radius: 0.75, ..Path::default() }.session()?;
    let mut all = Vec::new();
    for place in PLACES {
        effort.say(&format!("{name}: {} nodes, {}", place.nodes, place.name()));
        let mut runs: Vec<Runs> = WAYS.map(|way| Runs { place, way, runs: Vec::new() }).into();
        // In turns, so that what else the machine does meets all of them.
        for _ in 0..reps {
            for of in &mut runs {
                of.runs.push(run::run(&options(&source, &session, place, of.way, size), |_| Ok(()))?);
            }
        }
        all.extend(runs);
    }
    let mut images = Images::default();
    all.iter().flat_map(|of| &of.runs).try_for_each(|run| images.expect_same(run))?;
    let title = format!(
        "{name}: {size}x{size}, {frames} frames of two degrees each, 16 % memory a node and a store, {} cores, median of {reps}",
        cores()
    );
    Ok(Findings { tables: vec![table(&all, title)], aims: aims(&all), plot: Some(plot(&all)) })
}

fn source(effort: Effort) -> (&'static str, Source) {
    match data::mesh_file("bunny", effort).filter(|path| path.exists() && !effort.is_quick()) {
        Some(path) => ("bunny", Source::Path(path)),
        None => ("knot", Source::BuiltIn(BuiltIn::Knot { triangles: effort.pick(600_000, 5_000) })),
    }
}

fn options(source: &Source, session: &Session, place: Place, way: Way, size: u32) -> Options {
    Options {
        source: source.clone(),
        nodes: place.nodes,
        stores: 1,
        threads: NonZeroU16::new(way.threads),
        memory: Some(Memory::Share(SHARE)),
        page_bytes: Some(4 << 10),
        transport: place.transport,
        prefetch: way.prefetch,
        size: PictureSize { width: size, height: size },
        session: session.clone(),
        deadline: Duration::from_secs(60),
        quiet: true,
        ..Options::default()
    }
}

impl Place {
    const fn name(self) -> &'static str {
        match self.transport {
            TransportKind::Shm => "direct reads",
            TransportKind::ShmRing => "rings",
        }
    }
}

impl Runs {
    fn median(&self, of: impl Fn(&RunReport) -> f64) -> f64 {
        Spread::of(&self.runs.iter().map(of).collect::<Vec<_>>()).median
    }

    /// Frames a second, without the first, which finds the caches empty.
    fn rate(&self) -> f64 {
        self.median(|run| {
            let warm = &run.frames[1..];
            warm.len() as f64 / warm.iter().map(|frame| frame.ms / 1e3).sum::<f64>()
        })
    }

    /// Loads that met an absent page, a frame.
    fn faults(&self) -> f64 {
        self.median(|run| {
            run.nodes.iter().map(|node| node.faults).sum::<u64>() as f64 / run.frames.len() as f64
        })
    }

    /// Pages fetched a frame, asked for ahead or not.
    fn fetched(&self) -> f64 {
        self.median(|run| run.totals.fetched_pages as f64 / run.frames.len() as f64)
    }

    /// Milliseconds a frame in which a thread waited for a page.
    fn blocked_ms(&self) -> f64 {
        self.median(|run| {
            let us: f64 = run.nodes.iter().map(|node| node.faults as f64 * node.miss_p50_us).sum();
            us / 1e3 / run.frames.len() as f64
        })
    }
}

fn table(all: &[Runs], title: String) -> Table {
    let heads = [
        "nodes",
        "pages by",
        "way",
        "threads a node",
        "fps",
        "of waiting",
        "faults a frame",
        "pages a frame",
        "ms blocked a frame",
    ];
    let mut table = Table::new("step-aside", title, &heads);
    for runs in all.chunks(WAYS.len()) {
        for of in runs {
            table.push(vec![
                Cell::Count(of.place.nodes.into()),
                Cell::text(of.place.name()),
                Cell::text(of.way.name),
                Cell::Count(of.way.threads.into()),
                Cell::Number(of.rate(), 2),
                Cell::Number(of.rate() / runs[0].rate(), 3),
                Cell::Number(of.faults(), 0),
                Cell::Number(of.fetched(), 0),
                Cell::Number(of.blocked_ms(), 2),
            ]);
        }
    }
    table.note("faults: loads that met an absent page; pages: fetched because of them or ahead of them, by all nodes");
    table.note("ms blocked: faults times their median wait, over all threads; four nodes of one thread are more threads than two cores already");
    table
}

fn aims(all: &[Runs]) -> Vec<Aim> {
    let mut aims = Vec::new();
    for runs in all.chunks(WAYS.len()) {
        let Some((ours, others)) = runs.split_last() else { continue };
        let best = others.iter().map(Runs::rate).fold(0.0, f64::max);
        let place = format!("{} nodes, {}", ours.place.nodes, ours.place.name());
        aims.push(Aim::at_least(
            format!("{place}: frame rate of asking first, of the best other way"),
            ours.rate() / best.max(1e-9),
            1.0,
        ));
        aims.push(Aim::at_most(
            format!("{place}: time blocked of asking first, of waiting"),
            ours.blocked_ms() / others[0].blocked_ms().max(1e-9),
            0.7,
        ));
    }
    aims
}

fn plot(all: &[Runs]) -> Plot {
    let chart = |label: &'static str, of: fn(&Runs) -> f64| {
        let line = |runs: &[Runs]| {
            let points = (1..).zip(runs).map(|(way, runs)| (f64::from(way), of(runs)));
            let place = runs[0].place;
            Line { name: format!("{} nodes, {}", place.nodes, place.name()), points: points.collect() }
        };
        let x = Axis { label: "wait, 2 threads, 4 threads, ask first", is_logarithmic: false };
        let y = Axis { label, is_logarithmic: false };
        Chart { title: label.to_owned(), x, y, lines: all.chunks(WAYS.len()).map(line).collect() }
    };
    Plot { charts: vec![chart("frames a second", Runs::rate), chart("ms blocked a frame", Runs::blocked_ms)] }
}
