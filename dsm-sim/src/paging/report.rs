//! What a run has counted.

use core::fmt;

use dsm_core::id::NodeId;
use dsm_core::stats::{Histogram, HomeStats, NodeStats};

use crate::cluster::Ended;
use crate::network::Traffic;
use crate::time::Moment;

/// What a run of a paging cluster has counted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Report {
    /// The seed it came from.
    pub seed: u64,
    /// Why it ended.
    pub ended: Ended,
    /// Virtual time at its end.
    pub at: Moment,
    /// Things that happened.
    pub steps: u64,
    /// All that happened as one number: equal when two runs were the same, event for event.
    pub trace: u64,
    /// What each node has counted, in order of their numbers.
    pub nodes: Vec<NodeReport>,
    /// The times in nanoseconds from the touch of an absent page to its reading, of all nodes.
    pub latencies: Histogram,
}

/// What a run has counted of one node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeReport {
    /// The node.
    pub node: NodeId,
    /// Whether it was up at the end.
    pub is_up: bool,
    /// How often it was started.
    pub starts: u16,
    /// What the state machines counted.
    pub counts: Counts,
    /// What the network did for it.
    pub traffic: Traffic,
}

/// What a node has counted, all its incarnations together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Pages touched by its threads.
    pub touches: u64,
    /// Touches that ended without the page.
    pub failed_touches: u64,
    /// Touches of absent pages.
    pub faults: u64,
    /// Requests begun.
    pub requests: u64,
    /// Requests sent again.
    pub resends: u64,
    /// Requests that went on to another copy of their page.
    pub failovers: u64,
    /// Peers that were found to be dead.
    pub dead_peers: u64,
    /// Fragments of pages that came.
    pub fragments: u64,
    /// Pages that came.
    pub fetched_pages: u64,
    /// Victims.
    pub evicted_pages: u64,
    /// Pages given up.
    pub failed_pages: u64,
    /// Answers that came late or twice.
    pub late_answers: u64,
    /// Messages refused.
    pub refused_messages: u64,
    /// Pages granted to others.
    pub granted_pages: u64,
}

impl Counts {
    /// Adds what the state machines of one incarnation have counted.
    pub(super) fn add(&mut self, node: &NodeStats, home: &HomeStats) {
        *self = self.plus(&Self {
            touches: 0,
            failed_touches: 0,
            faults: node.faults,
            requests: node.requests,
            resends: node.resends,
            failovers: node.failovers,
            dead_peers: node.dead_peers,
            fragments: node.fragments,
            fetched_pages: node.fetched_pages,
            evicted_pages: node.evicted_pages,
            failed_pages: node.failed_pages,
            late_answers: node.late_answers,
            refused_messages: node.refused_messages + home.refused_messages,
            granted_pages: home.granted_pages,
        });
    }

    /// The sums of both.
    #[must_use]
    pub const fn plus(&self, other: &Self) -> Self {
        Self {
            touches: self.touches + other.touches,
            failed_touches: self.failed_touches + other.failed_touches,
            faults: self.faults + other.faults,
            requests: self.requests + other.requests,
            resends: self.resends + other.resends,
            failovers: self.failovers + other.failovers,
            dead_peers: self.dead_peers + other.dead_peers,
            fragments: self.fragments + other.fragments,
            fetched_pages: self.fetched_pages + other.fetched_pages,
            evicted_pages: self.evicted_pages + other.evicted_pages,
            failed_pages: self.failed_pages + other.failed_pages,
            late_answers: self.late_answers + other.late_answers,
            refused_messages: self.refused_messages + other.refused_messages,
            granted_pages: self.granted_pages + other.granted_pages,
        }
    }
}

impl Report {
    /// The counts of all nodes together.
    #[must_use]
    pub fn total(&self) -> Counts {
        self.nodes.iter().fold(Counts::default(), |sum, node| sum.plus(&node.counts))
    }

    /// Messages that the network lost, for whatever reason.
    #[must_use]
    pub fn lost_messages(&self) -> u64 {
        self.nodes.iter().map(|node| node.traffic.lost_in_all()).sum()
    }

    /// Nodes that are shown: all of a few, else the first and the busiest.
    fn shown(&self) -> Vec<&NodeReport> {
        if self.nodes.len() <= SHOWN_MAX {
            return self.nodes.iter().collect();
        }
        let mut busiest: Vec<&NodeReport> = self.nodes.iter().collect();
        busiest.sort_by_key(|node| core::cmp::Reverse(node.traffic.sent_bytes));
        busiest.truncate(SHOWN_MAX);
        busiest
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { seed, ended, at, steps, trace, .. } = self;
        let ended = match ended {
            Ended::Done => "all threads done",
            Ended::TimeOver => "time over",
            Ended::Stuck => "stuck",
        };
        writeln!(f, "seed {seed}: {ended} at {at}, {steps} events, trace {trace:016x}\n")?;
        let shown = self.shown();
        let left_out = self.nodes.len() - shown.len();
        writeln!(f, "{HEADS}")?;
        for node in shown {
            write_row(f, &format!("node {}", node.node.0), node.is_up, &node.counts, &node.traffic)?;
        }
        if left_out > 0 {
            writeln!(f, "{left_out} nodes that sent less are not shown")?;
        }
        let traffic = self.nodes.iter().fold(Traffic::default(), |sum, node| sum.plus(&node.traffic));
        write_row(f, "all", true, &self.total(), &traffic)?;
        let quantile = |per_mille| self.latencies.quantile(per_mille) as f64 / 1e3;
        writeln!(
            f,
            "\nfrom touch to page: p50 {:.1} us, p90 {:.1} us, p99 {:.1} us, p99.9 {:.1} us, longest {:.1} us",
            quantile(500),
            quantile(900),
            quantile(990),
            quantile(999),
            self.latencies.max() as f64 / 1e3,
        )
    }
}

fn write_row(
    f: &mut fmt::Formatter<'_>,
    name: &str,
    is_up: bool,
    counts: &Counts,
    traffic: &Traffic,
) -> fmt::Result {
    let megabytes = |bytes: u64| bytes as f64 / 1e6;
    writeln!(
        f,
        "{name:<10}{:>9}{:>9}{:>9}{:>9}{:>10}{:>9}{:>9}{:>9}{:>11.3}{:>11.3}{:>9}{}",
        counts.touches,
        counts.faults,
        counts.requests,
        counts.resends,
        counts.failovers,
        counts.fetched_pages,
        counts.failed_touches,
        counts.granted_pages,
        megabytes(traffic.sent_bytes),
        megabytes(traffic.received_bytes),
        traffic.lost_in_all(),
        if is_up { "" } else { "  down" },
    )
}

const HEADS: &str = "           touches   faults requests  resends failovers  fetched   failed  granted    MB sent     MB got     lost";

/// Nodes that are shown at most.
const SHOWN_MAX: usize = 16;
