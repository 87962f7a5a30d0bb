//! Error against run time of isosurfaces: every solver, with every type that samples can be stored as.
//!
//! # The map
//!
//! | module | what it holds |
//! |---|---|
//! | [`exact`] | where the rays of a picture meet the surface, in double precision, of the samples as they were read |
//! | [`errors`] | how far from there a solver finds it |

mod errors;
mod exact;

use anyhow::{Result, ensure};
use rt_core::{Flat, Frame, SceneView, Solver};
use scene::volume::StoredType;

use crate::experiment::{Effort, Experiment};
use crate::findings::{Aim, Findings};
use crate::peers::ours::Kernel;
use crate::peers::pinned::Pinned;
use crate::plot::{Axis, Chart, Line, Plot};
use crate::quiet::{self, Rounds};
use crate::spread::Spread;
use crate::table::{Cell, Table};
use crate::volumes::{Look, Subject};
use errors::Errors;
use exact::Exact;

pub(crate) const EXPERIMENT: Experiment = Experiment {
    name: "iso-error",
    shows: "isosurfaces: error against run time of every solver and every type of sample",
    run,
};

/// How much is drawn.
#[derive(Clone, Copy, Debug)]
struct Amount {
    /// Samples along an axis of the formulas.
    samples: u64,
    /// Width and height of the pictures.
    size: u32,
    frames: u32,
    rounds: usize,
}

const FULL: Amount = Amount { samples: 256, size: 512, frames: 2, rounds: 3 };
const QUICK: Amount = Amount { samples: 24, size: 48, frames: 1, rounds: 1 };

/// From near, most of the picture is covered.
const RADIUS: f32 = 0.75;

/// What the default promises where nothing is lost in storage: 999 of 1000 hits within this, in thousandths of a voxel.
const DISTANCE_MAX: f64 = 1.0;

/// And so many of a million pixels show another surface: rays that graze one.
const WRONG_MAX: f64 = 100.0;

/// The time of the default, in that of the solver that does least.
const TIME_MAX: f64 = 1.25;

/// A choice, and what it brought.
struct Measured {
    stored: StoredType,
    solver: Solver,
    errors: Errors,
    /// Milliseconds a frame.
    ms: Spread,
}

fn run(effort: Effort) -> Result<Findings> {
    let amount = effort.pick(FULL, QUICK);
    let mut subjects = vec![Subject::gyroid(amount.samples), Subject::marschner_lobb(amount.samples)];
    subjects.extend(Subject::scans(effort));
    let (mut table, mut findings, mut charts) = (table(amount), Findings::default(), Vec::new());
    for subject in subjects {
        let (measured, note) = measure(&subject, amount, effort)?;
        measured.iter().for_each(|of| table.push(of.row(&subject)));
        table.note(format!("{}: {note}", subject.name));
        findings.aims.extend(aims(&subject, &measured));
        charts.push(chart(&subject, &measured));
    }
    findings.tables = vec![table];
    findings.plot = Some(Plot { charts });
    Ok(findings)
}

fn measure(subject: &Subject, amount: Amount, effort: Effort) -> Result<(Vec<Measured>, String)> {
    effort.say(&format!("{}: the exact places", subject.name));
    let images: Vec<_> = StoredType::ALL
        .map(|stored| Ok((stored, subject.image(Some(stored))?)))
        .into_iter()
        .collect::<Result<_>>()?;
    let scenes: Vec<(StoredType, SceneView<Flat<'_>>)> = images
        .iter()
        .map(|(stored, image)| Ok((*stored, SceneView::new(Flat::new(image))?)))
        .collect::<Result<_>>()?;
    let choices: Vec<_> =
        scenes.iter().flat_map(|scene| Solver::ALL.map(|solver| Choice { scene, solver })).collect();
    let frames = frames(subject, &scenes[0].1, amount)?;
    let exact = Exact::of(subject, &frames)?;
    let errors: Vec<Errors> =
        choices.iter().map(|choice| exact.errors(&choice.scene.1, choice.solver)).collect::<Result<_>>()?;
    let rounds = times(subject, &choices, &frames, amount, effort)?;
    let ms = |index: usize| Spread::of(&rounds.rounds.iter().map(|times| times[index]).collect::<Vec<_>>());
    let measured = choices.iter().zip(errors).enumerate().map(|(index, (choice, errors))| {
        let Choice { scene: (stored, _), solver } = choice;
        Measured { stored: *stored, solver: *solver, errors, ms: ms(index) }
    });
    Ok((measured.collect(), rounds.note()))
}

/// What can be chosen.
struct Choice<'a> {
    scene: &'a (StoredType, SceneView<Flat<'a>>),
    solver: Solver,
}

fn frames(subject: &Subject, scene: &SceneView<Flat<'_>>, amount: Amount) -> Result<Vec<Frame>> {
    let look = |frame| Look { size: amount.size, radius: RADIUS, frame, frames: amount.frames };
    let view = &scene.header().view;
    (0..amount.frames)
        .map(|frame| Subject::frame(view, look(frame), subject.isovalue, Solver::default()))
        .collect()
}

/// Milliseconds a frame of each choice, each frame by all in turns, round after round.
fn times(
    subject: &Subject,
    choices: &[Choice<'_>],
    frames: &[Frame],
    amount: Amount,
    effort: Effort,
) -> Result<Rounds<Vec<f64>>> {
    let _pinned = Pinned::to_one_core();
    let kernel = Kernel::fastest();
    let mut picture = vec![0; amount.size as usize * amount.size as usize];
    quiet::rounds(effort, &subject.name, amount.rounds, |_| {
        let mut sums = vec![0.0; choices.len()];
        for frame in frames {
            for (choice, sum) in choices.iter().zip(&mut sums) {
                let frame = frame.with_isosurfaces(frame.isosurfaces(), choice.solver)?;
                // Once for the caches, which the one before has filled with another image.
                kernel.draw(&choice.scene.1, &frame, &mut picture)?;
                let drawn = kernel.draw(&choice.scene.1, &frame, &mut picture)?;
                ensure!(drawn.hits > 0, "{} shows nothing", subject.name);
                *sum += drawn.time.cpu_ms / frames.len() as f64;
            }
        }
        Ok(sums)
    })
}

impl Measured {
    fn row(&self, subject: &Subject) -> Vec<Cell> {
        let Errors { hits, elsewhere, distance, angle, .. } = &self.errors;
        vec![
            Cell::text(&*subject.name),
            Cell::text(self.stored.name()),
            Cell::text(self.solver.name()),
            Cell::Number(distance.largest, 5),
            Cell::Number(distance.p999, 6),
            Cell::Number(distance.rms, 7),
            Cell::Count(*elsewhere),
            Cell::Count(*hits),
            Cell::Number(angle.p999, 3),
            Cell::Number(angle.rms, 4),
            Cell::Spread(self.ms, 1),
        ]
    }
}

fn table(Amount { size, frames, .. }: Amount) -> Table {
    let title = format!(
        "errors of isosurfaces: {size}x{size}, {frames} frames from {RADIUS} diagonals, one thread; distances in voxels"
    );
    let heads = [
        "volume",
        "stored",
        "solver",
        "max",
        "99.9 %",
        "rms",
        "elsewhere",
        "of hits",
        "normal 99.9 %, degrees",
        "rms, degrees",
        "ms/frame",
    ];
    let mut table = Table::new("iso_error", title, &heads);
    table.note("against double precision, of the samples as they were read: what storage loses counts too");
    table.note(
        "elsewhere: hit or missed in one of both only, or more than a voxel away; not among the distances",
    );
    table.note("t is single precision: from 300 voxels away its last bit is 0.00003 voxels");
    table.note("ms/frame: processor time of the whole frame with shadows, the fastest kernel");
    table
}

fn aims(subject: &Subject, measured: &[Measured]) -> Vec<Aim> {
    let of = |solver: Solver| measured.iter().find(|of| of.stored == StoredType::F32 && of.solver == solver);
    let (Some(best), Some(least)) = (of(Solver::default()), of(Solver::Linear)) else { return Vec::new() };
    let name = format!("{}, f32, {}", subject.name, Solver::default());
    let Errors { rays, elsewhere, distance, .. } = &best.errors;
    let per_million = 1e6 * *elsewhere as f64 / *rays as f64;
    let time = best.ms.median / least.ms.median;
    vec![
        Aim::at_most(
            format!("{name}: 99.9 % of the hits within, in thousandths of a voxel"),
            1e3 * distance.p999,
            DISTANCE_MAX,
        ),
        Aim::at_most(
            format!("{name}: pixels that show another surface, of a million"),
            per_million,
            WRONG_MAX,
        ),
        Aim::at_most(format!("{name}: time of a frame, in that of linear"), time, TIME_MAX),
    ]
}

/// Errors over time: a line for each solver, from samples of one byte to samples of four.
fn chart(subject: &Subject, measured: &[Measured]) -> Chart {
    let line = |solver: Solver| {
        let of = measured.iter().filter(|of| of.solver == solver);
        let points = of.map(|of| (of.ms.median, of.errors.distance.rms.max(f64::from(f32::EPSILON))));
        Line { name: solver.name().to_owned(), points: points.collect() }
    };
    Chart {
        title: format!("{}: samples of u8, u16, f32", subject.name),
        x: Axis { label: "ms a frame", is_logarithmic: false },
        y: Axis { label: "rms error, voxels", is_logarithmic: true },
        lines: Solver::ALL.map(line).into(),
    }
}
