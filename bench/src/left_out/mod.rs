//! What a scene does not need, forced on and left out: code, pages, time.
//!
//! # The map
//!
//! | module | what it holds |
//! |---|---|
//! | [`program`] | building `left-out`, a renderer with chosen features, and the size of its code |

mod program;

use std::time::Instant;

use anyhow::{Result, ensure};
use kernels::Draw;
use kernels::noted::{Noted, Notes};
use rt_core::camera::OrbitPlace;
use rt_core::{Flat, Frame, Kernel, Orbit, SceneMemory, SceneNeeds, SceneView, TILE_SIZE, Tiles};
use scene::{BuildOptions, Model, build, builtin, read_mesh};

use crate::data;
use crate::experiment::{Effort, Experiment};
use crate::findings::{Aim, Findings};
use crate::plot::{Axis, Chart, Line, Plot};
use crate::quiet;
use crate::spread::Spread;
use crate::table::{Cell, Table};
use program::Programs;

pub(crate) const EXPERIMENT: Experiment = Experiment {
    name: "left-out",
    shows: "code, pages and time of a scene with everything forced on, and with what it needs",
    run,
};

const PAGE_BYTES: u32 = 16 << 10;

/// How much is drawn.
#[derive(Clone, Copy, Debug)]
struct Amount {
    size: u32,
    rounds: usize,
}

const FULL: Amount = Amount { size: 512, rounds: 9 };
const QUICK: Amount = Amount { size: 64, rounds: 1 };

/// A scene to be drawn in several ways.
struct Subject {
    name: &'static str,
    model: Model,
    elevation: f64,
}

/// One way to draw a scene.
#[derive(Clone, Copy, Debug)]
struct Way {
    name: &'static str,
    /// Every kind of primitive is traced, needed or not.
    forced: bool,
    shadows: bool,
}

const WAYS: [Way; 3] = [
    Way { name: "everything forced on", forced: true, shadows: true },
    Way { name: "what it needs", forced: false, shadows: true },
    Way { name: "and no shadows", forced: false, shadows: false },
];

fn run(effort: Effort) -> Result<Findings> {
    let amount = effort.pick(FULL, QUICK);
    let mut programs = Programs::new()?;
    let heads = ["scene", "drawn with", "code bytes", "structure bytes", "pages touched", "ms a frame"];
    let title =
        format!("what a scene does not need: one frame of {0}x{0}, radius 0.75, one thread", amount.size);
    let (mut table, mut aims, mut charts) = (Table::new("left_out", title, &heads), Vec::new(), Vec::new());
    for subject in subjects(effort)? {
        effort.say(&format!("{}: building", subject.name));
        let image = build(subject.model.clone(), &BuildOptions::default(), &|_| {})?.to_bytes(PAGE_BYTES)?;
        let scene = SceneView::new(Flat::new(&image))?;
        let frame = frame_of(&scene, &subject, amount)?;
        ensure_same(&scene, &frame)?;
        let rounds = quiet::rounds(effort, subject.name, amount.rounds, |_| Ok(round(&scene, &frame)))?;
        let times = |way: usize| rounds.rounds.iter().map(|times| times[way]).collect::<Vec<f64>>();
        for (index, way) in WAYS.iter().enumerate() {
            let needs = if way.forced { SceneNeeds::KNOWN } else { scene.header().needs };
            // A quick look builds one program that draws; each takes a while.
            let is_wanted = way.forced || !effort.is_quick();
            let code = if is_wanted { programs.code_bytes(&features(needs, way.shadows))? } else { None };
            table.push(vec![
                Cell::text(subject.name),
                Cell::text(way.name),
                code.map_or_else(|| Cell::text("-"), Cell::Count),
                Cell::Count(image.len() as u64),
                Cell::Count(pages_touched(&image, &frame, way)?),
                Cell::Spread(Spread::of(&times(index)), 2),
            ]);
        }
        // A scene that needs everything is drawn the same way twice.
        if scene.header().needs != SceneNeeds::KNOWN {
            let [forced, needed] = [0, 1].map(|way| Spread::of(&times(way)).median);
            let what = format!("{}: time with what it needs, of everything", subject.name);
            aims.push(Aim::at_most(what, needed / forced, 1.02));
        }
        charts.push(chart(subject.name, &times));
        table.note(format!("{}: needs {}; {}", subject.name, scene.header().needs, rounds.note()));
    }
    table.note("code: of a program that draws, less that of the same program without drawing; lanes as this processor has them");
    table.note(
        "structure: an image has no segment that a scene does not need, so there is nothing to force on",
    );
    programs.notes().for_each(|note| table.note(note));
    Ok(Findings { tables: vec![table], aims, plot: Some(Plot { charts }) })
}

/// The bunny, a knot, spheres, and spheres among triangles.
fn subjects(effort: Effort) -> Result<Vec<Subject>> {
    let mut subjects = Vec::new();
    if let Some(path) = data::mesh_file("bunny", effort).filter(|path| path.exists() && !effort.is_quick()) {
        subjects.push(Subject { name: "bunny", model: read_mesh(&path)?.into(), elevation: 0.0 });
    }
    let triangles = effort.pick(200_000, 5_000);
    let flake = builtin::sphereflake(effort.pick(3, 1));
    let mixed = Model { mesh: builtin::knot(triangles), view: None, ..flake.clone() };
    subjects.push(Subject { name: "knot", model: builtin::knot(triangles).into(), elevation: 20.0 });
    if !effort.is_quick() {
        subjects.push(Subject { name: "sphereflake", model: flake, elevation: 20.0 });
    }
    subjects.push(Subject { name: "knot and sphereflake", model: mixed, elevation: 20.0 });
    Ok(subjects)
}

fn frame_of(scene: &SceneView<Flat<'_>>, subject: &Subject, amount: Amount) -> Result<Frame> {
    let place = OrbitPlace { radius: 0.75, elevation: subject.elevation, frame: 0, frames: 12 };
    Ok(Frame::on_orbit(&Orbit::around(&scene.header().view), &place, amount.size, amount.size)?)
}

/// Asserts that what is forced on does not show.
fn ensure_same(scene: &SceneView<Flat<'_>>, frame: &Frame) -> Result<()> {
    let [forced, needed] = [WAYS[0], WAYS[1]].map(|way| draw(&way.of(*scene), &way.frame(frame)));
    ensure!(forced == needed, "SAME_IMAGE: forcing on what is not needed changed the picture");
    Ok(())
}

/// Milliseconds of each way.
fn round(scene: &SceneView<Flat<'_>>, frame: &Frame) -> [f64; 3] {
    WAYS.map(|way| {
        let (scene, frame) = (way.of(*scene), way.frame(frame));
        let started = Instant::now();
        draw(&scene, &frame);
        started.elapsed().as_secs_f64() * 1e3
    })
}

fn pages_touched(image: &[u8], frame: &Frame, way: &Way) -> Result<u64> {
    let notes = Notes::new(PAGE_BYTES, image.len() as u64);
    let scene = way.of(SceneView::new(Noted::new(Flat::new(image), &notes))?);
    draw(&scene, &way.frame(frame));
    let mut count = 0;
    notes.take(|pages| count = pages.len() as u64);
    Ok(count)
}

/// Draws a picture with the fastest kernel; a sum of its bytes by place.
fn draw<M: Draw>(scene: &SceneView<M>, frame: &Frame) -> u64 {
    let (tiles, kernel) = (Tiles::of(frame.width, frame.height), Kernel::fastest());
    let mut pixels = [0; (TILE_SIZE * TILE_SIZE) as usize];
    let mut sum = 0_u64;
    for tile in tiles.ids().filter_map(|id| tiles.get(id)) {
        let pixels = &mut pixels[..tile.pixels()];
        Draw::render_tile(scene, frame, tile, kernel, pixels);
        sum = pixels.iter().fold(sum, |sum, &grey| sum.wrapping_mul(31).wrapping_add(u64::from(grey)));
    }
    sum
}

/// The features of a program that draws such scenes, in the order of the manifest.
fn features(needs: SceneNeeds, shadows: bool) -> Vec<&'static str> {
    let mut features = vec!["draw"];
    let parts = [
        ("triangles", needs.contains(SceneNeeds::TRIANGLES)),
        ("spheres", needs.contains(SceneNeeds::SPHERES)),
        ("shadows", shadows),
    ];
    features.extend(parts.into_iter().filter_map(|(name, wanted)| wanted.then_some(name)));
    features.extend(["lanes-avx2", "lanes-avx512"]);
    features
}

fn chart(name: &str, times: &dyn Fn(usize) -> Vec<f64>) -> Chart {
    let points = |way: usize| (1..).map(f64::from).zip(times(way)).collect::<Vec<_>>();
    let line = |(way, of): (usize, &Way)| {
        let mut points = points(way);
        // A line has two ends, also of one round.
        points.extend(points.last().map(|&(round, ms)| (round + 1.0, ms)));
        Line { name: of.name.to_owned(), points }
    };
    Chart {
        title: name.to_owned(),
        x: Axis { label: "round", is_logarithmic: false },
        y: Axis { label: "ms a frame", is_logarithmic: false },
        lines: WAYS.iter().enumerate().map(line).collect(),
    }
}

impl Way {
    fn of<M: SceneMemory>(self, scene: SceneView<M>) -> SceneView<M> {
        if self.forced { scene.with_needs(SceneNeeds::BUILT) } else { scene }
    }

    fn frame(self, frame: &Frame) -> Frame {
        let flags = if self.shadows { frame.flags } else { frame.flags | Frame::NO_SHADOWS };
        Frame { flags, ..*frame }
    }
}
