//! The paper's Table 1: what a hit costs and what a miss costs, on a 128 MB space of 16 KB blocks read at random.

mod hit;
mod miss;
mod paper_like;
mod two_threads;

use anyhow::Result;

use crate::experiment::{Effort, Experiment};
use crate::findings::Findings;
use crate::space::Space;
use crate::table::{Cell, Table};

pub(crate) const EXPERIMENT: Experiment =
    Experiment { name: "table1", shows: "hit and miss times, beside those of the paper's Table 1", run };

/// The paper's shared space: 128 MB.
const SPACE: Space = Space { pages: 8192 };

/// For a look at whether all of it works.
const SMALL_SPACE: Space = Space { pages: 256 };

fn run(effort: Effort) -> Result<Findings> {
    let space = effort.pick(SPACE, SMALL_SPACE);
    let mut findings = Findings::default();
    hit::measure(space, effort, &mut findings)?;
    miss::measure(space, effort, &mut findings)?;
    two_threads::measure(space, effort, &mut findings)?;
    findings.tables.push(papers_own());
    Ok(findings)
}

/// The figures of 2004, to have them beside ours.
fn papers_own() -> Table {
    let title =
        "the paper's Table 1 (2004: two 1.7 GHz Xeons a node, five nodes, gigabit Ethernet), averages";
    let mut table = Table::new("paper", title, &["sharing", "hit us", "miss us"]);
    for (sharing, hit, miss) in [("by objects", 10.2, 629.0), ("by pages", 4.97, 632.0)] {
        table.push(vec![Cell::text(sharing), Cell::Number(hit, 2), Cell::Number(miss, 0)]);
    }
    table.note(
        "the paper timed each access to a block with two calls of gettimeofday; a page hit runs no code of the sharing \
         layer, so its 4.97 us are the clock calls and the reading of the block (16 KB at 3.3 GB/s): compare with our \
         column \"whole block\". What objects add to it, 5.2 us, is what our rows \"soft\" and \"objects\" add to a load",
    );
    table
}
