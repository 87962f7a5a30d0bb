//! Frames of one isovalue: everybody draws each in turns, round after round.

use anyhow::{Context, Result, ensure};
use rt_core::Frame;

use super::meshes::STRUCTURES;
use super::{Amount, RADIUS, Stand};
use crate::findings::Aim;
use crate::peers::drawn::Drawn;
use crate::peers::embree::{Mode, Structure};
use crate::peers::ours::Kernel;
use crate::quiet;
use crate::spread::Spread;
use crate::table::{Cell, Table};

/// The frames drawn so far.
pub(super) struct Frames {
    table: Table,
    aims: Vec<Aim>,
}

/// Who draws.
#[derive(Clone, Debug)]
struct Entrant {
    name: String,
    way: Way,
}

/// And how.
#[derive(Clone, Copy, Debug)]
enum Way {
    Ours(Kernel),
    Mesh { embree: usize, structure: Structure, mode: Mode },
}

/// Milliseconds a frame of one entrant, by round.
struct Standing {
    entrant: Entrant,
    ms: Vec<f64>,
}

/// Hits of a mesh, against those of the surface that it approximates.
const HITS_SHARE: f64 = 0.01;

/// Our frame takes at most so many times the best one's.
const TIME_MAX: f64 = 1.0;

impl Frames {
    pub(super) fn new(Amount { size, frames, rounds, .. }: Amount) -> Self {
        let title = format!(
            "frames of isosurfaces: {size}x{size}, {frames} frames from {RADIUS} diagonals, {rounds} rounds, one thread"
        );
        let heads = ["volume", "program", "ms/frame", "best ms", "ours / this", "hits"];
        let mut table = Table::new("iso_frames", title, &heads);
        table.note("processor time of the whole frame with shadows; ours / this: of laps of one round, our best kernel");
        table.note(
            "ours shades by gradients, a mesh by its triangles; ours lets no ray slip through, fast ones may",
        );
        Self { table, aims: Vec::new() }
    }

    pub(super) fn note(&mut self, note: &str) {
        self.table.note(note);
    }

    pub(super) fn measure(&mut self, stand: &mut Stand<'_>) -> Result<()> {
        let (entrants, frames) = (entrants(stand), stand.frames(stand.subject.isovalue)?);
        let hits = expect_same_surface(stand, &entrants, &frames[0])?;
        let (name, rounds) = (stand.subject.name.clone(), stand.amount.rounds);
        let rounds = quiet::rounds(stand.effort, &name, rounds, |_| round(stand, &entrants, &frames))?;
        let ms = |index: usize| rounds.rounds.iter().map(|ms: &Vec<f64>| ms[index]).collect();
        let standings: Vec<Standing> = entrants
            .into_iter()
            .enumerate()
            .map(|(index, entrant)| Standing { entrant, ms: ms(index) })
            .collect();
        let ours = best(&standings, true).context("nobody of ours draws")?;
        for (standing, hits) in standings.iter().zip(hits) {
            self.table.push(vec![
                Cell::text(&*name),
                Cell::text(&*standing.entrant.name),
                Cell::Spread(Spread::of(&standing.ms), 1),
                Cell::Number(standing.ms.iter().copied().fold(f64::INFINITY, f64::min), 1),
                Cell::Spread(ours.ratio_to(standing), 2),
                Cell::Count(hits),
            ]);
        }
        self.table.note(format!("{name}: {}", rounds.note()));
        let ratio = best(&standings, false).map(|peer| ours.ratio_to(peer).median);
        let what = format!("{name}: our frame, in the peer's best");
        self.aims.extend(ratio.map(|ratio| Aim::at_most(what, ratio, TIME_MAX)));
        Ok(())
    }

    pub(super) fn finish(self) -> (Table, Vec<Aim>) {
        (self.table, self.aims)
    }
}

/// Our fastest kernel and our rays; every Embree with every structure, in packets.
fn entrants(stand: &Stand<'_>) -> Vec<Entrant> {
    let ours = [Kernel::fastest(), Kernel::rays()];
    let ours =
        ours.map(|kernel| Entrant { name: format!("ours, {}", kernel.name()), way: Way::Ours(kernel) });
    let mut all = Vec::from(ours);
    let Some(meshes) = &stand.meshes else { return all };
    for (embree, peer) in meshes.embrees.iter().enumerate() {
        for structure in STRUCTURES {
            all.extend([Mode::Packet8, Mode::Packet16].map(|mode| Entrant {
                name: format!("{}, {}, {structure}, {}", meshes.edges.name(), peer.name, mode.name()),
                way: Way::Mesh { embree, structure, mode },
            }));
        }
    }
    all
}

/// That a frame has the hits of ours with everybody, but for a mesh's flat triangles. Returns the hits of all.
fn expect_same_surface(stand: &mut Stand<'_>, entrants: &[Entrant], frame: &Frame) -> Result<Vec<u64>> {
    let hits: Vec<u64> =
        entrants.iter().map(|entrant| Ok(draw(stand, entrant.way, frame)?.hits)).collect::<Result<_>>()?;
    for (entrant, &of) in entrants.iter().zip(&hits) {
        let apart = of.abs_diff(hits[0]) as f64;
        // A coarse volume's triangles are large.
        let is_like = apart <= HITS_SHARE * hits[0] as f64 || stand.effort.is_quick();
        ensure!(
            of > 0 && is_like,
            "{}: {of} hits of {}, and {} of ours",
            stand.subject.name,
            entrant.name,
            hits[0]
        );
    }
    Ok(hits)
}

/// Milliseconds a frame of everybody.
fn round(stand: &mut Stand<'_>, entrants: &[Entrant], frames: &[Frame]) -> Result<Vec<f64>> {
    let mut sums = vec![0.0; entrants.len()];
    for frame in frames {
        for (entrant, sum) in entrants.iter().zip(&mut sums) {
            // Once for the caches, which the one before has filled with his own.
            draw(stand, entrant.way, frame)?;
            *sum += draw(stand, entrant.way, frame)?.time.cpu_ms / frames.len() as f64;
        }
    }
    Ok(sums)
}

fn draw(stand: &mut Stand<'_>, way: Way, frame: &Frame) -> Result<Drawn> {
    match way {
        Way::Ours(kernel) => {
            let mut picture = vec![0; frame.width as usize * frame.height as usize];
            kernel.draw(&stand.scene, frame, &mut picture)
        }
        Way::Mesh { embree, structure, mode } => {
            let meshes = stand.meshes.as_mut().context("no mesh to draw")?;
            meshes.embrees[embree].draw(structure, mode, frame)
        }
    }
}

/// The fastest of ours, or of the others, by the median.
fn best(standings: &[Standing], of_ours: bool) -> Option<&Standing> {
    let median = |standing: &Standing| Spread::of(&standing.ms).median;
    let those = standings.iter().filter(|standing| matches!(standing.entrant.way, Way::Ours(_)) == of_ours);
    those.min_by(|a, b| median(a).total_cmp(&median(b)))
}

impl Standing {
    /// Our time in another's: laps of one round are compared, which were driven in turns.
    fn ratio_to(&self, other: &Self) -> Spread {
        Spread::of(&self.ms.iter().zip(&other.ms).map(|(ours, theirs)| ours / theirs).collect::<Vec<_>>())
    }
}
