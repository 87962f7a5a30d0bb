//! The runs of one system.

use memsavvy::report::{FrameReport, ProcessReport, RunReport};

use super::system::System;
use crate::spread::Spread;

/// A system, and the report of its session in each round.
#[derive(Debug)]
pub(super) struct Sessions {
    pub(super) system: System,
    pub(super) runs: Vec<RunReport>,
}

/// Some frames of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    Whole,
    First,
    Second,
}

impl Sessions {
    /// Frames a second over a part of the session.
    pub(super) fn fps(&self, part: Part) -> Spread {
        self.spread(|run| part.fps(&run.frames))
    }

    /// The same in that of another system: sessions of one round are compared.
    pub(super) fn ratio_to(&self, other: &Self, part: Part) -> Spread {
        let pairs = self.runs.iter().zip(&other.runs);
        let ratios: Vec<f64> =
            pairs.map(|(run, other)| part.fps(&run.frames) / part.fps(&other.frames)).collect();
        Spread::of(&ratios)
    }

    /// Of the first frame, which finds the caches empty.
    pub(super) fn first_frame_ms(&self) -> Spread {
        self.spread(|run| run.frames.first().map_or(0.0, |frame| frame.ms))
    }

    pub(super) fn fetched_pages(&self) -> f64 {
        self.spread(|run| run.totals.fetched_pages as f64).median
    }

    pub(super) fn fetched_bytes(&self) -> f64 {
        self.spread(|run| run.totals.received_bytes as f64).median
    }

    /// Most memory that was ever resident in a node that draws.
    pub(super) fn peak_bytes(&self) -> f64 {
        let peak = |run: &RunReport| {
            let nodes = run.nodes.iter().filter(|process| process.role == "node");
            nodes.map(|process: &ProcessReport| process.peak_resident_bytes).max().unwrap_or(0) as f64
        };
        self.spread(peak).median
    }

    /// Frames a second of each frame, the median of the rounds.
    pub(super) fn rates(&self) -> Vec<(f64, f64)> {
        let frames = self.runs.first().map_or(0, |run| run.frames.len());
        let rate = |frame: usize| {
            self.spread(|run| run.frames.get(frame).map_or(0.0, |frame| 1e3 / frame.ms)).median
        };
        (0..frames).map(|frame| (frame as f64, rate(frame))).collect()
    }

    fn spread(&self, of: impl Fn(&RunReport) -> f64) -> Spread {
        Spread::of(&self.runs.iter().map(of).collect::<Vec<_>>())
    }
}

impl Part {
    fn fps(self, frames: &[FrameReport]) -> f64 {
        let (first, second) = frames.split_at(frames.len() / 2);
        let frames = match self {
            Self::Whole => frames,
            Self::First => first,
            Self::Second => second,
        };
        1e3 * frames.len() as f64 / frames.iter().map(|frame| frame.ms).sum::<f64>()
    }
}
