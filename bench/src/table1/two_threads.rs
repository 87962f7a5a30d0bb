//! Two threads that miss at once: how many misses a second they have together, against one thread alone.

mod crew;

use anyhow::Result;
use fault_linux::BackendKind;

use crate::distance;
use crate::experiment::Effort;
use crate::findings::{Aim, Findings};
use crate::owner::ShmOwner;
use crate::quiet::{self, Rounds};
use crate::space::Space;
use crate::spread::Spread;
use crate::table::{Cell, Table};
use crew::Crew;

/// How much is read.
#[derive(Clone, Copy, Debug)]
struct Amount {
    rounds: usize,
    /// Accesses of one turn, by all threads together.
    accesses: u32,
}

/// One thread's turn and two threads' turn.
#[derive(Clone, Copy, Debug)]
struct Round {
    /// Misses a second.
    one: f64,
    two: f64,
    /// How far apart the cores were, before or after two threads read.
    apart_ns: f64,
}

const FULL: Amount = Amount { rounds: 40, accesses: 40_000 };
const QUICK: Amount = Amount { rounds: 1, accesses: 400 };

/// One page of so many may be resident.
const RESIDENT: u32 = 4;

/// What two threads are to have, of the misses a second of one.
const GAIN_MIN: f64 = 1.5;

/// Cores are close when they are no further apart than this, in nanoseconds: they share a cache. A bound of its own,
/// not one taken from the rounds, since in some runs no round has close cores.
const CLOSE_NS: f64 = 100.0;

pub(super) fn measure(space: Space, effort: Effort, findings: &mut Findings) -> Result<()> {
    let amount = effort.pick(FULL, QUICK);
    let owner = ShmOwner::start(space, 1)?;
    let title =
        "two threads missing at once: random pages, disjoint, direct reads, a quarter of the space resident";
    let heads = ["", "rounds", "cores apart ns", "one: misses/s", "two: misses/s", "two / one"];
    let mut table = Table::new("two_threads", title, &heads);
    for kind in [BackendKind::Uffd, BackendKind::Segv] {
        let rounds = rounds(space, &owner, kind, amount, effort)?;
        let (close, far) = by_distance(&rounds.rounds);
        for (name, some) in
            [("cores close", &close), ("cores far apart", &far), ("all rounds", &rounds.rounds)]
        {
            if !some.is_empty() {
                table.push(row(format!("{kind}, {name}"), some));
            }
        }
        table.note(format!("{kind}: {}", rounds.note()));
        if kind == BackendKind::Uffd {
            let (which, asked) =
                if close.is_empty() { ("cores never close", &far) } else { ("cores close", &close) };
            let what = format!("two threads missing at once, uffd, {which}: times the misses of one");
            findings.aims.push(Aim::at_least(what, gain(asked).median, GAIN_MIN));
        }
    }
    table.note(
        "cores apart: until one sees what the other wrote. A virtual machine's cores wander; where they share no cache, \
         all that the kernel shares between two threads of a process costs several times as much",
    );
    findings.tables.push(table);
    Ok(())
}

/// Reads with one thread and with two, in turns.
fn rounds(
    space: Space,
    owner: &ShmOwner,
    kind: BackendKind,
    amount: Amount,
    effort: Effort,
) -> Result<Rounds<Round>> {
    let region = space.region(kind, space.pages / RESIDENT, 1)?;
    let read = |threads, seed| Crew { space, owner, region: &region, threads, seed }.read(amount.accesses);
    // Until the cache is full nothing has to leave.
    read(1, 0)?;
    quiet::rounds(effort, &format!("two threads, {kind}"), amount.rounds, |number| {
        let seed = 1 + number as u64;
        let one = read(1, seed)?;
        let before = distance::between_cores_ns();
        let two = read(2, seed)?;
        let apart_ns = before.into_iter().chain(distance::between_cores_ns()).fold(0.0, f64::max);
        Ok(Round { one, two, apart_ns })
    })
}

/// Rounds in which the cores were close, and those in which they were not.
fn by_distance(rounds: &[Round]) -> (Vec<Round>, Vec<Round>) {
    rounds.iter().copied().partition(|round| round.apart_ns <= CLOSE_NS)
}

fn gain(rounds: &[Round]) -> Spread {
    Spread::of(&rounds.iter().map(|round| round.two / round.one).collect::<Vec<_>>())
}

fn row(name: String, rounds: &[Round]) -> Vec<Cell> {
    let spread = |of: fn(&Round) -> f64| Spread::of(&rounds.iter().map(of).collect::<Vec<_>>());
    vec![
        Cell::Text(name),
        Cell::Count(rounds.len() as u64),
        Cell::Spread(spread(|round| round.apart_ns), 0),
        Cell::Spread(spread(|round| round.one), 0),
        Cell::Spread(spread(|round| round.two), 0),
        Cell::Spread(gain(rounds), 2),
    ]
}
