//! Hits: a resident page against a plain array, in turns, on fresh memory each round.

mod access;
mod turns;

use anyhow::Result;
use fault_linux::BackendKind;

use crate::experiment::Effort;
use crate::findings::{Aim, Findings};
use crate::owner::ShmOwner;
use crate::space::Space;
use crate::spread::Spread;
use crate::table::{Cell, Table};
use access::Pattern;
use turns::{Amount, Pair, Subject, Turns};

/// A million accesses a round, twice.
const FULL: Amount = Amount { rounds: 7, turns: 8, accesses: 125_000 };
const QUICK: Amount = Amount { rounds: 1, turns: 2, accesses: 500 };

/// PLAIN_LOADS: a resident page costs what a plain array costs, within what can be measured.
const RATIO_MAX: f64 = 1.05;

pub(super) fn measure(space: Space, effort: Effort, findings: &mut Findings) -> Result<()> {
    let amount = effort.pick(FULL, QUICK);
    let owner = ShmOwner::start(space, 1)?;
    let turns = Turns::new(space, amount, &owner)?;
    let mut pairs = Vec::new();
    for round in 0..amount.rounds {
        effort.say(&format!("hits, round {} of {}", round + 1, amount.rounds));
        for subject in Subject::ALL {
            pairs.extend(turns.compare(subject, round)?);
        }
    }
    findings.tables.extend([times(&pairs), ratios(&pairs)]);
    for kind in [BackendKind::Uffd, BackendKind::Segv] {
        for pattern in Pattern::ALL {
            let what = format!("PLAIN_LOADS, {kind}, {}: times a plain array's", pattern.name());
            let ratio = ratio(&pairs, Subject::Pages(kind), pattern).median;
            findings.aims.push(Aim::at_most(what, ratio, RATIO_MAX));
        }
    }
    Ok(())
}

fn times(pairs: &[Pair]) -> Table {
    let title = "hits: time of one access (median, and the middle half)";
    let mut table =
        Table::new("hit_times", title, &["", "hot ns", "dependent ns", "independent ns", "whole block us"]);
    let spread = |pattern: Pattern, of: &dyn Fn(&Pair) -> Option<f64>| {
        let samples: Vec<f64> = pairs.iter().filter(|pair| pair.pattern == pattern).filter_map(of).collect();
        let scale = if pattern == Pattern::WholeBlock { 1e-3 } else { 1.0 };
        Cell::Spread(Spread::of(&samples).scaled(scale), 2)
    };
    let plain = Pattern::ALL.map(|pattern| spread(pattern, &|pair| Some(pair.plain_ns)));
    table.push([vec![Cell::text("plain array, 4 KB pages")], plain.into()].concat());
    for subject in Subject::ALL {
        let of = |pair: &Pair| (pair.subject == subject).then_some(pair.subject_ns);
        let cells = Pattern::ALL.map(|pattern| spread(pattern, &of));
        table.push([vec![Cell::text(subject.name())], cells.into()].concat());
    }
    table.note("hot: words of two pages in the innermost cache, each load waiting for the one before");
    table.note("dependent, independent: words of random pages; each load waiting for the one before, or many under way");
    table.note("objects: a map under a lock gives the block, which is counted while it is read, as by the paper's objects");
    table.note(
        "regions forbid huge pages, so the plain array they are compared with does too (MADV_NOHUGEPAGE)",
    );
    table
}

fn ratios(pairs: &[Pair]) -> Table {
    let title = "hits: times that of the plain array read in turns with it (another plain array: the method's own error)";
    let mut table = Table::new("hit_ratios", title, &["", "hot", "dependent", "independent", "whole block"]);
    for subject in Subject::ALL {
        let cells = Pattern::ALL.map(|pattern| Cell::Spread(ratio(pairs, subject, pattern), 3));
        table.push([vec![Cell::text(subject.name())], cells.into()].concat());
    }
    table
}

fn ratio(pairs: &[Pair], subject: Subject, pattern: Pattern) -> Spread {
    let of = pairs.iter().filter(|pair| pair.subject == subject && pair.pattern == pattern);
    Spread::of(&of.map(|pair| pair.subject_ns / pair.plain_ns).collect::<Vec<_>>())
}
