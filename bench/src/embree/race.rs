//! A race: everybody draws every frame in turns, round after round.

use anyhow::{Context, Result, ensure};
use rt_core::{Flat, Frame, SceneView};

use crate::experiment::Effort;
use crate::peers::drawn::Drawn;
use crate::peers::embree::{Edges, Mode, Peer, Quality};
use crate::peers::level::Level;
use crate::peers::ours::{Kernel, without_light};
use crate::quiet;
use crate::spread::Spread;

/// What is to be drawn, and how often.
#[derive(Debug)]
pub(super) struct Track {
    pub(super) name: String,
    /// At least one, all of one size.
    pub(super) frames: Vec<Frame>,
    /// Quiet rounds to make.
    pub(super) rounds: usize,
    pub(super) effort: Effort,
}

/// What everybody did on one track.
#[derive(Debug)]
pub(super) struct Race {
    pub(super) standings: Vec<Standing>,
    /// How quiet the rounds were.
    pub(super) note: String,
}

/// One who takes part, and their laps: one for each round, in the same order for all.
#[derive(Debug)]
pub(super) struct Standing {
    pub(super) entrant: Entrant,
    /// Frames of a lap.
    pub(super) frames: usize,
    laps: Vec<Lap>,
}

/// Who takes part.
#[derive(Clone, Debug)]
pub(super) struct Entrant {
    pub(super) name: String,
    /// The vectors they may use.
    pub(super) level: Level,
    pub(super) way: Way,
}

/// How an entrant draws.
#[derive(Clone, Copy, Debug)]
pub(super) enum Way {
    Ours(Kernel),
    Embree {
        /// Index of the peer.
        peer: usize,
        edges: Edges,
        mode: Mode,
    },
}

/// All frames, drawn once.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lap {
    /// With rays from the eye and to the light.
    pub(super) whole: Drawn,
    /// With rays from the eye alone.
    pub(super) primary: Drawn,
}

/// What is needed to draw.
#[derive(Debug)]
struct Field<'a> {
    scene: SceneView<Flat<'a>>,
    peers: &'a mut [Peer],
    picture: Vec<u8>,
}

/// Has everybody draw the frames, after asserting that they draw the same. `image` is ours of the scene.
pub(super) fn run(track: &Track, image: &[u8], peers: &mut [Peer]) -> Result<Race> {
    let Track { name, frames, rounds, effort } = track;
    let scene = SceneView::new(Flat::new(image))?;
    let entrants = entrants(peers);
    let first = frames.first().context("no frame to draw")?;
    let picture = vec![0; first.width as usize * first.height as usize];
    let mut field = Field { scene, peers, picture };
    field.expect_same_rays(&entrants, first).with_context(|| name.clone())?;
    let rounds = quiet::rounds(*effort, name, *rounds, |_| field.round(&entrants, frames))?;
    let laps = |index: usize| rounds.rounds.iter().map(|laps: &Vec<Lap>| laps[index]).collect();
    let standing = |(index, entrant)| Standing { entrant, frames: frames.len(), laps: laps(index) };
    let standings = entrants.into_iter().enumerate().map(standing).collect();
    Ok(Race { standings, note: rounds.note() })
}

/// All of ours, and Embree in all modes; with fast edges at the widest level only.
fn entrants(peers: &[Peer]) -> Vec<Entrant> {
    let ours = Kernel::available().map(|kernel| Entrant {
        name: format!("ours, {}", kernel.name()),
        level: kernel.level(),
        way: Way::Ours(kernel),
    });
    let widest = peers.iter().map(|peer| peer.level).max();
    let of_peer = |(index, peer): (usize, &Peer)| {
        let fast = (Some(peer.level) == widest).then_some(Edges::Fast);
        let edges = [Edges::Robust].into_iter().chain(fast);
        let (name, level) = (peer.name.clone(), peer.level);
        let embree = move |edges: Edges, mode: Mode| Entrant {
            name: format!("{name}, {}, {}", mode.name(), edges.name()),
            level,
            way: Way::Embree { peer: index, edges, mode },
        };
        edges.flat_map(move |edges| Mode::ALL.map(|mode| embree(edges, mode))).collect::<Vec<_>>()
    };
    ours.chain(peers.iter().enumerate().flat_map(of_peer)).collect()
}

impl Field<'_> {
    /// That everybody counts the same rays as the first.
    fn expect_same_rays(&mut self, entrants: &[Entrant], frame: &Frame) -> Result<()> {
        let mut first = None;
        for entrant in entrants {
            let drawn = self.draw(entrant, frame)?;
            let expected = first.get_or_insert(drawn);
            drawn.expect_like(expected).with_context(|| entrant.name.clone())?;
        }
        Ok(())
    }

    /// Each frame by everybody in turn, so that a slow spell of the machine hits all alike.
    fn round(&mut self, entrants: &[Entrant], frames: &[Frame]) -> Result<Vec<Lap>> {
        let mut laps = vec![Lap::default(); entrants.len()];
        for frame in frames {
            let dark = without_light(frame);
            for (entrant, lap) in entrants.iter().zip(&mut laps) {
                // Once for the caches, which the one before has filled with his own.
                self.draw(entrant, frame)?;
                lap.whole += self.draw(entrant, frame)?;
                lap.primary += self.draw(entrant, &dark)?;
                ensure!(lap.primary.shadow == 0, "{} casts shadow rays without light", entrant.name);
            }
        }
        Ok(laps)
    }

    fn draw(&mut self, entrant: &Entrant, frame: &Frame) -> Result<Drawn> {
        match entrant.way {
            Way::Ours(kernel) => kernel.draw(&self.scene, frame, &mut self.picture),
            Way::Embree { peer, edges, mode } => self.peers[peer].draw(edges.of(Quality::High), mode, frame),
        }
    }
}

impl Race {
    /// The fastest of those that `is_one` chooses, by the median of their laps.
    pub(super) fn best(&self, is_one: impl Fn(&Entrant) -> bool) -> Option<&Standing> {
        let rate = |standing: &Standing| standing.spread(Lap::mrays).median;
        let those = self.standings.iter().filter(|standing| is_one(&standing.entrant));
        those.max_by(|a, b| rate(a).total_cmp(&rate(b)))
    }
}

impl Standing {
    pub(super) fn spread(&self, of: fn(&Lap) -> f64) -> Spread {
        Spread::of(&self.laps.iter().map(of).collect::<Vec<_>>())
    }

    pub(super) fn best(&self, of: fn(&Lap) -> f64) -> f64 {
        self.laps.iter().map(of).fold(0.0, f64::max)
    }

    /// How many times the rays a second of another: laps of one round are compared, which were driven in turns.
    pub(super) fn ratio_to(&self, other: &Self) -> Spread {
        let laps = self.laps.iter().zip(&other.laps);
        Spread::of(&laps.map(|(ours, theirs)| ours.mrays() / theirs.mrays()).collect::<Vec<_>>())
    }
}

impl Entrant {
    pub(super) const fn is_ours(&self) -> bool {
        matches!(self.way, Way::Ours(_))
    }

    /// Embree as it is compared with ours, which lets no ray slip through either.
    pub(super) const fn is_robust_embree(&self) -> bool {
        matches!(self.way, Way::Embree { edges: Edges::Robust, .. })
    }
}

impl Lap {
    /// Millions of rays a second of processor time, all rays.
    pub(super) fn mrays(&self) -> f64 {
        mrays(self.whole.primary + self.whole.shadow, self.whole.time.cpu_ms)
    }

    /// The same of the rays from the eye, in pictures without shadow rays.
    pub(super) fn primary_mrays(&self) -> f64 {
        mrays(self.primary.primary, self.primary.time.cpu_ms)
    }

    /// The same of the rays to the light, in the time that these pictures save.
    pub(super) fn shadow_mrays(&self) -> f64 {
        mrays(self.whole.shadow, self.whole.time.cpu_ms - self.primary.time.cpu_ms)
    }
}

/// Millions of rays a second; 0 when there is no time to speak of.
fn mrays(rays: u64, ms: f64) -> f64 {
    if ms > 0.0 { rays as f64 / ms / 1e3 } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::peers::stopwatch::Elapsed;

    fn lap(whole_ms: f64) -> Lap {
        let time = |cpu_ms| Elapsed { cpu_ms, wall_ms: 0.0 };
        let whole = Drawn { time: time(whole_ms), primary: 3000, shadow: 1000, ..Drawn::default() };
        Lap { whole, primary: Drawn { time: time(1.0), primary: 3000, ..Drawn::default() } }
    }

    #[test]
    fn shadow_rays_are_charged_what_they_add() {
        let lap = lap(2.0);
        assert_eq!((lap.mrays(), lap.primary_mrays(), lap.shadow_mrays()), (2.0, 3.0, 1.0));
    }

    #[test]
    fn ratios_are_of_laps_of_one_round() {
        let entrant = Entrant { name: String::new(), level: Level::Portable, way: Way::Ours(Kernel::RAYS) };
        let standing =
            |ms: [f64; 3]| Standing { entrant: entrant.clone(), frames: 1, laps: ms.map(lap).into() };
        let (fast, slow) = (standing([2.0, 4.0, 2.0]), standing([4.0, 8.0, 4.0]));
        assert_eq!(fast.ratio_to(&slow), Spread { median: 2.0, low: 2.0, high: 2.0 });
    }
}
