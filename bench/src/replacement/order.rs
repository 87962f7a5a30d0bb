//! What the order in which tiles are drawn does to misses.

use dsm_core::replacement::PolicyKind;
use memsavvy::trace::{NodeFrame, Trace};
use rt_core::TileId;

use super::replays::{Source, replay};
use super::{DEFAULT, Raced, SIXTEEN, min_misses, slots};
use crate::table::{Cell, Table};

/// How the tiles of a frame follow each other.
#[derive(Clone, Copy, Debug)]
struct Order {
    name: &'static str,
    in_rows: bool,
    turns: bool,
}

const ORDERS: [Order; 4] = [
    Order { name: "rows", in_rows: true, turns: false },
    Order { name: "rows, odd frames backwards", in_rows: true, turns: true },
    Order { name: "Hilbert curve", in_rows: false, turns: false },
    Order { name: "Hilbert curve, odd frames backwards", in_rows: false, turns: true },
];

/// Misses a frame at 16 %, by order and policy.
pub(super) fn table(raced: &[Raced]) -> Table {
    let heads = ["trace", "order of tiles", "min", "recall", "clock", "random"];
    let mut table = Table::new("order", "Misses a frame at 16 %, by the order of tiles", &heads);
    for of in raced {
        for order in ORDERS {
            let trace = order.of(&of.trace);
            let slots = slots(&trace, SIXTEEN);
            let frames = trace.frames.len() as f64;
            let misses = |policy, source| replay(&trace, slots, policy, source).misses as f64 / frames;
            table.push(vec![
                Cell::text(&of.name),
                Cell::text(order.name),
                Cell::Number(min_misses(&trace, slots) as f64 / frames, 0),
                Cell::Number(misses(DEFAULT.policy, DEFAULT.source), 0),
                Cell::Number(misses(PolicyKind::Clock, Source::Hints), 0),
                Cell::Number(misses(PolicyKind::Random, Source::Nothing), 0),
            ]);
        }
    }
    table.note("the last order is that of a run; recall and clock are told by hints");
    table
}

impl Order {
    /// The trace as it would be in this order. What a tile touches does not depend on it.
    fn of(self, trace: &Trace) -> Trace {
        let frames = (0..)
            .zip(&trace.frames)
            .map(|(number, frame)| frame.iter().map(|frame| self.of_frame(frame, number)).collect());
        Trace { frames: frames.collect(), ..trace.clone() }
    }

    /// A recorded frame lies on the curve, backwards when its number is odd.
    fn of_frame(self, frame: &NodeFrame, number: u32) -> NodeFrame {
        let is_odd = number % 2 == 1;
        let mut tiles: Vec<(TileId, &[u32])> = frame.tiles().collect();
        if self.in_rows {
            tiles.sort_unstable_by_key(|(tile, _)| *tile);
        }
        let is_backwards = is_odd && !self.in_rows;
        if is_backwards != (is_odd && self.turns) {
            tiles.reverse();
        }
        let mut ordered = NodeFrame::default();
        tiles.into_iter().for_each(|(tile, touches)| ordered.push(tile, touches));
        ordered
    }
}
