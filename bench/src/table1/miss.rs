//! Misses: from the instruction that loads to its data, in the reading thread, by every way there is.

mod reader;

use anyhow::{Context, Result};
use dsm_core::transport::Transport;
use fault_linux::BackendKind;

use super::paper_like::PaperLike;
use crate::experiment::Effort;
use crate::findings::{Aim, Findings};
use crate::owner::{ShmOwner, UdpOwner};
use crate::plot::{Axis, Chart, Line, Plot};
use crate::quiet;
use crate::space::{Numbers, Space};
use crate::spread::{Spread, quantile};
use crate::table::{Cell, Table};
use reader::{ByRegion, Reader};

/// A way by its name.
struct Way {
    name: &'static str,
    reader: Box<dyn Reader>,
    numbers: Numbers,
}

/// What was measured of a way.
#[derive(Debug)]
struct Measured {
    name: &'static str,
    /// The nanoseconds of every miss of each round, shortest first.
    rounds: Vec<Vec<u32>>,
}

/// How much is read.
#[derive(Clone, Copy, Debug)]
struct Amount {
    rounds: usize,
    accesses: u32,
}

/// A million accesses each way.
const FULL: Amount = Amount { rounds: 40, accesses: 25_000 };
const QUICK: Amount = Amount { rounds: 1, accesses: 300 };

/// One page of so many may be resident.
const RESIDENT: u32 = 4;

/// How many times faster than the reconstruction of the paper's way ours is to be.
const GAIN_MIN: f64 = 4.0;

const OURS: &str = "uffd, direct reads";
const PAPERS: &str = "paper-like";

pub(super) fn measure(space: Space, effort: Effort, findings: &mut Findings) -> Result<()> {
    let amount = effort.pick(FULL, QUICK);
    let (shm, udp) = (ShmOwner::start(space, 2)?, UdpOwner::start(space)?);
    let mut ways = ways(space, &shm, &udp)?;
    for way in &mut ways {
        // Until the cache is full nothing has to leave.
        way.read(space.pages * 2)?;
    }
    let rounds = quiet::rounds(effort, "misses", amount.rounds, |round| {
        // Who comes first changes from round to round.
        let first = round % ways.len();
        let mut misses = vec![Vec::new(); ways.len()];
        for index in (first..ways.len()).chain(0..first) {
            misses[index] = ways[index].read(amount.accesses)?;
        }
        Ok(misses)
    })?;
    let of_way = |(index, way): (usize, &Way)| {
        let rounds = rounds.rounds.iter().map(|misses| misses[index].clone()).collect();
        Measured { name: way.name, rounds }
    };
    let measured: Vec<Measured> = ways.iter().enumerate().map(of_way).collect();
    let mut table = table(&measured);
    table.note(rounds.note());
    findings.tables.push(table);
    let what = "misses, uffd with direct reads: times faster than paper-like";
    findings.aims.push(Aim::at_least(what, gain(&measured, PAPERS).median, GAIN_MIN));
    findings.plot = Some(plot(&measured));
    Ok(())
}

fn ways(space: Space, shm: &ShmOwner, udp: &UdpOwner) -> Result<Vec<Way>> {
    let direct = |name, kind| Way::by_region(name, space, kind, space.direct_port(shm.pages())?);
    let ring = |name, kind, channel| Way::by_region(name, space, kind, shm.ring_port(channel)?);
    Ok(vec![
        direct(OURS, BackendKind::Uffd)?,
        ring("uffd, ring", BackendKind::Uffd, 0)?,
        direct("segv, direct reads", BackendKind::Segv)?,
        ring("segv, ring", BackendKind::Segv, 1)?,
        direct("soft, direct reads", BackendKind::Soft)?,
        Way::new(PAPERS, PaperLike::new(space, space.pages / RESIDENT, udp.socket()?)?),
    ])
}

impl Way {
    fn new(name: &'static str, reader: impl Reader + 'static) -> Self {
        Self { name, reader: Box::new(reader), numbers: Numbers::new(1) }
    }

    fn by_region<T: Transport + 'static>(
        name: &'static str,
        space: Space,
        kind: BackendKind,
        port: T,
    ) -> Result<Self> {
        let region = space.region(kind, space.pages / RESIDENT, 1)?;
        Ok(Self::new(name, ByRegion { space, region, port }))
    }

    /// The nanoseconds of all misses among so many accesses, shortest first.
    fn read(&mut self, accesses: u32) -> Result<Vec<u32>> {
        let mut misses = self.reader.read(&mut self.numbers, accesses).context(self.name)?;
        misses.sort_unstable();
        Ok(misses)
    }
}

impl Measured {
    /// A quantile of each round, in microseconds.
    fn quantiles(&self, share: f64) -> Vec<f64> {
        let of = |misses: &Vec<u32>| quantile(misses, share).map_or(0.0, |ns| f64::from(ns) / 1e3);
        self.rounds.iter().map(of).collect()
    }

    /// The time that so many of a hundred misses do not exceed, over all rounds.
    fn distribution(&self) -> Vec<(f64, f64)> {
        let mut all = self.rounds.concat();
        all.sort_unstable();
        let at = |percent: u32| {
            let ns = quantile(&all, f64::from(percent) / 100.0)?;
            Some((f64::from(ns) / 1e3, f64::from(percent)))
        };
        (1..100).filter_map(at).collect()
    }
}

/// By how many times a way is slower than ours, by the medians of each round.
fn gain(measured: &[Measured], name: &str) -> Spread {
    let medians = |name: &str| {
        measured.iter().find(|way| way.name == name).map(|way| way.quantiles(0.5)).unwrap_or_default()
    };
    let ratios = medians(name).into_iter().zip(medians(OURS)).map(|(other, ours)| other / ours);
    Spread::of(&ratios.collect::<Vec<_>>())
}

fn table(measured: &[Measured]) -> Table {
    let title =
        "misses: from the load to its data, one thread, a quarter of the space resident, random replacement";
    let mut table = Table::new("miss", title, &["", "misses", "p50 us", "p99 us", "times ours"]);
    for way in measured {
        table.push(vec![
            Cell::text(way.name),
            Cell::Count(way.rounds.iter().map(|misses| misses.len() as u64).sum()),
            Cell::Spread(Spread::of(&way.quantiles(0.5)), 1),
            Cell::Spread(Spread::of(&way.quantiles(0.99)), 1),
            Cell::Spread(gain(measured, way.name), 2),
        ]);
    }
    table.note("p50 and p99 of each round; the median round, and the middle half of the rounds");
    table.note(
        "paper-like: the paper's figure 2 rebuilt; a communication thread, blocking sockets, filled in place",
    );
    table
}

fn plot(measured: &[Measured]) -> Plot {
    let line = |way: &Measured| Line { name: way.name.to_owned(), points: way.distribution() };
    let chart = Chart {
        title: "Table 1: misses of 16 KB pages".to_owned(),
        x: Axis { label: "from load to data, us", is_logarithmic: true },
        y: Axis { label: "% of misses that took no longer", is_logarithmic: false },
        lines: measured.iter().map(line).collect(),
    };
    Plot { charts: vec![chart] }
}
