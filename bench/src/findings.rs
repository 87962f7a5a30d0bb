//! What an experiment gives back, and what is written of it.

use core::fmt;

use serde::Serialize;
use serde_json::{Map, Value};

use crate::experiment::{Effort, Experiment};
use crate::machine::{self, Machine};
use crate::plot::Plot;
use crate::table::Table;

/// What an experiment has found.
#[derive(Debug, Default)]
pub(crate) struct Findings {
    pub(crate) tables: Vec<Table>,
    pub(crate) aims: Vec<Aim>,
    pub(crate) plot: Option<Plot>,
}

/// A number that was to be reached, and whether it was.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Aim {
    what: String,
    value: f64,
    aim: String,
    holds: bool,
}

/// The shape of `NAME.json`.
#[derive(Debug, Serialize)]
pub(crate) struct Record<'a> {
    experiment: &'static str,
    shows: &'static str,
    command: Vec<String>,
    commit: String,
    machine: Machine,
    /// The work was cut short; the figures mean nothing.
    quick: bool,
    /// The rows of all tables; `table` says which one a row is of.
    rows: Vec<Map<String, Value>>,
    aims: &'a [Aim],
}

impl Aim {
    pub(crate) fn at_most(what: impl Into<String>, value: f64, limit: f64) -> Self {
        Self { what: what.into(), value, aim: format!("<= {limit}"), holds: value <= limit }
    }

    pub(crate) fn at_least(what: impl Into<String>, value: f64, limit: f64) -> Self {
        Self { what: what.into(), value, aim: format!(">= {limit}"), holds: value >= limit }
    }
}

impl<'a> Record<'a> {
    pub(crate) fn of(experiment: &Experiment, effort: Effort, findings: &'a Findings) -> Self {
        Self {
            experiment: experiment.name,
            shows: experiment.shows,
            command: std::env::args().collect(),
            commit: machine::commit(),
            machine: Machine::this(),
            quick: effort.is_quick(),
            rows: findings.tables.iter().flat_map(Table::to_json).collect(),
            aims: &findings.aims,
        }
    }
}

/// As people read it in a terminal.
impl fmt::Display for Findings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}; commit {}\n", Machine::this(), machine::commit())?;
        self.tables.iter().try_for_each(|table| writeln!(f, "{table}"))?;
        self.aims.iter().try_for_each(|aim| writeln!(f, "{aim}"))
    }
}

impl fmt::Display for Aim {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { what, value, aim, holds } = self;
        let verdict = if *holds { "holds " } else { "MISSED" };
        write!(f, "{verdict}  {what}: {value:.3}, aim {aim}")
    }
}
