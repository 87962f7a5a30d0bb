//! Telling quiet rounds from those in which other programs wanted the machine too.
//!
//! A ratio of one thread to two, or of a way that sleeps to one that does not, means little while another program
//! holds a core. The system counts whose time it was; rounds that were disturbed are left out, and how many is said.

use std::{fs, process};

use anyhow::{Context, Result};

use crate::experiment::Effort;

/// Rounds that count.
#[derive(Debug)]
pub(crate) struct Rounds<T> {
    pub(crate) rounds: Vec<T>,
    /// Rounds made and left out.
    disturbed: usize,
    /// Too few were quiet: disturbed ones are among those that count.
    is_disturbed: bool,
}

/// Processor time since the system started, in ticks of 10 ms.
#[derive(Clone, Copy, Debug, Default)]
struct Ticks {
    /// Of all cores, idle or not.
    all: u64,
    /// Spent by anybody.
    busy: u64,
    /// Spent by this process and its children.
    own: u64,
}

/// What the system counts of one process, in the same ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Process {
    parent: u32,
    ticks: u64,
    ended_children_ticks: u64,
}

/// A round is quiet if other programs took less than this part of the machine.
const QUIET_SHARE: f64 = 0.08;

/// Makes rounds until `wanted` of them were quiet, and at most twice as many.
pub(crate) fn rounds<T>(
    effort: Effort,
    what: &str,
    wanted: usize,
    mut round: impl FnMut(usize) -> Result<T>,
) -> Result<Rounds<T>> {
    let (mut quiet, mut disturbed) = (Vec::new(), Vec::new());
    while quiet.len() < wanted && quiet.len() + disturbed.len() < 2 * wanted {
        let number = quiet.len() + disturbed.len();
        effort.say(&format!("{what}: round {}, {} of {wanted} quiet ones", number + 1, quiet.len()));
        let before = Ticks::now()?;
        let made = round(number)?;
        let is_quiet = Ticks::now()?.others_since(before) < QUIET_SHARE || effort.is_quick();
        if is_quiet { &mut quiet } else { &mut disturbed }.push(made);
    }
    let is_disturbed = quiet.len() < wanted.div_ceil(2);
    if is_disturbed {
        quiet.append(&mut disturbed);
    }
    Ok(Rounds { rounds: quiet, disturbed: disturbed.len(), is_disturbed })
}

impl<T> Rounds<T> {
    /// What to say below the table.
    pub(crate) fn note(&self) -> String {
        let Self { rounds, disturbed, is_disturbed } = self;
        let share = QUIET_SHARE * 100.0;
        if *is_disturbed {
            return format!(
                "{} rounds; in most of them other programs took more than {share:.0} % of the machine: trust the \
                 ratios less",
                rounds.len()
            );
        }
        format!(
            "{} rounds; left out are {disturbed} more in which other programs took over {share:.0} % of the machine",
            rounds.len()
        )
    }
}

impl Ticks {
    fn now() -> Result<Self> {
        let text = fs::read_to_string("/proc/stat").context("cannot read /proc/stat")?;
        let this = Process::read(&format!("/proc/{}/stat", process::id()));
        let this = this.context("no process that says what time it took in /proc")?;
        let of_all = Self::of_all(&text).context("/proc/stat does not count as proc_stat(5) says")?;
        Ok(Self { own: this.ticks + this.ended_children_ticks + live_children_ticks()?, ..of_all })
    }

    /// # Source
    /// `proc_stat(5)`: user, nice, system, idle, iowait, irq, softirq, steal.
    fn of_all(text: &str) -> Option<Self> {
        let words = text.lines().next()?.strip_prefix("cpu ")?.split_whitespace();
        let cpu: Vec<u64> = words.map(|word| word.parse().ok()).collect::<Option<_>>()?;
        let all = cpu.get(..8)?.iter().sum();
        Some(Self { all, busy: all - cpu[3] - cpu[4], own: 0 })
    }

    /// The share of the machine that others took since then.
    fn others_since(self, before: Self) -> f64 {
        let since = |of: fn(Self) -> u64| of(self).saturating_sub(of(before));
        let others = since(|ticks| ticks.busy).saturating_sub(since(|ticks| ticks.own));
        others as f64 / since(|ticks| ticks.all).max(1) as f64
    }
}

/// Time taken by the children of this process that still run.
fn live_children_ticks() -> Result<u64> {
    let me = process::id();
    let entries = fs::read_dir("/proc")?.filter_map(Result::ok);
    let processes = entries.filter_map(|entry| Process::read(entry.path().join("stat").to_str()?));
    Ok(processes.filter(|process| process.parent == me).map(|process| process.ticks).sum())
}

impl Process {
    fn read(path: &str) -> Option<Self> {
        Self::parse(&fs::read_to_string(path).ok()?)
    }

    /// # Source
    /// `proc_pid_stat(5)`: field 4 is the parent; 14 and 15 are the time in user and system mode, 16 and 17 that of
    /// children that have ended and were waited for.
    fn parse(text: &str) -> Option<Self> {
        // Field 2, the program's name, stands in brackets and may hold anything, brackets too.
        let (_, fields) = text.rsplit_once(") ")?;
        let fields: Vec<&str> = fields.split_whitespace().collect();
        let field = |number: usize| fields.get(number - 3)?.parse::<u64>().ok();
        Some(Self {
            parent: u32::try_from(field(4)?).ok()?,
            ticks: field(14)? + field(15)?,
            ended_children_ticks: field(16)? + field(17)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_others_took_is_what_is_busy_and_not_ours() {
        let at = |user, idle, own| {
            let text = format!("cpu  {user} 0 0 {idle} 0 0 0 0 0 0\ncpu0 1 2 3\n");
            Ticks { own, ..Ticks::of_all(&text).unwrap() }
        };
        assert_eq!(at(160, 240, 50).others_since(at(100, 200, 10)), 0.2);
        assert!(Ticks::now().is_ok());
    }

    #[test]
    fn a_process_may_be_called_anything() {
        let text = "17 (a) b) S 4 17 1 0 -1 0 0 0 0 0 30 5 6 7 20 0 1\n";
        assert_eq!(Process::parse(text), Some(Process { parent: 4, ticks: 35, ended_children_ticks: 13 }));
    }

    #[test]
    fn a_quick_look_takes_what_it_gets() {
        let rounds = rounds(Effort::Quick, "numbers", 3, Ok).unwrap();
        assert_eq!((rounds.rounds, rounds.disturbed, rounds.is_disturbed), (vec![0, 1, 2], 0, false));
    }
}
