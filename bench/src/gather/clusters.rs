//! Real runs: what their displays report.

use core::num::NonZeroU16;
use core::time::Duration;

use anyhow::Result;
use memsavvy::report::RunReport;
use memsavvy::run::{self, Options, Source};
use memsavvy::size::PictureSize;
use scene::builtin::BuiltIn;

use super::Amount;
use super::frames::Camera;
use crate::data;
use crate::experiment::Effort;
use crate::findings::Aim;
use crate::images::Images;
use crate::spread::Spread;
use crate::table::{Cell, Table};

/// Two nodes of one thread.
const NODES: u16 = 2;

const DISPLAYS: [u16; 2] = [1, 2];

/// Renders with each camera and number of displays. All see the same pictures.
pub(crate) fn run(effort: Effort, amount: Amount) -> Result<(Table, Vec<Aim>)> {
    let heads =
        ["scene", "camera", "displays", "bytes a frame", "tiles changed", "ms in communication", "us a tile"];
    let title = format!("what the displays of {NODES} nodes report, a frame after the first");
    let (mut table, mut aims) = (Table::new("clusters", title, &heads), Vec::new());
    let (name, source) = source(effort);
    for camera in Camera::ALL {
        let mut images = Images::default();
        for displays in DISPLAYS {
            effort.say(&format!("{name} {}: {displays} displays", camera.name()));
            let report = run::run(&options(&source, camera, displays, amount)?, |_| Ok(()))?;
            images.expect_same(&report)?;
            let later = Later::of(&report);
            let tiles = f64::from(amount.size.div_ceil(rt_core::TILE_SIZE).pow(2));
            let us = later.ms * 1000.0 / tiles;
            table.push(vec![
                Cell::text(&name),
                Cell::text(camera.name()),
                Cell::Count(displays.into()),
                Cell::Number(later.bytes, 0),
                Cell::Number(later.changed, 1),
                Cell::Number(later.ms, 3),
                Cell::Number(us, 3),
            ]);
            let what =
                format!("{name} {}, {displays} displays: us in communication for 64 pixels", camera.name());
            let pixels = f64::from(amount.size * amount.size);
            aims.push(Aim::at_most(what, later.ms * 1000.0 * 64.0 / pixels, super::TILE_US_MAX));
        }
    }
    table.note("ms in communication: receiving, taking apart and putting in place, summed over the displays, median of frames; with other threads on the same cores it is the wall's time");
    Ok((table, aims))
}

/// Medians over the frames after the first.
struct Later {
    bytes: f64,
    changed: f64,
    ms: f64,
}

impl Later {
    fn of(report: &RunReport) -> Self {
        let of = |value: &dyn Fn(&memsavvy::report::FrameReport) -> f64| {
            Spread::of(&report.frames.iter().skip(1).map(value).collect::<Vec<_>>()).median
        };
        Self {
            bytes: of(&|frame| frame.gather_bytes as f64),
            changed: of(&|frame| frame.changed_tiles as f64),
            ms: of(&|frame| frame.gather_ms),
        }
    }
}

fn source(effort: Effort) -> (String, Source) {
    match data::mesh_file("dragon", effort).filter(|path| path.exists() && !effort.is_quick()) {
        Some(path) => ("dragon".to_owned(), Source::Path(path)),
        None => {
            let triangles = effort.pick(600_000, 5_000);
            ("knot".to_owned(), Source::BuiltIn(BuiltIn::Knot { triangles }))
        }
    }
}

fn options(source: &Source, camera: Camera, displays: u16, amount: Amount) -> Result<Options> {
    Ok(Options {
        source: source.clone(),
        nodes: NODES,
        threads: Some(NonZeroU16::MIN),
        displays,
        size: PictureSize { width: amount.size, height: amount.size },
        session: camera.session(amount.frames, 0.75)?,
        deadline: Duration::from_secs(60),
        quiet: true,
        ..Options::default()
    })
}
