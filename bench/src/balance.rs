//! The stiff cases of balancing, in virtual time: whether it settles, and what it costs beside the fixed deal.

use anyhow::{Result, ensure};
use dsm_sim::balance::{Case, Memory, Report, run as simulate};
use dsm_sim::cluster::Ended;
use rt_core::schedule::Balancer;

use crate::experiment::{Effort, Experiment};
use crate::findings::{Aim, Findings};
use crate::plot::{Axis, Chart, Line, Plot};
use crate::table::{Cell, Table};

pub(crate) const EXPERIMENT: Experiment = Experiment {
    name: "balance",
    shows: "stiff cases of balancing in virtual time: does it settle, and what does it cost beside a fixed deal",
    run,
};

/// What `steal-near` may take of the time that `static` takes.
const MARGINS: [(Case, f64); 6] = [
    (Case::Steady, 1.02),
    (Case::DearTile, 1.02),
    (Case::Alternating, 1.15),
    (Case::SlowNode, 0.1),
    (Case::Stalls, 1.05),
    (Case::Far, 1.1),
];

fn run(effort: Effort) -> Result<Findings> {
    let heads = [
        "case",
        "balancer",
        "ms a frame",
        "over static",
        "settles after",
        "tiles moved a frame",
        "begun twice",
    ];
    let title = "8 nodes of one thread, 16x16 tiles of about 1 ms, a gigabit network, virtual time";
    let mut table = Table::new("balance", title, &heads);
    let (mut aims, mut charts) = (Vec::new(), Vec::new());
    for (case, margin) in MARGINS {
        effort.say(case.name());
        let mut fixed_ms = 0.0;
        for balancer in Balancer::ALL {
            let report = draw(case, balancer)?;
            let ms = Case::frame_ms(&report);
            if balancer == Balancer::Static {
                fixed_ms = ms;
            }
            let late = &report.frames[10..];
            let moved = late.iter().map(|frame| f64::from(frame.moved)).sum::<f64>() / late.len() as f64;
            let begun: u32 = report.frames.iter().map(|frame| frame.begun - 256).sum();
            table.push(vec![
                Cell::text(case.name()),
                Cell::text(balancer.to_string()),
                Cell::Number(ms, 2),
                Cell::Number(ms / fixed_ms, 3),
                Cell::Count(Case::settles_after(&report) as u64),
                Cell::Number(moved, 2),
                Cell::Count(begun.into()),
            ]);
            if balancer == Balancer::StealNear {
                aims.push(Aim::at_most(
                    format!("{}: steal-near over static", case.name()),
                    ms / fixed_ms,
                    margin,
                ));
                if case == Case::Steady {
                    let what = "tiles moved in a steady view after 10 frames, in %";
                    aims.push(Aim::at_most(what, 100.0 * moved / 256.0, 1.0));
                }
                charts.push(chart(case, &report));
            }
        }
    }
    table.note("ms: mean from the third frame on; settles after: frames until a frame's time stays within 20 % of what it is in the end");
    table.note("moved: after the first ten frames; begun twice: tiles that two nodes drew, of all frames");
    Ok(Findings { tables: vec![table], aims, plot: Some(Plot { charts }) })
}

fn draw(case: Case, balancer: Balancer) -> Result<Report> {
    let config = case.config(balancer);
    let report = simulate(&config, &case, &mut Memory::new(&config), 1);
    ensure!(report.ended == Ended::Done, "{}: {balancer} ended with {:?}", case.name(), report.ended);
    Ok(report)
}

/// Time that each node spends drawing, frame by frame.
fn chart(case: Case, report: &Report) -> Chart {
    let nodes = report.frames.first().map_or(0, |frame| frame.busy_ns.len());
    let line = |node: usize| {
        let points = (1..)
            .zip(&report.frames)
            .map(|(number, frame)| (f64::from(number), frame.busy_ns[node] as f64 / 1e6));
        Line { name: format!("node {node}"), points: points.collect() }
    };
    Chart {
        title: case.name().to_owned(),
        x: Axis { label: "frame", is_logarithmic: false },
        y: Axis { label: "ms a node draws", is_logarithmic: false },
        lines: (0..nodes).map(line).collect(),
    }
}
