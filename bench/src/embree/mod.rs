//! Our kernels against Embree, one thread each, drawing the same frames in turns.
//!
//! # The map
//!
//! | module | what it holds |
//! |---|---|
//! | [`subject`] | what is drawn, from where, and what is asked of it |
//! | [`race`] | everybody draws each frame in turns |
//! | [`structures`] | what building takes, and the memory of what is built |
//! | [`rates`] | the tables, aims and charts of a race |
//!
//! Embree and our kernels as competitors are in [`peers`](crate::peers).

mod race;
mod rates;
mod structures;
mod subject;

use anyhow::Result;

use crate::experiment::{Effort, Experiment};
use crate::findings::Findings;
use crate::peers::embree::Peer;
use crate::peers::folder::Folder;
use crate::peers::level::Level;
use crate::peers::pinned::Pinned;
use crate::peers::program::Programs;
use crate::plot::Plot;
use race::{Race, Track};
use rates::Rates;
use structures::Structures;
use subject::Subject;

pub(crate) const EXPERIMENT: Experiment = Experiment {
    name: "embree",
    shows: "rays a second, memory and build time of ours and of Embree 3 and 4, one thread each",
    run,
};

/// How much is built and drawn.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Amount {
    /// Width and height of the pictures; a multiple of a tile.
    size: u32,
    /// Frames around the scene.
    frames: u32,
    /// Quiet rounds in which everybody draws all frames.
    rounds: usize,
    builds: usize,
}

const FULL: Amount = Amount { size: 512, frames: 6, rounds: 5, builds: 3 };
const QUICK: Amount = Amount { size: 64, frames: 1, rounds: 1, builds: 1 };

fn run(effort: Effort) -> Result<Findings> {
    let amount = effort.pick(FULL, QUICK);
    let folder = Folder::create("embree")?;
    let programs = Programs::compile(&folder, effort)?;
    // From here on: the peers that this thread starts keep to its core too.
    let _pinned = Pinned::to_one_core();
    let (mut structures, mut rates) = (Structures::new(amount), Rates::new(amount));
    for subject in subject::all(effort)? {
        effort.say(&format!("{}: building", subject.name));
        let mut peers = start(&programs, &subject, &folder)?;
        let image = structures.build(&subject, &mut peers)?;
        let races = races(&subject, &image, &mut peers, amount, effort)?;
        rates.add(&subject, &races);
    }
    programs.notes.iter().for_each(|note| rates.note(note));
    let (charts, mut tables, mut aims) = rates.finish();
    let (builds, memory_aims) = structures.finish();
    tables.push(builds);
    aims.extend(memory_aims);
    Ok(Findings { tables, aims, plot: Some(Plot { charts }) })
}

/// Starts every program at every level on a subject.
fn start(programs: &Programs, subject: &Subject, folder: &Folder) -> Result<Vec<Peer>> {
    let file = folder.path(&format!("{}.scene", subject.name));
    subject.write(&file)?;
    let levels = Level::compared();
    programs.at_levels(&levels).map(|(level, program)| Peer::start(program, &file, level)).collect()
}

/// Has everybody draw a subject from all distances.
fn races(
    subject: &Subject,
    image: &[u8],
    peers: &mut [Peer],
    amount: Amount,
    effort: Effort,
) -> Result<Vec<(f32, Race)>> {
    let race = |radius: f32| {
        let (name, frames) = (format!("{} {radius}", subject.name), subject.frames(radius, amount)?);
        let track = Track { name, frames, rounds: amount.rounds, effort };
        Ok((radius, race::run(&track, image, peers)?))
    };
    subject.radii.into_iter().map(race).collect()
}
