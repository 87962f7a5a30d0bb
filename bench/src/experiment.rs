//! The list of experiments, and what each is given.

use anyhow::Result;

use crate::findings::Findings;
use crate::{balance, embree, fig5, fig7, gather, iso, iso_error, left_out};
use crate::{paging_core, prefetch, replacement, scaling, sim, step_aside, table1, table3, triangle_tests};

/// An experiment: its name on the command line, what it shows, how it is run.
#[derive(Debug)]
pub(crate) struct Experiment {
    pub(crate) name: &'static str,
    /// One line, for the list.
    pub(crate) shows: &'static str,
    /// Asserts that its subject is right, measures, and gives back what it found.
    pub(crate) run: fn(Effort) -> Result<Findings>,
}

/// How much work an experiment is to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Effort {
    /// As much as its figures need.
    Full,
    /// Just enough to go through all of its code; the figures mean nothing.
    Quick,
}

/// All experiments, in the order in which `all` runs them.
pub(crate) const ALL: &[Experiment] = &[
    table1::EXPERIMENT,
    paging_core::EXPERIMENT,
    sim::EXPERIMENT,
    scaling::EXPERIMENT,
    fig7::EXPERIMENT,
    table3::EXPERIMENT,
    balance::EXPERIMENT,
    fig5::EXPERIMENT,
    replacement::EXPERIMENT,
    prefetch::EXPERIMENT,
    step_aside::EXPERIMENT,
    gather::EXPERIMENT,
    embree::EXPERIMENT,
    left_out::EXPERIMENT,
    iso_error::EXPERIMENT,
    iso::EXPERIMENT,
    triangle_tests::EXPERIMENT,
];

impl Effort {
    pub(crate) fn is_quick(self) -> bool {
        self == Self::Quick
    }

    /// Chooses a number by effort.
    pub(crate) fn pick<T>(self, full: T, quick: T) -> T {
        match self {
            Self::Full => full,
            Self::Quick => quick,
        }
    }

    /// Says how far a long experiment has come, to who waits for it.
    pub(crate) fn say(self, text: &str) {
        if self == Self::Full {
            eprintln!("  {text}");
        }
    }
}
