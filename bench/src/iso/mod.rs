//! Isosurfaces of ours against a mesh of each: VTK's flying edges extract it, Embree draws it. One thread each.
//!
//! # The map
//!
//! | module | what it holds |
//! |---|---|
//! | [`flying_edges`], [`meshes`] | a running `peers/flying_edges.py`; it and Embree together |
//! | [`frames`] | everybody draws each frame in turns |
//! | [`changes`] | the first picture of another isovalue |
//! | [`memory`] | the bytes that each holds |
//! | [`pages`] | pages that a frame touches, and those that it shows |

mod changes;
mod flying_edges;
mod frames;
mod memory;
mod meshes;
mod pages;

use anyhow::Result;
use rt_core::{Flat, Frame, SceneView, Solver};

use crate::experiment::{Effort, Experiment};
use crate::findings::Findings;
use crate::peers::folder::Folder;
use crate::peers::pinned::Pinned;
use crate::peers::program::Programs;
use crate::plot::Plot;
use crate::volumes::{Look, Subject};
use changes::Changes;
use frames::Frames;
use memory::Memory;
use meshes::Meshes;
use pages::Pages;

pub(crate) const EXPERIMENT: Experiment = Experiment {
    name: "iso",
    shows: "isosurfaces against flying edges and Embree: frame, change of isovalue, memory, pages",
    run,
};

/// How much is drawn.
#[derive(Clone, Copy, Debug)]
struct Amount {
    /// Samples along an axis of the formulas.
    samples: &'static [u64],
    /// Width and height of the pictures; a multiple of Embree's tiles.
    size: u32,
    /// Frames around a volume.
    frames: u32,
    /// Quiet rounds of frames, and of changes.
    rounds: usize,
}

const FULL: Amount = Amount { samples: &[256, 512], size: 512, frames: 4, rounds: 3 };
const QUICK: Amount = Amount { samples: &[24], size: 64, frames: 1, rounds: 1 };

/// From near, most of the picture is covered.
const RADIUS: f32 = 0.75;

/// A volume being looked at, and who looks.
struct Stand<'a> {
    subject: &'a Subject,
    image: &'a [u8],
    scene: SceneView<Flat<'a>>,
    /// `None` when VTK or Embree is not here.
    meshes: Option<Meshes>,
    amount: Amount,
    effort: Effort,
}

fn run(effort: Effort) -> Result<Findings> {
    let amount = effort.pick(FULL, QUICK);
    let folder = Folder::create("iso")?;
    let programs = Programs::compile(&folder, effort)?;
    // From here on: the peers that this thread starts keep to its core too.
    let _pinned = Pinned::to_one_core();
    let (mut frames, mut changes) = (Frames::new(amount), Changes::new(amount));
    let (mut memory, mut pages) = (Memory::new(), Pages::new(amount));
    let mut notes = programs.notes.clone();
    for subject in subjects(amount, effort) {
        effort.say(&format!("{}: preparing", subject.name));
        let image = subject.image(None)?;
        let scene = SceneView::new(Flat::new(&image))?;
        let meshes = Meshes::start(&programs, &subject, &scene, &folder, &mut notes)?;
        let mut stand = Stand { subject: &subject, image: &image, scene, meshes, amount, effort };
        frames.measure(&mut stand)?;
        changes.measure(&mut stand)?;
        memory.add(&stand);
        pages.count(&stand)?;
    }
    notes.iter().for_each(|note| frames.note(note));
    let mut findings = Findings::default();
    let charts = changes.charts();
    for (table, aims) in [frames.finish(), changes.finish(), memory.finish(), pages.finish()] {
        findings.tables.push(table);
        findings.aims.extend(aims);
    }
    findings.plot = Some(Plot { charts });
    Ok(findings)
}

/// Both formulas, the gyroid in every size, and the scans that are here.
fn subjects(amount: Amount, effort: Effort) -> Vec<Subject> {
    let (small, large) =
        amount.samples.split_first().map_or((24, [].as_slice()), |(small, large)| (*small, large));
    let formulas = [Subject::gyroid(small), Subject::marschner_lobb(small)].into_iter();
    formulas.chain(large.iter().map(|&n| Subject::gyroid(n))).chain(Subject::scans(effort)).collect()
}

impl Stand<'_> {
    /// The frames around the volume, at an isovalue.
    fn frames(&self, isovalue: f32) -> Result<Vec<Frame>> {
        let Amount { size, frames, .. } = self.amount;
        let look = |frame| Look { size, radius: RADIUS, frame, frames };
        let view = &self.scene.header().view;
        (0..frames).map(|frame| Subject::frame(view, look(frame), isovalue, Solver::default())).collect()
    }
}
