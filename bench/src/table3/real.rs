//! Real runs of 1 to 4 nodes on this machine, what messages take here, and the simulator beside both.

use core::num::NonZeroU16;
use core::time::Duration;
use std::os::unix::net::UnixDatagram;
use std::thread;
use std::time::Instant;

use anyhow::{Context, Result};
use dsm_core::id::NodeId;
use dsm_sim::balance::{Config, Costs, Gather};
use dsm_sim::fault::{Fault, Faults};
use dsm_sim::network::{Card, Cards, Link, Links, Network};
use dsm_sim::time::Moment;
use memsavvy::report::RunReport;
use memsavvy::run::{self, Options, Source};
use memsavvy::session::Session;
use memsavvy::size::{Memory, PictureSize};
use rt_core::schedule::Balancer;
use scene::builtin::BuiltIn;

use super::simulated::{self, Simulated};
use super::tiles::{Measured, Slower};
use super::{Amount, DEPTH, THREADS};
use crate::experiment::Effort;
use crate::findings::Aim;
use crate::images::Images;
use crate::machine::cores;
use crate::spread::Spread;
use crate::table::{Cell, Table};

/// Real runs of one number of nodes: their frames after the first ones.
pub(super) struct Real {
    nodes: u16,
    /// Lower quarters over the frames: what else runs on the machine only ever adds.
    frame_ms: f64,
    talk_ms: f64,
    parcels: f64,
}

/// What messages take between processes of this machine, in nanoseconds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wire {
    pub(super) out: f64,
    pub(super) under_way: f64,
    pub(super) in_: f64,
}

/// What was found out by calibration.
pub(super) struct Calibrated {
    pub(super) costs: Costs,
    pub(super) table: Table,
    pub(super) aims: Vec<Aim>,
}

/// Frames in which caches are cold and the balance learns.
pub(super) const COLD: usize = 4;

/// One node that sends each tile in a parcel of its own, then the balance by default.
const SETUPS: [(u16, Balancer); 5] = [
    (1, Balancer::Demand { window: 1 }),
    (1, Balancer::StealNear),
    (2, Balancer::StealNear),
    (3, Balancer::StealNear),
    (4, Balancer::StealNear),
];

/// Runs the cluster, in turns of all set-ups.
pub(super) fn runs(session: &Session, amount: Amount, effort: Effort) -> Result<Vec<Real>> {
    let mut all: Vec<Vec<RunReport>> = SETUPS.map(|_| Vec::new()).into();
    let mut images = Images::default();
    for round in 0..amount.reps {
        effort.say(&format!("real runs, round {}", round + 1));
        for (setup, runs) in SETUPS.into_iter().zip(&mut all) {
            let report = run::run(&options(session, setup, amount.size), |_| Ok(()))?;
            images.expect_same(&report)?;
            runs.push(report);
        }
    }
    Ok(SETUPS.into_iter().zip(&all).map(|(setup, runs)| Real::of(setup, runs)).collect())
}

fn options(session: &Session, (nodes, balance): (u16, Balancer), size: u32) -> Options {
    Options {
        source: Source::BuiltIn(BuiltIn::Sphereflake { depth: DEPTH }),
        nodes,
        balance,
        threads: NonZeroU16::new(THREADS),
        memory: Some(Memory::Share(1.0)),
        size: PictureSize { width: size, height: size },
        session: session.clone(),
        deadline: Duration::from_secs(60),
        quiet: true,
        ..Options::default()
    }
}

impl Real {
    fn of((nodes, _): (u16, Balancer), runs: &[RunReport]) -> Self {
        let warm = || runs.iter().flat_map(|run| run.frames.iter().skip(COLD));
        let low = |values: Vec<f64>| Spread::of(&values).low;
        Self {
            nodes,
            frame_ms: low(warm().map(|frame| frame.ms).collect()),
            talk_ms: low(warm().map(|frame| frame.gather_ms).collect()),
            parcels: Spread::of(&warm().map(|frame| frame.gather_parcels as f64).collect::<Vec<_>>()).median,
        }
    }
}

/// What messages of a deal's length take: sent one at a time to a thread that sleeps until it comes, and answered.
pub(super) fn wire(rounds: u32) -> Result<Wire> {
    let (ours, theirs) = UnixDatagram::pair().context("cannot get a pair of sockets")?;
    let echo = thread::spawn(move || {
        let mut buffer = [0; MESSAGE_BYTES];
        while let Ok(length) = theirs.recv(&mut buffer) {
            if length == 0 || theirs.send(&buffer[..length]).is_err() {
                return;
            }
        }
    });
    let (mut buffer, mut laps) = ([0; MESSAGE_BYTES], Vec::new());
    for _ in 0..rounds {
        let start = Instant::now();
        ours.send(&buffer)?;
        let sent = start.elapsed();
        ours.recv(&mut buffer)?;
        laps.push((sent.as_secs_f64() * 1e9, start.elapsed().as_secs_f64() * 1e9));
    }
    ours.send(&[])?;
    let _ = echo.join();
    // What is there already is read without waiting.
    let (ours, theirs) = UnixDatagram::pair()?;
    let mut reads = Vec::new();
    for _ in 0..rounds {
        theirs.send(&buffer)?;
        let start = Instant::now();
        ours.recv(&mut buffer)?;
        reads.push(start.elapsed().as_secs_f64() * 1e9);
    }
    let low = |values: Vec<f64>| Spread::of(&values).low;
    let (out, in_) = (low(laps.iter().map(|lap| lap.0).collect()), low(reads));
    let trip = low(laps.iter().map(|lap| lap.1).collect());
    Ok(Wire { out, in_, under_way: (trip / 2.0 - in_).max(0.0) })
}

/// Finds what a parcel takes a display, by what one node takes it that sends hundreds and one that sends a few; and what a
/// tile takes a node beside drawing, so that the simulator does what the runs of one node did. Then foretells those of more.
pub(super) fn calibrate(tiles: &Measured, real: &[Real], wire: Wire, effort: Effort) -> Result<Calibrated> {
    let count = f64::from(tiles.columns * tiles.columns);
    let (tile_by_tile, real) = real.split_first().context("runs of one node")?;
    let one = real.first().context("a run of one node")?;
    let more_ns = (tile_by_tile.talk_ms - one.talk_ms) * 1e6;
    let parcel_in = (more_ns / (tile_by_tile.parcels - one.parcels).max(1.0)).max(wire.in_);
    let mut costs = Costs {
        tile_out: 0,
        parcel_out: ns(wire.out),
        parcel_in: ns(parcel_in),
        tile_in: ns(tiles.place_ns),
        message_out: ns(wire.out),
        message_in: ns(wire.in_),
    };
    let wanted_ms = one.frame_ms;
    let (mut low, mut high) = (0, ns(wanted_ms * 1e6 * f64::from(THREADS) / count));
    while low + 50 < high {
        costs.tile_out = u64::midpoint(low, high);
        let here = simulated::run(&here(1, tiles, costs, wire), &Slower { tiles, times: 1.0 })?;
        if here.frame_ms > wanted_ms { high = costs.tile_out } else { low = costs.tile_out }
    }
    effort.say(&format!("{costs:?}, {wire:?}"));
    let (mut table, mut aims) = (table(tiles, costs, wire), Vec::new());
    for run in real {
        let foretold = simulated::run(&here(run.nodes, tiles, costs, wire), &Slower { tiles, times: 1.0 })?;
        let error = |value: f64, real: f64| 100.0 * (value / real - 1.0);
        let [frame, talk] =
            [error(foretold.frame_ms, run.frame_ms), error(foretold.displays_ms, run.talk_ms)];
        table.push(row(run, &foretold, frame, talk));
        let what = format!("error of the simulated frame time, {} nodes here, in %", run.nodes);
        aims.push(Aim::at_most(what, frame.abs(), 25.0));
    }
    Ok(Calibrated { costs, table, aims })
}

/// This machine as a cluster: threads share its cores.
fn here(nodes: u16, tiles: &Measured, costs: Costs, wire: Wire) -> Config {
    let link = Link::new(ns(wire.under_way));
    let network =
        Network { links: Links::Same(link), cards: Cards::Same(Card::UNLIMITED), overhead_bytes: 0 };
    let percent = (u32::from(nodes * THREADS) * 100).div_ceil(u32::try_from(cores()).unwrap_or(1)).max(100);
    let slow = |node| (Moment::ZERO, Fault::Slow { node: NodeId(node), percent });
    Config {
        network,
        faults: Faults { schedule: (0..nodes).map(slow).collect(), ..Faults::default() },
        ..simulated::config(nodes, tiles, Balancer::StealNear, Gather::new(costs))
    }
}

fn table(tiles: &Measured, costs: Costs, Wire { under_way, .. }: Wire) -> Table {
    let title = format!(
        "the simulator beside real runs on the {} cores of this machine, steal-near, tiles of 32x32",
        cores()
    );
    let heads = [
        "nodes",
        "ms a frame",
        "simulated ms",
        "error %",
        "ms of the display",
        "simulated",
        "talk error %",
        "parcels",
        "simulated parcels",
    ];
    let mut table = Table::new("calibration", title, &heads);
    let Costs { tile_out, parcel_out, parcel_in, tile_in, message_out, message_in } = costs;
    table.note(format!("drawing: {:.2} ms a frame of one thread, each tile by itself, the fastest of some rounds; threads that share a core take so many times longer", tiles.frame_ms()));
    table.note(format!("fitted to the runs of one node: {tile_out} ns a tile of a node beside drawing; {parcel_in} ns a parcel of a display, more of which come with demand:1"));
    table.note(format!("measured: {tile_in} ns to put a tile in place, {message_out} ns to send and {message_in} ns to read a message, {under_way:.0} ns under way; {parcel_out} ns for a parcel to leave"));
    table.note(
        "real: the lower quarter of the frames after the first four, for what else runs here only adds",
    );
    table
}

fn row(run: &Real, foretold: &Simulated, frame: f64, talk: f64) -> Vec<Cell> {
    vec![
        Cell::Count(run.nodes.into()),
        Cell::Number(run.frame_ms, 3),
        Cell::Number(foretold.frame_ms, 3),
        Cell::Number(frame, 1),
        Cell::Number(run.talk_ms, 3),
        Cell::Number(foretold.displays_ms, 3),
        Cell::Number(talk, 1),
        Cell::Number(run.parcels, 1),
        Cell::Number(foretold.parcels, 1),
    ]
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time")]
fn ns(value: f64) -> u64 {
    value.max(0.0) as u64
}

/// Length of a deal of fifty tiles.
const MESSAGE_BYTES: usize = 256;
