//! What one thread's ray kernel does when nothing is paged.

use anyhow::Result;

use super::scenes::Scenes;
use super::{Amount, Holds, Images, Shape};
use crate::experiment::Effort;
use crate::spread::Spread;
use crate::table::{Cell, Table};

/// Renders every scene from afar and from near, in turns, with one node of one thread that holds all.
pub(super) fn measure(scenes: &Scenes, amount: Amount, effort: Effort) -> Result<Table> {
    let views = scenes.far_and_near();
    let mut rates = vec![Vec::new(); views.len()];
    let mut images: Vec<Images> = views.iter().map(|_| Images::default()).collect();
    for rep in 0..amount.reps {
        effort.say(&format!("one thread's kernel, repetition {} of {}", rep + 1, amount.reps));
        for ((view, rates), images) in views.iter().zip(&mut rates).zip(&mut images) {
            let shape = Shape { nodes: 1, holds: Holds::Replica };
            let run = memsavvy::run::run(&shape.options(view, amount), |_, _| Ok(()))?;
            images.expect_same(&run)?;
            rates.push(run.totals.mrays_per_second);
        }
    }
    let title = "one thread's ray kernel: one node, replicated, rays from the eye and to the light together";
    let mut table = Table::new("kernel", title, &["scene", "radius", "Mrays/s", "best Mrays/s"]);
    for (view, rates) in views.iter().zip(&rates) {
        table.push(vec![
            Cell::text(&*view.name),
            Cell::Number(view.radius.into(), 2),
            Cell::Spread(Spread::of(rates), 2),
            Cell::Number(rates.iter().copied().fold(0.0, f64::max), 2),
        ]);
    }
    table.note("time of the whole frame: ray generation, shading and the gathering of tiles included");
    Ok(table)
}
