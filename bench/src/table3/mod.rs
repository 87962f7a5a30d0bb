//! The paper's Table 3: what the supervisor spends on communication and the frame rate, over the number of nodes.
//!
//! # The map
//!
//! | module | what it holds |
//! |---|---|
//! | `tiles` | what each tile of the session takes, measured |
//! | `real` | real runs of 1 to 4 nodes, and the simulator calibrated by them |
//! | `simulated` | clusters in virtual time |

mod real;
mod simulated;
mod tiles;

use anyhow::Result;
use dsm_sim::balance::{Config, Costs, Gather};
use dsm_sim::network::Network;
use memsavvy::session::{Path, Session, Way};
use rt_core::schedule::Balancer;
use scene::builtin::sphereflake;
use scene::{BuildOptions, build};

use crate::experiment::{Effort, Experiment};
use crate::findings::{Aim, Findings};
use crate::plot::{Axis, Chart, Line, Plot};
use crate::table::{Cell, Table};
use simulated::Simulated;
use tiles::{Measured, Slower};

pub(crate) const EXPERIMENT: Experiment = Experiment {
    name: "table3",
    shows: "communication at the display and frame rate from 2 to 1024 nodes, as in the paper's Table 3",
    run,
};

/// The paper's scene has 827 primitives.
const DEPTH: u32 = 3;

/// Render threads of a node, as in the paper.
const THREADS: u16 = 2;

/// How much is done.
#[derive(Clone, Copy, Debug)]
struct Amount {
    size: u32,
    frames: u32,
    rounds: u32,
    reps: u32,
    nodes: &'static [u16],
}

const FULL: Amount =
    Amount { size: 512, frames: 24, rounds: 5, reps: 5, nodes: &[2, 6, 12, 18, 24, 31, 64, 256, 1024] };
const QUICK: Amount = Amount { size: 96, frames: 6, rounds: 1, reps: 1, nodes: &[2, 6] };

/// A column of the paper's Table 3: nodes; seconds of communication a frame and frames a second with demand and with
/// stealing.
type Column = (u16, [f64; 2], [f64; 2]);

const PAPER: [Column; 6] = [
    (2, [0.06, 1.51], [0.06, 1.62]),
    (6, [0.07, 4.25], [0.06, 4.59]),
    (12, [0.08, 8.18], [0.06, 8.79]),
    (18, [0.08, 11.1], [0.06, 12.6]),
    (24, [0.09, 12.0], [0.06, 15.5]),
    (31, [0.09, 12.3], [0.06, 17.3]),
];

/// A kind of cluster.
struct Kind {
    name: &'static str,
    balancer: Balancer,
    network: Network,
    displays: u16,
    /// How many times longer drawing takes than here.
    times: f64,
}

/// A simulated cluster.
struct Point {
    kind: usize,
    nodes: u16,
    simulated: Simulated,
}

fn run(effort: Effort) -> Result<Findings> {
    let amount = effort.pick(FULL, QUICK);
    let image = build(sphereflake(DEPTH), &BuildOptions::default(), &|_| {})?.to_bytes(PAGE_BYTES)?;
    let session = session(amount)?;
    effort.say("what tiles take");
    let [ours, papers] =
        [32, 8].map(|edge| Measured::draw(&image, &session, amount.size, edge, amount.rounds));
    let (ours, papers) = (ours?, papers?);
    let real = real::runs(&session, amount, effort)?;
    let calibrated = real::calibrate(&ours, &real, real::wire(effort.pick(20_000, 100))?, effort)?;
    let costs = Costs { tile_in: nanoseconds(papers.place_ns), ..calibrated.costs };
    let kinds = kinds(&papers);
    let points = simulate(&kinds, &papers, costs, amount, effort)?;
    let mut aims = calibrated.aims;
    aims.extend(aims_of(&kinds, &points));
    Ok(Findings {
        tables: vec![calibrated.table, table(&kinds, &points, &papers, amount)],
        aims,
        plot: Some(plot(&kinds, &points)),
    })
}

/// Half a degree a frame around the scene.
fn session(amount: Amount) -> Result<Session> {
    Path { way: Way::Orbit, circle: Some(720), frames: amount.frames, radius: 1.5, ..Path::default() }
        .session()
}

fn kinds(tiles: &Measured) -> Vec<Kind> {
    // So that two nodes with nothing to wait for draw as many frames a second as the paper's with stealing.
    let times = 2.0 * f64::from(THREADS) / PAPER[0].2[1] * 1e3 / tiles.frame_ms().max(1e-6);
    let [gigabit, modern] = [Network::gigabit(), Network::hundred_gigabit()];
    let kind = |name, balancer, network: &Network, displays, times| Kind {
        name,
        balancer,
        network: network.clone(),
        displays,
        times,
    };
    vec![
        kind("paper's work, 1 Gbit/s", Balancer::StealNear, &gigabit, 1, times),
        kind("paper's work, 1 Gbit/s", Balancer::StealNear, &gigabit, 4, times),
        kind("paper's work, 1 Gbit/s", Balancer::Steal, &gigabit, 1, times),
        kind("paper's work, 1 Gbit/s", Balancer::Demand { window: 1 }, &gigabit, 1, times),
        kind("paper's work, 100 Gbit/s", Balancer::StealNear, &modern, 4, times),
        kind("work as here, 100 Gbit/s", Balancer::StealNear, &modern, 4, 1.0),
    ]
}

fn simulate(
    kinds: &[Kind],
    tiles: &Measured,
    costs: Costs,
    amount: Amount,
    effort: Effort,
) -> Result<Vec<Point>> {
    let mut points = Vec::new();
    for (number, kind) in kinds.iter().enumerate() {
        for nodes in amount.nodes {
            effort.say(&format!("{}, {}: {nodes} nodes", kind.name, kind.balancer));
            let gather = Gather {
                displays: kind.displays,
                // The next tile is dealt when one has come.
                parcel_tiles: if kind.balancer.steals() { u32::MAX } else { 1 },
                ..Gather::new(costs)
            };
            let config = Config {
                network: kind.network.clone(),
                ..simulated::config(*nodes, tiles, kind.balancer, gather)
            };
            let simulated = simulated::run(&config, &Slower { tiles, times: kind.times })?;
            points.push(Point { kind: number, nodes: *nodes, simulated });
        }
    }
    Ok(points)
}

impl Point {
    fn rate(&self) -> f64 {
        1e3 / self.simulated.frame_ms
    }
}

/// Frames a second over those of two nodes, of what the number of nodes allows.
fn efficiency(points: &[Point], point: &Point) -> f64 {
    let two = points.iter().find(|other| other.kind == point.kind && other.nodes == 2);
    two.map_or(0.0, |two| point.rate() / two.rate() * 2.0 / f64::from(point.nodes))
}

fn table(kinds: &[Kind], points: &[Point], tiles: &Measured, amount: Amount) -> Table {
    let size = amount.size;
    let title = format!(
        "sphereflake, {size}x{size}, tiles of 8x8, {THREADS} threads a node, {} frames of an orbit of half a degree a frame, virtual time",
        amount.frames
    );
    let heads = [
        "cluster",
        "balancer",
        "displays",
        "nodes",
        "talk s/f",
        "busiest thread",
        "fps",
        "efficiency",
        "parcels",
        "tiles moved",
        "paper's talk s/f",
        "paper's fps",
        "paper's efficiency",
    ];
    let mut table = Table::new("table3", title, &heads);
    for point in points {
        let kind = &kinds[point.kind];
        let Simulated { talk_ms, most_ms, parcels, moved, .. } = point.simulated;
        let mut row = vec![
            Cell::text(kind.name),
            Cell::text(kind.balancer.to_string()),
            Cell::Count(kind.displays.into()),
            Cell::Count(point.nodes.into()),
            Cell::Number(talk_ms / 1e3, 5),
            Cell::Number(most_ms / 1e3, 5),
            Cell::Number(point.rate(), 2),
            Cell::Number(efficiency(points, point), 3),
            Cell::Number(parcels, 1),
            Cell::Number(moved, 1),
        ];
        row.extend(papers(kind.balancer, point.nodes));
        table.push(row);
    }
    table.note("talk: receiving tiles and putting them in place, sending deals and reading answers, all threads of the supervisor; efficiency: over 2 nodes of the same kind");
    table.note(format!("paper's work: drawing takes {:.0} times as long as here, so that two nodes draw the paper's 1.62 frames a second; communication takes what it takes here", kinds[0].times));
    table.note(format!(
        "here a frame takes one thread {:.2} ms in tiles of 8x8, the dearest tile {:.3} ms",
        tiles.frame_ms(),
        tiles.dearest_ms()
    ));
    table
}

/// The paper's figures beside ours, where it has some.
fn papers(balancer: Balancer, nodes: u16) -> [Cell; 3] {
    let of = |[talk, rate]: [f64; 2], [_, two]: [f64; 2]| {
        let efficiency = rate / two * 2.0 / f64::from(nodes);
        [Cell::Number(talk, 2), Cell::Number(rate, 2), Cell::Number(efficiency, 2)]
    };
    let column = PAPER.iter().find(|column| column.0 == nodes);
    match (column, balancer.steals()) {
        (Some(column), true) => of(column.2, PAPER[0].2),
        (Some(column), false) => of(column.1, PAPER[0].1),
        (None, _) => [(); 3].map(|()| Cell::text("")),
    }
}

fn aims_of(kinds: &[Kind], points: &[Point]) -> Vec<Aim> {
    let mut aims = Vec::new();
    for (number, kind) in kinds.iter().enumerate().filter(|(_, kind)| kind.times != 1.0) {
        if kind.balancer != Balancer::StealNear || kind.displays == 1 {
            continue;
        }
        let at = |nodes: u16| points.iter().find(|point| point.kind == number && point.nodes == nodes);
        for (nodes, least) in [(31, 0.9), (256, 0.7)] {
            if let Some(point) = at(nodes) {
                let what = format!("{}: efficiency at {nodes} nodes", kind.name);
                aims.push(Aim::at_least(what, efficiency(points, point), least));
            }
        }
        if let (Some(two), Some(most)) = (at(2), points.iter().rfind(|point| point.kind == number)) {
            let ratio = most.simulated.talk_ms / two.simulated.talk_ms;
            aims.push(Aim::at_most(
                format!("{}: talk of {} nodes over 2", kind.name, most.nodes),
                ratio,
                1.25,
            ));
            let what =
                format!("{}: the display's busiest thread over the frame, {} nodes", kind.name, most.nodes);
            aims.push(Aim::at_most(what, most.simulated.most_ms / most.simulated.frame_ms, 0.9));
        }
    }
    aims
}

fn plot(kinds: &[Kind], points: &[Point]) -> Plot {
    let chart = |title: &str, label: &'static str, of: &dyn Fn(&Point) -> f64| {
        let line = |(number, kind): (usize, &Kind)| {
            let its = points.iter().filter(|point| point.kind == number);
            let name = format!("{}, {}, {} displays", kind.name, kind.balancer, kind.displays);
            Line { name, points: its.map(|point| (f64::from(point.nodes), of(point))).collect() }
        };
        let x = Axis { label: "nodes", is_logarithmic: true };
        let y = Axis { label, is_logarithmic: true };
        Chart { title: title.to_owned(), x, y, lines: kinds.iter().enumerate().map(line).collect() }
    };
    let talk = |point: &Point| point.simulated.talk_ms;
    Plot {
        charts: vec![
            chart("Communication at the display", "ms a frame", &talk),
            chart("Frame rate", "frames a second", &Point::rate),
            chart("Parallel efficiency", "over two nodes", &|point| efficiency(points, point)),
        ],
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time")]
fn nanoseconds(value: f64) -> u64 {
    value.max(0.0) as u64
}

const PAGE_BYTES: u32 = 16 << 10;
