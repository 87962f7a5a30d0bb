//! Cases that are hard on a balancer's feedback.

use dsm_core::id::NodeId;
use rt_core::schedule::Balancer;

use super::world::{Config, Report, Workload};
use crate::chance::mix;
use crate::fault::{Fault, Faults};
use crate::network::{Link, Links};
use crate::time::{Moment, ms, us};

/// A case: what tiles cost, and what is wrong with the cluster. Eight nodes of one thread, 16 x 16 tiles of about 1 ms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Case {
    /// Costs from 0.7 to 1.3 ms, the same in each frame but for two in a hundred of noise.
    Steady,
    /// One tile takes 10,000 times as long as each of the others.
    DearTile,
    /// Now the upper half of the picture takes ten times as long, now the lower.
    Alternating,
    /// One node takes a hundred times as long for everything.
    SlowNode,
    /// One node does nothing for a second, now and then.
    Stalls,
    /// A round trip takes 100 ms.
    Far,
}

impl Case {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Steady, Self::DearTile, Self::Alternating, Self::SlowNode, Self::Stalls, Self::Far];

    /// What it is, in a few words.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Steady => "steady view",
            Self::DearTile => "one tile 10,000 times dearer",
            Self::Alternating => "costs that alternate each frame",
            Self::SlowNode => "one node 100 times slower",
            Self::Stalls => "stalls of a second",
            Self::Far => "round trips of 100 ms",
        }
    }

    /// The cluster of the case.
    #[must_use]
    pub fn config(self, balancer: Balancer) -> Config {
        let mut config = Config { frames: 30, ..Config::new(8, balancer) };
        match self {
            Self::Steady | Self::DearTile | Self::Alternating => {}
            Self::SlowNode => {
                let fault = Fault::Slow { node: NodeId(3), percent: 10_000 };
                config.faults = Faults { schedule: vec![(Moment::ZERO, fault)], ..Faults::default() };
            }
            Self::Stalls => {
                let stall = |at| (Moment::from_ns(ms(at)), Fault::Stall { node: NodeId(5), ns: ms(1000) });
                config.faults = Faults { schedule: vec![stall(100), stall(1500)], ..Faults::default() };
                config.frames = 60;
            }
            Self::Far => {
                config.network.links = Links::Same(Link::new(ms(50)));
                config.resend_us = 250_000;
            }
        }
        config
    }

    /// Mean time of a frame in milliseconds, without the first two, in which a balancer learns.
    #[must_use]
    pub fn frame_ms(report: &Report) -> f64 {
        let frames = report.frames.get(2..).unwrap_or_default();
        frames.iter().map(|frame| frame.ns as f64 / 1e6).sum::<f64>() / frames.len().max(1) as f64
    }

    /// Frames until the time of a frame stays within a fifth of what it is in the end.
    #[must_use]
    pub fn settles_after(report: &Report) -> usize {
        let half = &report.frames[report.frames.len() / 2..];
        let mut late: Vec<u64> = half.iter().map(|frame| frame.ns).collect();
        late.sort_unstable();
        let end_ns = late.get(late.len() / 2).copied().unwrap_or(0);
        let is_off = |ns: u64| ns.abs_diff(end_ns) > end_ns / 5;
        report.frames.iter().rposition(|frame| is_off(frame.ns)).map_or(0, |last| last + 1)
    }
}

impl Workload for Case {
    fn cost_ns(&self, frame: u32, tile: u32, _: u16) -> u64 {
        let base = us(700) + mix(u64::from(tile)) % us(600);
        let even = base + mix(u64::from(frame) << 32 | u64::from(tile)) % (base / 50);
        match self {
            Self::DearTile if tile == 100 => us(10) * 10_000,
            Self::DearTile => even / 100,
            // The upper half has the tiles below 128.
            Self::Alternating if (tile < 128) == frame.is_multiple_of(2) => even * 10,
            _ => even,
        }
    }
}
