//! What one thread's kernels do when nothing is paged.

use anyhow::Result;
use memsavvy::run::Options;
use rt_core::Kernel;

use super::scenes::{Scene, Scenes};
use super::{Amount, Holds, Shape};
use crate::experiment::Effort;
use crate::images::Images;
use crate::spread::Spread;
use crate::table::{Cell, Table};

/// Renders every scene from afar and from near, by rays and by beams in turns, with one node of one thread that holds all.
pub(super) fn measure(scenes: &Scenes, amount: Amount, effort: Effort) -> Result<Table> {
    let mut views: Vec<View> = scenes.far_and_near().into_iter().map(View::new).collect();
    for rep in 0..amount.reps {
        effort.say(&format!("one thread's kernels, repetition {} of {}", rep + 1, amount.reps));
        for view in &mut views {
            view.render(amount)?;
        }
    }
    let title = "one thread's kernels: one node, replicated, rays from the eye and to the light together";
    let heads = ["scene", "radius", "kernel", "Mrays/s", "best Mrays/s"];
    let mut table = Table::new("kernel", title, &heads);
    views.iter().flat_map(View::rows).for_each(|row| table.push(row));
    table.note("time of the whole frame: ray generation, shading and the gathering of tiles included");
    table.note("rays: one after the other; avx512, avx2, portable: beams with these lanes, which draw the same bytes");
    Ok(table)
}

/// A view of a scene, and the rates at which each kernel drew it.
struct View {
    scene: Scene,
    images: Images,
    rates: Vec<(Kernel, Vec<f64>)>,
}

impl View {
    fn new(scene: Scene) -> Self {
        let rates = Kernel::available().map(|kernel| (kernel, Vec::new())).collect();
        Self { scene, images: Images::default(), rates }
    }

    fn render(&mut self, amount: Amount) -> Result<()> {
        for (kernel, rates) in &mut self.rates {
            let shape = Shape { nodes: 1, holds: Holds::Replica };
            let options = Options { kernel: Some(*kernel), ..shape.options(&self.scene, amount)? };
            let run = memsavvy::run::run(&options, |_| Ok(()))?;
            self.images.expect_same(&run)?;
            rates.push(run.totals.mrays_per_second);
        }
        Ok(())
    }

    fn rows(&self) -> impl Iterator<Item = Vec<Cell>> {
        self.rates.iter().map(|(kernel, rates)| {
            vec![
                Cell::text(&*self.scene.name),
                Cell::Number(self.scene.radius.into(), 2),
                Cell::text(kernel.name()),
                Cell::Spread(Spread::of(rates), 2),
                Cell::Number(rates.iter().copied().fold(0.0, f64::max), 2),
            ]
        })
    }
}
