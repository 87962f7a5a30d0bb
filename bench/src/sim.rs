//! The simulator: events a second on one core, from 16 to 4096 nodes.
//!
//! Virtual time is only as useful as it is cheap: a thousand seeds of 64 nodes in continuous integration are some 40
//! million events. What is timed are whole runs, making the world left out; what is asserted first is that two runs of one seed
//! are the same event for event, and that no page is lost where no message is.

use anyhow::{Result, ensure};
use dsm_core::replacement::PolicyKind;
use dsm_sim::cluster::{Checks, Ended};
use dsm_sim::paging::{Config, Memory, Report, World};
use rustix::time::{ClockId, clock_gettime};

use crate::experiment::{Effort, Experiment};
use crate::findings::{Aim, Findings};
use crate::plot::{Axis, Chart, Line, Plot};
use crate::spread::Spread;
use crate::table::{Cell, Table};

pub(crate) const EXPERIMENT: Experiment =
    Experiment { name: "sim", shows: "a cluster in virtual time: events a second on one core", run };

/// A cluster to be simulated.
#[derive(Clone, Copy, Debug)]
struct Case {
    renderers: u16,
    stores: u16,
    pages: u32,
    slots: u32,
    loss_percent: u32,
    checks: Checks,
}

/// Checks of one event in so many are sampled enough to find what lasts, and too few to be felt.
const SAMPLED: Checks = Checks::OneIn(4096);

const CASES: [Case; 6] = [
    Case { renderers: 16, stores: 0, pages: 1024, slots: 128, loss_percent: 0, checks: SAMPLED },
    Case { renderers: 64, stores: 0, pages: 1024, slots: 128, loss_percent: 0, checks: SAMPLED },
    Case { renderers: 64, stores: 0, pages: 1024, slots: 128, loss_percent: 10, checks: SAMPLED },
    Case { renderers: 1024, stores: 0, pages: 4096, slots: 128, loss_percent: 1, checks: SAMPLED },
    Case { renderers: 4032, stores: 64, pages: 4096, slots: 128, loss_percent: 1, checks: SAMPLED },
    Case { renderers: 4, stores: 0, pages: 64, slots: 8, loss_percent: 10, checks: Checks::EveryStep },
];

/// What a run of a case has shown.
struct Timed {
    report: Report,
    /// Events a second, of each round.
    rates: Spread,
}

fn run(effort: Effort) -> Result<Findings> {
    let mut table = Table::new(
        "sim",
        "a paging cluster in virtual time, one core",
        &["nodes", "loss %", "checks", "events", "virtual ms", "faults", "million events/s"],
    );
    let (mut aims, mut points) = (Vec::new(), Vec::new());
    for case in CASES {
        effort.say(&format!("{} nodes, {} % loss", case.nodes(), case.loss_percent));
        let Timed { report, rates } = case.time(effort)?;
        let rates = rates.scaled(1e-6);
        table.push(vec![
            Cell::Count(case.nodes().into()),
            Cell::Count(case.loss_percent.into()),
            Cell::text(case.checks_text()),
            Cell::Count(report.steps),
            Cell::Number(report.at.as_ns() as f64 / 1e6, 1),
            Cell::Count(report.total().faults),
            Cell::Spread(rates, 2),
        ]);
        if case.checks == SAMPLED {
            let what = format!("million events/s, {} nodes, {} % loss", case.nodes(), case.loss_percent);
            aims.push(Aim::at_least(what, rates.median, 1.0));
            points.push((f64::from(case.nodes()), rates.median));
        }
    }
    table.note(
        "an event is a message taken in, a task done, or a fault of the world; making the world is not timed",
    );
    table.note(
        "checks: of all invariants of a node and its oracle, whose cost grows with the number of pages",
    );
    Ok(Findings { tables: vec![table], aims, plot: Some(plot(points)) })
}

impl Case {
    const fn nodes(self) -> u16 {
        self.renderers + self.stores
    }

    fn checks_text(self) -> String {
        match self.checks {
            Checks::EveryStep => "every event".to_owned(),
            Checks::OneIn(count) => format!("one event in {count}"),
            Checks::AtEnd => "at the end".to_owned(),
        }
    }

    /// Runs the case once to see that it is right, and then for the time it takes.
    fn time(self, effort: Effort) -> Result<Timed> {
        let mut memory = Memory::new(self.config(effort)?)?;
        let first = World::new(&mut memory, PolicyKind::Random, 1).run();
        ensure!(first.ended == Ended::Done, "the run ended before its threads were done");
        ensure!(self.loss_percent > 0 || first.total().failed_touches == 0, "a page was lost without loss");
        let mut rates = Vec::new();
        for _ in 0..effort.pick(7, 1) {
            let mut world = World::new(&mut memory, PolicyKind::Random, 1);
            let start = processor_seconds();
            let report = world.run();
            rates.push(report.steps as f64 / (processor_seconds() - start));
            ensure!(report == first, "the same seed made another run");
        }
        Ok(Timed { report: first, rates: Spread::of(&rates) })
    }

    fn config(self, effort: Effort) -> Result<Config> {
        let mut config = Config::with_stores(self.renderers, self.stores, self.pages)?;
        let touches = effort.pick(640_000, 6_400) / u32::from(self.renderers);
        (config.touches, config.slots, config.checks) = (touches.max(1), self.slots, self.checks);
        config.network = config.network.with_links(|link| link.loss_ppm = self.loss_percent * 10_000);
        Ok(config)
    }
}

/// Processor time of this thread so far: other programs do not count.
fn processor_seconds() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 / 1e9
}

fn plot(points: Vec<(f64, f64)>) -> Plot {
    let x = Axis { label: "nodes", is_logarithmic: true };
    let y = Axis { label: "million events/s", is_logarithmic: false };
    let line = Line { name: "one core".to_owned(), points };
    Plot { charts: vec![Chart { title: "A cluster in virtual time".to_owned(), x, y, lines: vec![line] }] }
}
