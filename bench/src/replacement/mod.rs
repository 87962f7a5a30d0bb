//! Misses of every replacement policy over the fewest there can be, on recorded traces.

mod hints;
mod min;
mod order;
mod replays;
mod traces;
mod volume;

use anyhow::{Result, ensure};
use dsm_core::replacement::PolicyKind;
use memsavvy::trace::Trace;

use crate::experiment::{Effort, Experiment};
use crate::findings::{Aim, Findings};
use crate::plot::{Axis, Chart, Line, Plot};
use crate::table::{Cell, Table};
use replays::{Ahead, Counts, Source, replay, touches_of};
use traces::{Named, traces};

pub(crate) const EXPERIMENT: Experiment = Experiment {
    name: "replacement",
    shows: "misses of every replacement policy over the fewest there can be, and what prefetch spares",
    run,
};

/// Cache sizes, in per cent of the pages of the image.
const SHARES: [u32; 5] = [4, 8, 16, 32, 64];

/// The paper's memory.
const SIXTEEN: u32 = 16;

/// Misses of the default policy at 16 %, over the fewest.
const OVER_MIN_MAX: f64 = 1.25;

/// Bytes that prefetch may move more, and misses it must spare to be worth it.
const MORE_BYTES_MAX: f64 = 1.10;

/// Of the slots, how many hold hidden pages where soft faults are the source.
const HIDDEN: f64 = 0.25;

/// A policy with what it is told.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Entrant {
    policy: PolicyKind,
    source: Source,
}

const fn entrant(policy: PolicyKind, source: Source) -> Entrant {
    Entrant { policy, source }
}

const RANDOM: Entrant = entrant(PolicyKind::Random, Source::Nothing);

/// What `memsavvy render` does when nobody says otherwise.
const DEFAULT: Entrant = entrant(PolicyKind::Recall, Source::Hints);

/// Told nothing, `clock` and `sieve` are `fifo`, and `recall` is `random`; so are they when pages are hidden.
const ENTRANTS: [Entrant; 10] = [
    RANDOM,
    entrant(PolicyKind::Fifo, Source::Nothing),
    entrant(PolicyKind::S3Fifo, Source::Nothing),
    entrant(PolicyKind::Random, Source::SoftFaults(HIDDEN)),
    entrant(PolicyKind::Fifo, Source::SoftFaults(HIDDEN)),
    entrant(PolicyKind::S3Fifo, Source::SoftFaults(HIDDEN)),
    entrant(PolicyKind::Clock, Source::Hints),
    entrant(PolicyKind::Sieve, Source::Hints),
    entrant(PolicyKind::S3Fifo, Source::Hints),
    DEFAULT,
];

/// A trace, and what every entrant made of it at every cache size.
#[derive(Debug)]
struct Raced {
    name: String,
    trace: Trace,
    min: Vec<u64>,
    /// For each entrant, for each cache size.
    counts: Vec<Vec<Counts>>,
}

fn run(effort: Effort) -> Result<Findings> {
    let raced: Vec<Raced> = traces(effort)?
        .into_iter()
        .map(|named| {
            effort.say(&format!("replaying {}", named.name));
            Raced::race(named)
        })
        .collect::<Result<_>>()?;
    let mut aims: Vec<Aim> = raced.iter().map(Raced::aim_over_min).collect();
    aims.push(aim_never_worse_than_random(&raced));
    let prefetch = prefetch_table(&raced);
    aims.extend(raced.iter().flat_map(prefetch_aims));
    effort.say("timing hints");
    let (hints, hint_aims) = hints::measure(effort)?;
    aims.extend(hint_aims);
    Ok(Findings {
        tables: vec![policies_table(&raced), hidden_table(&raced), order::table(&raced), prefetch, hints],
        aims,
        plot: Some(Plot {
            charts: raced.iter().filter(|raced| raced.trace.nodes == 1).map(Raced::chart).collect(),
        }),
    })
}

impl Raced {
    fn race(named: Named) -> Result<Self> {
        let Named { name, trace } = named;
        let min: Vec<u64> = SHARES.iter().map(|share| min_misses(&trace, slots(&trace, *share))).collect();
        let of = |entrant: &Entrant| -> Vec<Counts> {
            let each = SHARES.iter().map(|share| slots(&trace, *share));
            each.map(|slots| replay(&trace, slots, entrant.policy, entrant.source)).collect()
        };
        let counts: Vec<Vec<Counts>> = ENTRANTS.iter().map(of).collect();
        for (counts, entrant) in counts.iter().zip(ENTRANTS) {
            let holds = counts.iter().zip(&min).all(|(counts, min)| counts.misses >= *min);
            ensure!(holds, "{name}: {entrant:?} misses less than there must be");
        }
        Ok(Self { name, trace, min, counts })
    }

    /// Misses of an entrant at a cache size, over the fewest.
    fn over_min(&self, entrant: Entrant, share: u32) -> f64 {
        let at = index_of(share);
        let index = ENTRANTS.iter().position(|other| *other == entrant).unwrap_or(0);
        self.counts[index][at].misses as f64 / self.min[at] as f64
    }

    fn aim_over_min(&self) -> Aim {
        let what = format!("{}: misses of the default policy at 16 %, over the fewest", self.name);
        Aim::at_most(what, self.over_min(DEFAULT, SIXTEEN), OVER_MIN_MAX)
    }

    fn chart(&self) -> Chart {
        let line = |entrant: &Entrant| {
            let points = SHARES.iter().map(|share| (f64::from(*share), self.over_min(*entrant, *share)));
            Line { name: entrant.name(), points: points.collect() }
        };
        Chart {
            title: self.name.clone(),
            x: Axis { label: "slots, % of the pages", is_logarithmic: true },
            y: Axis { label: "misses over the fewest", is_logarithmic: false },
            lines: ENTRANTS.iter().map(line).collect(),
        }
    }
}

impl Entrant {
    fn name(self) -> String {
        match self.source {
            Source::Nothing => self.policy.to_string(),
            source => format!("{}, {}", self.policy, source.name()),
        }
    }
}

impl Source {
    fn name(self) -> String {
        match self {
            Self::Nothing => "none".to_owned(),
            Self::SoftFaults(share) => format!("soft faults {:.0} %", 100.0 * share),
            Self::Hints => "hints".to_owned(),
            Self::Prefetch(ahead) => format!("hints, {} ahead", ahead.name()),
        }
    }
}

fn policies_table(raced: &[Raced]) -> Table {
    let heads = ["trace", "policy", "told by", "4 %", "8 %", "16 %", "32 %", "64 %"];
    let title = "Misses over the fewest there can be (min), by slots in per cent of the image's pages";
    let mut table = Table::new("policies", title, &heads);
    for of in raced {
        let mut row = vec![Cell::text(&of.name), Cell::text("min"), Cell::text("misses")];
        row.extend(of.min.iter().map(|min| Cell::Count(*min)));
        table.push(row);
        for entrant in ENTRANTS {
            let mut row = vec![
                Cell::text(&of.name),
                Cell::text(entrant.policy.name()),
                Cell::text(entrant.source.name()),
            ];
            row.extend(SHARES.map(|share| Cell::Number(of.over_min(entrant, share), 2)));
            table.push(row);
        }
    }
    table.note("a soft fault is not a miss: no message is sent; how many there are stands in the next table");
    table.note("told nothing, or of soft faults only, clock and sieve are fifo, and recall is random");
    table
}

/// What it brings to hide pages, and how many soft faults it costs.
fn hidden_table(raced: &[Raced]) -> Table {
    let heads = ["trace", "policy", "hidden %", "misses over min", "soft faults a miss spared"];
    let mut table = Table::new("soft-faults", "What hiding pages brings at 16 %", &heads);
    for of in raced {
        let slots = slots(&of.trace, SIXTEEN);
        for policy in [PolicyKind::Random, PolicyKind::Fifo] {
            let plain = replay(&of.trace, slots, policy, Source::Nothing);
            for share in [0.05, 0.1, 0.25, 0.5, 0.75] {
                let counts = replay(&of.trace, slots, policy, Source::SoftFaults(share));
                let spared = plain.misses as f64 - counts.misses as f64;
                table.push(vec![
                    Cell::text(&of.name),
                    Cell::text(policy.name()),
                    Cell::Number(100.0 * share, 0),
                    Cell::Number(counts.misses as f64 / of.min[index_of(SIXTEEN)] as f64, 2),
                    Cell::Number(if spared > 0.0 { counts.soft_faults as f64 / spared } else { 0.0 }, 1),
                ]);
            }
        }
    }
    table
}

impl Ahead {
    const fn name(self) -> &'static str {
        match self {
            Self::Neighbours => "neighbours",
            Self::Tiles => "tiles",
            Self::Both => "both",
        }
    }
}

/// What prefetch spares of misses, and what it costs in pages.
fn prefetch_table(raced: &[Raced]) -> Table {
    let heads = ["trace", "slots %", "ahead", "misses", "pages moved", "brought ahead", "used %"];
    let title = "recall: misses and pages moved with prefetch, over those without";
    let mut table = Table::new("prefetch", title, &heads);
    for of in raced {
        for (share, ahead) in [8, 16, 32].into_iter().flat_map(|share| Ahead::ALL.map(|ahead| (share, ahead)))
        {
            let Paid { counts, misses, moved } = of.paid(share, ahead);
            table.push(vec![
                Cell::text(&of.name),
                Cell::Count(share.into()),
                Cell::text(ahead.name()),
                Cell::Number(misses, 2),
                Cell::Number(moved, 2),
                Cell::Count(counts.prefetched),
                Cell::Number(100.0 * counts.used as f64 / counts.prefetched.max(1) as f64, 0),
            ]);
        }
    }
    table.note("tiles: what a tile touched in the last frame, before it starts; neighbours: what follows a missed page");
    table.note("the first frame of each trace, which no frame before it foretells, is counted everywhere");
    table
}

/// What prefetch has brought.
struct Paid {
    counts: Counts,
    /// Misses, over those without.
    misses: f64,
    /// Pages moved, over those without.
    moved: f64,
}

impl Raced {
    fn paid(&self, share: u32, ahead: Ahead) -> Paid {
        let counts = replay(&self.trace, slots(&self.trace, share), DEFAULT.policy, Source::Prefetch(ahead));
        let without = self.over_min(DEFAULT, share) * self.min[index_of(share)] as f64;
        let moved = (counts.misses + counts.prefetched) as f64 / without;
        Paid { counts, misses: counts.misses as f64 / without, moved }
    }
}

fn prefetch_aims(of: &Raced) -> Vec<Aim> {
    let aims = |ahead: Ahead| {
        let Paid { misses, moved, .. } = of.paid(SIXTEEN, ahead);
        let what =
            |what: &str| format!("{}: {what} with {} ahead, over those without", of.name, ahead.name());
        [Aim::at_most(what("misses"), misses, 1.0), Aim::at_most(what("pages moved"), moved, MORE_BYTES_MAX)]
    };
    Ahead::ALL.into_iter().flat_map(aims).collect()
}

fn aim_never_worse_than_random(raced: &[Raced]) -> Aim {
    let each = raced
        .iter()
        .flat_map(|of| SHARES.map(|share| of.over_min(DEFAULT, share) / of.over_min(RANDOM, share)));
    Aim::at_most(
        "misses of the default policy over those of random, the worst of all",
        each.fold(0.0, f64::max),
        1.0,
    )
}

/// Fewest misses of all nodes.
fn min_misses(trace: &Trace, slots: usize) -> u64 {
    let nodes = 0..usize::from(trace.nodes);
    nodes.map(|node| min::misses(&touches_of(trace, node), trace.page_count, slots)).sum()
}

/// So many per cent of the pages, and at least two.
fn slots(trace: &Trace, share: u32) -> usize {
    (trace.page_count as usize * share as usize / 100).max(2)
}

fn index_of(share: u32) -> usize {
    SHARES.iter().position(|other| *other == share).unwrap_or(0)
}
