//! The first picture of another isovalue.
//!
//! Ours just draws it. The peer extracts a mesh, builds a structure by Morton codes, which is its fastest, and draws;
//! carrying the mesh from one program to the other is not counted.

use anyhow::{Context, Result};
use rt_core::Frame;
use scene::volume::VolumeName;

use super::meshes::{Meshes, STRUCTURES};
use super::{Amount, Stand};
use crate::findings::Aim;
use crate::peers::embree::Mode;
use crate::peers::ours::Kernel;
use crate::plot::{Axis, Chart, Line};
use crate::quiet;
use crate::spread::Spread;
use crate::table::{Cell, Table};

/// The changes measured so far.
pub(super) struct Changes {
    table: Table,
    aims: Vec<Aim>,
    charts: Vec<Chart>,
}

/// What one change cost, in milliseconds.
#[derive(Clone, Copy, Debug, Default)]
struct Change {
    extract: f64,
    build: f64,
    /// The first picture.
    first: f64,
    /// The same picture again.
    again: f64,
}

/// Our first picture of another isovalue, in the same picture again.
const FIRST_MAX: f64 = 1.1;

/// Pictures after a change that the chart shows.
const SHOWN: f64 = 30.0;

impl Changes {
    pub(super) fn new(Amount { size, rounds, .. }: Amount) -> Self {
        let title = format!(
            "the first picture of another isovalue: {size}x{size}, {rounds} rounds of three changes, ms"
        );
        let heads = ["volume", "program", "extract", "build", "first picture", "same again", "until seen"];
        let mut table = Table::new("iso_changes", title, &heads);
        table.note("processor time; until seen: extract, build and the first picture together");
        Self { table, aims: Vec::new(), charts: Vec::new() }
    }

    pub(super) fn measure(&mut self, stand: &mut Stand<'_>) -> Result<()> {
        let isovalues = isovalues(stand);
        let frames: Vec<Frame> =
            isovalues.map(|value| Ok(stand.frames(value)?[0])).into_iter().collect::<Result<_>>()?;
        let (name, rounds) = (format!("{}, changes", stand.subject.name), stand.amount.rounds);
        let rounds = quiet::rounds(stand.effort, &name, rounds, |_| round(stand, isovalues, &frames))?;
        let of = |index: usize| -> Vec<Change> {
            rounds
                .rounds
                .iter()
                .flat_map(|changes| changes.iter().map(move |of: &Vec<Change>| of[index]))
                .collect()
        };
        let programs = programs(stand.meshes.as_ref());
        let mut lines = Vec::new();
        for (index, program) in programs.into_iter().enumerate() {
            let changes = of(index);
            self.table.push(row(&stand.subject.name, &program, &changes));
            let median = |of: fn(&Change) -> f64| spread(&changes, of).median;
            if index == 0 {
                let what = format!(
                    "{}: our first picture of another isovalue, in the same again",
                    stand.subject.name
                );
                let ratio = spread(&changes, |change| change.first / change.again).median;
                self.aims.push(Aim::at_most(what, ratio, FIRST_MAX));
            }
            let (seen, again) = (median(Change::until_seen), median(|change| change.again));
            lines.push(Line {
                name: program,
                points: vec![(1.0, seen), (SHOWN, seen + (SHOWN - 1.0) * again)],
            });
        }
        self.table.note(format!("{name}: {}", rounds.note()));
        self.charts.push(Chart {
            title: stand.subject.name.clone(),
            x: Axis { label: "pictures after a change of isovalue", is_logarithmic: false },
            y: Axis { label: "ms since the change", is_logarithmic: false },
            lines,
        });
        Ok(())
    }

    pub(super) fn charts(&mut self) -> Vec<Chart> {
        core::mem::take(&mut self.charts)
    }

    pub(super) fn finish(self) -> (Table, Vec<Aim>) {
        (self.table, self.aims)
    }
}

impl Change {
    fn until_seen(&self) -> f64 {
        self.extract + self.build + self.first
    }
}

/// A step up, a step down, and the one that everything else is measured with.
fn isovalues(stand: &Stand<'_>) -> [f32; 3] {
    let step = if matches!(stand.subject.volume, VolumeName::Analytic { .. }) { 0.05 } else { 5.0 };
    [step, -step, 0.0].map(|step| stand.subject.isovalue + step)
}

/// Ours, and each Embree.
fn programs(meshes: Option<&Meshes>) -> Vec<String> {
    let kernel = Kernel::fastest();
    let mut names = vec![format!("ours, {}", kernel.name())];
    if let Some(meshes) = meshes {
        let name = |embree: &crate::peers::embree::Peer| {
            format!("{}, {}, {}", meshes.edges.name(), embree.name, STRUCTURES[0])
        };
        names.extend(meshes.embrees.iter().map(name));
    }
    names
}

/// Every change, by everybody.
fn round(stand: &mut Stand<'_>, isovalues: [f32; 3], frames: &[Frame]) -> Result<Vec<Vec<Change>>> {
    let mut before = frames.last().context("no frame to draw")?;
    let mut round = Vec::new();
    for (isovalue, frame) in isovalues.into_iter().zip(frames) {
        let mut changes = vec![ours(stand, before, frame)?];
        if let Some(meshes) = &mut stand.meshes {
            let extracted = meshes.extract(isovalue)?;
            for embree in 0..meshes.embrees.len() {
                let built = meshes.rebuild(embree, STRUCTURES[0])?;
                let mut draw = || meshes.embrees[embree].draw(STRUCTURES[0], Mode::Packet16, frame);
                let (first, again) = (draw()?.time.cpu_ms, draw()?.time.cpu_ms);
                changes.push(Change {
                    extract: extracted.time.cpu_ms,
                    build: built.time.cpu_ms,
                    first,
                    again,
                });
            }
        }
        round.push(changes);
        before = frame;
    }
    Ok(round)
}

/// The isovalue before fills the caches, as in a session.
fn ours(stand: &Stand<'_>, before: &Frame, frame: &Frame) -> Result<Change> {
    let kernel = Kernel::fastest();
    let mut picture = vec![0; frame.width as usize * frame.height as usize];
    let mut draw =
        |frame: &Frame| Ok::<_, anyhow::Error>(kernel.draw(&stand.scene, frame, &mut picture)?.time.cpu_ms);
    draw(before)?;
    let (first, again) = (draw(frame)?, draw(frame)?);
    Ok(Change { first, again, ..Change::default() })
}

fn row(subject: &str, program: &str, changes: &[Change]) -> Vec<Cell> {
    let cell = |of: fn(&Change) -> f64| Cell::Spread(spread(changes, of), 1);
    vec![
        Cell::text(subject),
        Cell::text(program),
        cell(|change| change.extract),
        cell(|change| change.build),
        cell(|change| change.first),
        cell(|change| change.again),
        cell(Change::until_seen),
    ]
}

fn spread(changes: &[Change], of: fn(&Change) -> f64) -> Spread {
    Spread::of(&changes.iter().map(of).collect::<Vec<_>>())
}
