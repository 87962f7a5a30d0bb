//! Misses of beams beside those of rays.
//!
//! A beam must not touch pages that none of its rays would: a tile drawn at once is no excuse for more traffic.

use anyhow::Result;
use memsavvy::run::{self, Options, Prefetch};
use rt_core::{Kernel, Lanes};

use super::scenes::{Scene, Scenes};
use super::{Amount, Holds, Shape};
use crate::findings::Aim;
use crate::images::Images;
use crate::table::{Cell, Table};

/// Counts the misses of both kernels on all scenes with 16 % memory.
pub(super) fn count(scenes: &Scenes, amount: Amount) -> Result<(Table, Vec<Aim>)> {
    let nodes = amount.nodes.iter().copied().max().unwrap_or(1);
    let title = format!("misses a frame: beams and rays, {nodes} nodes and a store, 16 % memory");
    let heads = ["scene", "radius", "beams", "rays", "beams / rays"];
    let mut table = Table::new("scaling-misses", title, &heads);
    table.note("pages fetched, without prefetch, the first frame among them; the same picture");
    let mut aims = Vec::new();
    for scene in scenes.far_and_near() {
        let mut images = Images::default();
        let shape = Shape { nodes, holds: Holds::Sixteen };
        let [beams, rays] = [Kernel::fastest(), Kernel::Rays(Lanes::widest())].map(|kernel| -> Result<f64> {
            let options =
                Options { kernel: Some(kernel), prefetch: Prefetch::None, ..shape.options(&scene, amount)? };
            let run = run::run(&options, |_| Ok(()))?;
            images.expect_same(&run)?;
            Ok(run.totals.fetched_pages as f64 / run.frames.len() as f64)
        });
        let (beams, rays) = (beams?, rays?);
        let Scene { name, radius, .. } = &scene;
        table.push(vec![
            Cell::text(&**name),
            Cell::Number((*radius).into(), 2),
            Cell::Number(beams, 0),
            Cell::Number(rays, 0),
            Cell::Number(beams / rays, 2),
        ]);
        let what = format!("{name} from {radius}: misses of beams, in those of rays");
        aims.push(Aim::at_most(what, beams / rays, 1.0));
    }
    Ok((table, aims))
}
