//! The paper's Figure 5: a session on a volume larger than a node's memory.
//!
//! # The map
//!
//! | module | what it holds |
//! |---|---|
//! | [`system`] | how a node comes to its data: all of it, by pages, by objects |
//! | [`sessions`] | the runs of one system, and what they give |

mod sessions;
mod system;

use std::fs::File;
use std::path::{self, PathBuf};

use anyhow::{Context, Result};
use memsavvy::report::RunReport;
use memsavvy::run;
use memsavvy::session::{Path, Session, Sweep, Way};
use scene::write_volume;

use crate::experiment::{Effort, Experiment};
use crate::findings::{Aim, Findings};
use crate::images::Images;
use crate::machine;
use crate::peers::folder::Folder;
use crate::plot::{Axis, Chart, Line, Plot};
use crate::quiet;
use crate::table::{Cell, Table};
use crate::volumes::{self, Subject};
use sessions::{Part, Sessions};
use system::System;

pub(crate) const EXPERIMENT: Experiment = Experiment {
    name: "fig5",
    shows: "a session on a volume with 16 % memory a node: replicated, paged, object-based",
    run,
};

/// How much is rendered.
#[derive(Clone, Copy, Debug)]
struct Amount {
    /// Samples along an axis of the volume.
    samples: u64,
    frames: u32,
    /// Width and height of the pictures.
    size: u32,
    rounds: usize,
}

const FULL: Amount = Amount { samples: 512, frames: 100, size: 512, rounds: 3 };
const QUICK: Amount = Amount { samples: 48, frames: 4, size: 48, rounds: 1 };

const NODES: u16 = 4;
const STORES: u16 = 2;

/// The paper's: 81 MB of 512 MB.
const MEMORY: f64 = 0.16;

/// Two degrees a frame.
const CIRCLE: u32 = 180;

/// The whole object fills the picture.
const RADIUS: f64 = 1.0;

/// The isovalue moves from here to there while the whole object is in view.
const ISOVALUES: Sweep = Sweep { from: -0.3, to: 0.0 };

/// Who is held against whom, over which part of the session, and the least ratio of their frames a second. In the paper,
/// paged has 0.82 of replicated, and 2.5 times objects.
const AIMS: [(System, System, Part, f64); 9] = [
    (System::Uffd, System::Replicated, Part::Whole, 0.95),
    (System::Uffd, System::Replicated, Part::Second, 0.99),
    (System::Segv, System::Replicated, Part::Whole, 0.95),
    (System::Segv, System::Replicated, Part::Second, 0.99),
    (System::Uffd, System::Objects, Part::Whole, 2.5),
    (System::Segv, System::Objects, Part::Whole, 2.5),
    (System::UffdByRays, System::ObjectsByRays, Part::Whole, 2.5),
    (System::Uffd, System::ObjectsByRays, Part::Whole, 2.5),
    (System::Segv, System::ObjectsByRays, Part::Whole, 2.5),
];

fn run(effort: Effort) -> Result<Findings> {
    let amount = effort.pick(FULL, QUICK);
    let folder = Folder::create("fig5")?;
    effort.say("preparing the volume");
    let image = prepare(amount, &folder)?;
    let session = session(amount)?;
    let mut images = Images::default();
    let rounds =
        quiet::rounds(effort, "fig5", amount.rounds, |_| round(&image, &session, amount, &mut images))?;
    let of = |(index, system): (usize, System)| {
        let runs = rounds.rounds.iter().map(|runs: &Vec<RunReport>| runs[index].clone()).collect();
        Sessions { system, runs }
    };
    let all: Vec<Sessions> = System::ALL.into_iter().enumerate().map(of).collect();
    let mut table = table(amount, &all);
    table.note(rounds.note());
    let plot = Some(Plot { charts: vec![chart(amount, &all)] });
    Ok(Findings { tables: vec![table], aims: aims(&all), plot })
}

/// Writes the image of the volume, once for all runs.
fn prepare(amount: Amount, folder: &Folder) -> Result<PathBuf> {
    let path = folder.path("volume.msv");
    let file = File::options().read(true).write(true).create_new(true).open(&path);
    let mut file = file.with_context(|| format!("cannot write {}", path.display()))?;
    let mut source = Subject::gyroid(amount.samples).open()?;
    write_volume(&mut *source, None, None, volumes::PAGE_BYTES, &mut file, &|_| {})?;
    Ok(path)
}

/// First half: the whole object, its isovalue moving. Second half: close up.
fn session(amount: Amount) -> Result<Session> {
    let Amount { frames, .. } = amount;
    let path = Path {
        way: Way::Volume,
        frames,
        circle: Some(CIRCLE),
        radius: RADIUS,
        isovalues: Some(ISOVALUES),
        ..Path::default()
    };
    path.session()
}

/// One session by each system; each starts with nothing of the volume in its caches.
fn round(
    image: &path::Path,
    session: &Session,
    amount: Amount,
    images: &mut Images,
) -> Result<Vec<RunReport>> {
    let run = |system: System| {
        let run = run::run(&system.options(image, session, amount.size), |_| Ok(()))?;
        images.expect_same(&run).with_context(|| system.name())?;
        Ok(run)
    };
    System::ALL.into_iter().map(run).collect()
}

fn table(amount: Amount, all: &[Sessions]) -> Table {
    let Amount { samples, frames, size, rounds } = amount;
    let title = format!(
        "a session of {frames} frames of {size}x{size} on {samples}^3 samples of f32: {NODES} nodes with {:.0} % memory \
         each, {STORES} stores, from a cold start; {rounds} rounds",
        100.0 * MEMORY
    );
    let heads = [
        "system",
        "fps",
        "first half",
        "second half",
        "first frame ms",
        "of replicated",
        "second half of it",
        "misses",
        "MB fetched",
        "node's peak MB",
    ];
    let mut table = Table::new("fig5", title, &heads);
    let replicated = &all[0];
    for sessions in all {
        table.push(vec![
            Cell::text(sessions.system.name()),
            Cell::Spread(sessions.fps(Part::Whole), 2),
            Cell::Spread(sessions.fps(Part::First), 2),
            Cell::Spread(sessions.fps(Part::Second), 2),
            Cell::Spread(sessions.first_frame_ms(), 0),
            Cell::Spread(sessions.ratio_to(replicated, Part::Whole), 3),
            Cell::Spread(sessions.ratio_to(replicated, Part::Second), 3),
            Cell::Number(sessions.fetched_pages(), 0),
            Cell::Number(sessions.fetched_bytes() / 1e6, 1),
            Cell::Number(sessions.peak_bytes() / 1e6, 1),
        ]);
    }
    table.note(format!(
        "first half: the whole object in view while its isovalue goes from {} to {}; second half: close up",
        ISOVALUES.from, ISOVALUES.to
    ));
    table.note(format!(
        "{NODES} nodes of one thread and the stores share {} cores: trust the ratios, which are of one round each",
        machine::cores()
    ));
    table.note("misses: pages fetched in the whole session by all nodes; the stores hold all of the volume, and draw nothing");
    table.note("objects: no paging hardware; a record is looked up in a table each time it is read, and held while it is read");
    table.note("ray by ray: each ray reads its records itself, as the paper's did, where a beam reads one for hundreds of rays; objects are the paper's that way");
    table
}

fn aims(all: &[Sessions]) -> Vec<Aim> {
    let of = |system: System| all.iter().find(|sessions| sessions.system == system);
    let mut aims = Vec::new();
    for (paged, other, part, least) in AIMS {
        if let (Some(paged), Some(other)) = (of(paged), of(other)) {
            let half = if part == Part::Second { ", second half" } else { "" };
            let what = format!(
                "{}: frames a second, of those of {}{half}",
                paged.system.name(),
                other.system.name()
            );
            aims.push(Aim::at_least(what, paged.ratio_to(other, part).median, least));
        }
    }
    aims
}

/// Frame rate over time.
fn chart(amount: Amount, all: &[Sessions]) -> Chart {
    let line =
        |sessions: &Sessions| Line { name: sessions.system.name().to_owned(), points: sessions.rates() };
    Chart {
        title: format!("{NODES} nodes with {:.0} % of {}^3 samples each", 100.0 * MEMORY, amount.samples),
        x: Axis { label: "frame", is_logarithmic: false },
        y: Axis { label: "frames a second", is_logarithmic: false },
        lines: all.iter().map(line).collect(),
    }
}
