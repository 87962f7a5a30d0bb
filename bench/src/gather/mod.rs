//! Gathering: bytes a frame for still, slow and fast cameras, and what a tile costs a display.
//!
//! # The map
//!
//! | module | what it holds |
//! |---|---|
//! | `ways` | ways to make a tile small: ours and those it was chosen over |
//! | `frames` | the frames of a camera, cut into tiles |
//! | `clusters` | real runs: what their displays report |

mod clusters;
mod frames;
mod ways;

use anyhow::{Result, ensure};

use crate::experiment::{Effort, Experiment};
use crate::findings::{Aim, Findings};
use crate::plot::{Axis, Chart, Line, Plot};
use crate::table::{Cell, Table};
use frames::{Camera, Frames};
use ways::{Cost, WAYS, Way};

pub(crate) const EXPERIMENT: Experiment = Experiment {
    name: "gather",
    shows: "bytes a frame from the nodes to the display, against raw and lz4, and the display's time for a tile",
    run,
};

/// How much is drawn.
#[derive(Clone, Copy, Debug)]
struct Amount {
    size: u32,
    frames: u32,
    rounds: usize,
}

const FULL: Amount = Amount { size: 512, frames: 6, rounds: 7 };
const QUICK: Amount = Amount { size: 96, frames: 3, rounds: 1 };

/// Edges of tiles: ours, and the paper's.
const EDGES: [usize; 2] = [32, 8];

/// Microseconds that a display may spend on a tile of 8x8 pixels, and on any 64 pixels.
const TILE_US_MAX: f64 = 3.0;

fn run(effort: Effort) -> Result<Findings> {
    let amount = effort.pick(FULL, QUICK);
    let mut bytes = bytes_table(amount);
    let mut times = Table::new(
        "times",
        "microseconds a tile: made small by a node; taken apart and put in place by a display",
        &["scene", "camera", "edge", "small", "in place", "in place, 64 pixels"],
    );
    let (mut aims, mut charts) = (Vec::new(), Vec::new());
    for scene in frames::scenes(effort)? {
        for camera in Camera::ALL {
            effort.say(&format!("{} {}: drawing", scene.name, camera.name()));
            let frames = Frames::draw(&scene, camera, amount, &EDGES)?;
            for edge in EDGES {
                let costs = WAYS.map(|way| Cost::of(way, &frames, edge, amount.rounds));
                let costs = costs.into_iter().collect::<Result<Vec<_>>>()?;
                let raw_bytes = Cost::bytes_of_frame(Way::Raw, &frames, edge, 1)?;
                bytes.push(bytes_row(&frames, edge, raw_bytes, &costs));
                let ours = &costs[0];
                ensure!(WAYS[0] == Way::Ours, "ours is the first way");
                let per_64 = ours.place_us * 64.0 / (edge * edge) as f64;
                times.push(vec![
                    Cell::text(&frames.name),
                    Cell::text(camera.name()),
                    Cell::Count(edge as u64),
                    Cell::Number(ours.encode_us, 3),
                    Cell::Number(ours.place_us, 3),
                    Cell::Number(per_64, 3),
                ]);
                aims.extend(aims_of(&frames, edge, raw_bytes, &costs, per_64));
            }
            charts.push(chart(&frames, amount)?);
        }
    }
    bytes.note("as before: tiles that are as in the frame before travel as 5 to 9 bytes in all ways but raw");
    bytes.note("near: lz4 of what each pixel is off from its neighbours; delta: lz4 of the difference to the last frame");
    let (clusters, cluster_aims) = clusters::run(effort, amount)?;
    aims.extend(cluster_aims);
    Ok(Findings { tables: vec![bytes, times, clusters], aims, plot: Some(Plot { charts }) })
}

fn bytes_table(amount: Amount) -> Table {
    let heads =
        ["scene", "camera", "edge", "as before %", "raw", "ours", "no last frame", "lz4", "near", "delta"];
    Table::new(
        "bytes",
        format!("bytes a frame of {0}x{0} pixels, heads of tiles included", amount.size),
        &heads,
    )
}

fn bytes_row(frames: &Frames, edge: usize, raw_bytes: u64, costs: &[Cost]) -> Vec<Cell> {
    let mut row = vec![
        Cell::text(&frames.name),
        Cell::text(frames.camera.name()),
        Cell::Count(edge as u64),
        Cell::Number(100.0 * frames.unchanged(edge), 1),
        Cell::Count(raw_bytes),
    ];
    row.extend(costs.iter().map(|cost| Cell::Count(cost.bytes)));
    row
}

fn aims_of(frames: &Frames, edge: usize, raw_bytes: u64, costs: &[Cost], per_64: f64) -> Vec<Aim> {
    let name = format!("{} {}, tiles of {edge}", frames.name, frames.camera.name());
    let mut aims = Vec::new();
    let best = costs[1..].iter().map(|cost| cost.bytes).min().unwrap_or(u64::MAX);
    let ratio = costs[0].bytes as f64 / best.max(1) as f64;
    aims.push(Aim::at_most(format!("{name}: bytes of ours, of the best other way"), ratio, 1.0));
    let what = format!("{name}: us that a display spends on 64 pixels");
    aims.push(Aim::at_most(what, per_64, TILE_US_MAX));
    if frames.camera == Camera::Still && edge == EDGES[0] {
        let share = costs[0].bytes as f64 / raw_bytes as f64;
        aims.push(Aim::at_most(format!("{name}: bytes, of raw"), share, 0.01));
    }
    aims
}

/// Bytes of each frame, in ours and raw.
fn chart(frames: &Frames, amount: Amount) -> Result<Chart> {
    let edge = EDGES[0];
    let line = |way: Way| -> Result<Line> {
        let each = (1..frames.pictures.len())
            .map(|frame| Ok((frame as f64, Cost::bytes_of_frame(way, frames, edge, frame)? as f64 / 1024.0)));
        Ok(Line { name: way.name().to_owned(), points: each.collect::<Result<_>>()? })
    };
    let raw = (amount.size * amount.size) as f64 / 1024.0;
    let ends = [1.0, frames.pictures.len() as f64 - 1.0].map(|frame| (frame, raw));
    let mut lines = vec![Line { name: "raw".to_owned(), points: ends.into() }];
    for way in WAYS {
        lines.push(line(way)?);
    }
    Ok(Chart {
        title: format!("{} {}", frames.name, frames.camera.name()),
        x: Axis { label: "frame", is_logarithmic: false },
        y: Axis { label: "KB", is_logarithmic: false },
        lines,
    })
}
