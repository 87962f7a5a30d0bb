//! The triangle tests: error against run time.
//!
//! Woop's test and that of Möller and Trumbore in single precision, and the reference in double precision, on rays aimed at
//! triangles of a scan, of a knot, of needles, from far away and far off 0. What is right says [`exact`], in double
//! precision from the very numbers that the tests are given. Rays aimed at shared edges go through whole scenes.

mod dice;
mod exact;
mod subject;

use core::hint::black_box;
use std::time::Instant;

use anyhow::{Result, ensure};
use rt_core::triangle_f64::F64Ray;
use rt_core::triangle_moller::MollerRay;
use rt_core::triangle_test::TriangleTest;
use rt_core::triangle_woop::WoopRay;
use rt_core::{Flat, Hit, Ray, SceneView};

use crate::experiment::{Effort, Experiment};
use crate::findings::{Aim, Findings};
use crate::plot::{Axis, Chart, Line, Plot};
use crate::spread::{Spread, quantile};
use crate::table::{Cell, Table};
use exact::Exact;
use subject::{EdgeShots, Shots, Subject};

pub(crate) const EXPERIMENT: Experiment =
    Experiment { name: "triangle-tests", shows: "ways to test triangles: error against run time", run };

/// A triangle test, as a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Variant {
    Woop,
    Moller,
    Double,
}

const VARIANTS: [Variant; 3] = [Variant::Woop, Variant::Moller, Variant::Double];

/// What a test got wrong on one subject.
#[derive(Debug, Default)]
struct Errors {
    /// Hits that the exact answer has and the test has not, and the other way round.
    lost: u64,
    invented: u64,
    /// Of the hits that both have: error of `t` as a part of it, and of the weights, in units of 2^-24, sorted.
    t: Vec<f64>,
    weights: Vec<f64>,
}

fn run(effort: Effort) -> Result<Findings> {
    let mut tests = Table::new(
        "tests",
        "one triangle after the other, errors in units of 2^-24",
        &["subject", "test", "ns a test", "lost", "invented", "t p50", "t max", "u v p50", "u v max"],
    );
    let mut edges = Table::new(
        "edges",
        "whole scenes, rays aimed at edges between two triangles that face them",
        &["subject", "test", "rays", "slipped through", "%", "ns a ray"],
    );
    let (mut aims, mut lines) = (Vec::new(), Vec::new());
    for subject in subject::all(effort)? {
        effort.say(&subject.name);
        let points = measure_tests(&subject, effort, &mut tests)?;
        lines.push(Line { name: subject.name.clone(), points });
        aims.extend(measure_edges(&subject, effort, &mut edges)?);
    }
    tests.note("each ray meets the triangle that it is aimed at and fifteen that follow it; its preparation is not timed");
    tests.note("lost and invented: hits that the exact answer has and the test has not, and the other way round; all within rounding of an edge");
    Ok(Findings { tables: vec![tests, edges], aims, plot: Some(plot(lines)) })
}

fn plot(lines: Vec<Line>) -> Plot {
    let x = Axis { label: "ns a test", is_logarithmic: false };
    let y = Axis { label: "largest error of t, in 2^-24 of it", is_logarithmic: true };
    let title = "error against run time, Möller, Woop, double precision".to_owned();
    Plot { charts: vec![Chart { title, x, y, lines }] }
}

/// Rows for the three tests, and where each lies in the plot.
fn measure_tests(subject: &Subject, effort: Effort, table: &mut Table) -> Result<Vec<(f64, f64)>> {
    let shots = subject.shots(effort.pick(40_000, 400));
    let times = time_in_turns(&shots, effort.pick(21, 2));
    let mut points = Vec::new();
    for (variant, times) in VARIANTS.into_iter().zip(times) {
        let errors = variant.errors(&shots);
        ensure!(errors.t.len() * 2 > shots.aimed.len(), "{variant:?} misses most of what it is aimed at");
        let (t_max, ns) = (largest(&errors.t), Spread::of(&times));
        points.push((ns.median, t_max.max(0.01)));
        table.push(vec![
            Cell::text(&subject.name),
            Cell::text(variant.name()),
            Cell::Spread(ns, 2),
            Cell::Count(errors.lost),
            Cell::Count(errors.invented),
            Cell::Number(quantile(&errors.t, 0.5).unwrap_or(0.0), 2),
            Cell::Number(t_max, 1),
            Cell::Number(quantile(&errors.weights, 0.5).unwrap_or(0.0), 2),
            Cell::Number(largest(&errors.weights), 1),
        ]);
    }
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(points)
}

/// Nanoseconds a test of each variant, round after round.
fn time_in_turns(shots: &Shots, rounds: usize) -> [Vec<f64>; 3] {
    let mut times = [const { Vec::new() }; 3];
    for _ in 0..rounds {
        for (variant, times) in VARIANTS.into_iter().zip(&mut times) {
            times.push(variant.time(shots));
        }
    }
    times
}

/// Rows for rays at shared edges, and what is asked of them.
fn measure_edges(subject: &Subject, effort: Effort, table: &mut Table) -> Result<Vec<Aim>> {
    let shots = subject.edge_shots(effort.pick(100_000, 2000));
    let image = scene::build(subject.mesh.clone(), &Default::default(), &|_| {})?.to_bytes(16 << 10)?;
    let scene = SceneView::new(Flat::new(&image))?;
    let mut aims = Vec::new();
    for variant in VARIANTS {
        let started = Instant::now();
        let slipped = variant.slipped(&scene, &shots)?;
        let ns = started.elapsed().as_secs_f64() * 1e9 / shots.rays.len() as f64;
        table.push(vec![
            Cell::text(&subject.name),
            Cell::text(variant.name()),
            Cell::Count(shots.rays.len() as u64),
            Cell::Count(slipped),
            Cell::Number(slipped as f64 * 100.0 / shots.rays.len() as f64, 3),
            Cell::Number(ns, 0),
        ]);
        if variant == Variant::Woop {
            let what = format!("{}: rays that slip through shared edges by Woop's test", subject.name);
            aims.push(Aim::at_most(what, slipped as f64, 0.0));
        }
    }
    Ok(aims)
}

impl Variant {
    fn name(self) -> &'static str {
        match self {
            Self::Woop => "woop",
            Self::Moller => "moller",
            Self::Double => "f64",
        }
    }

    fn errors(self, shots: &Shots) -> Errors {
        match self {
            Self::Woop => errors_of::<WoopRay>(shots),
            Self::Moller => errors_of::<MollerRay>(shots),
            Self::Double => errors_of::<F64Ray>(shots),
        }
    }

    fn time(self, shots: &Shots) -> f64 {
        match self {
            Self::Woop => time_of::<WoopRay>(shots),
            Self::Moller => time_of::<MollerRay>(shots),
            Self::Double => time_of::<F64Ray>(shots),
        }
    }

    /// Rays that hit nothing where they were aimed at, nor before.
    fn slipped(self, scene: &SceneView<Flat<'_>>, shots: &EdgeShots) -> Result<u64> {
        let nearest = |ray: &Ray| -> Result<Option<Hit>> {
            Ok(match self {
                Self::Woop => scene.nearest(ray, &mut ())?,
                Self::Moller => scene.nearest_by::<MollerRay, _>(ray, &mut ())?,
                Self::Double => scene.nearest_by::<F64Ray, _>(ray, &mut ())?,
            })
        };
        let mut slipped = 0;
        for ray in &shots.rays {
            slipped += u64::from(nearest(ray)?.is_none_or(|hit| hit.t > shots.t_max));
        }
        Ok(slipped)
    }
}

fn errors_of<T: TriangleTest>(shots: &Shots) -> Errors {
    let mut errors = Errors::default();
    for (ray, corners) in &shots.aimed {
        let exact = Exact::of(ray, *corners);
        let found = T::new(ray.origin, ray.direction).intersect(*corners, f32::INFINITY);
        match (exact, found) {
            (Some(exact), Some(found)) => {
                errors.t.push((f64::from(found.t) / exact.t - 1.0).abs() * UNITS);
                let [u, v] = [f64::from(found.u) - exact.u, f64::from(found.v) - exact.v].map(f64::abs);
                errors.weights.push(u.max(v) * UNITS);
            }
            (Some(_), None) => errors.lost += 1,
            (None, Some(_)) => errors.invented += 1,
            (None, None) => {}
        }
    }
    errors.t.sort_by(f64::total_cmp);
    errors.weights.sort_by(f64::total_cmp);
    errors
}

/// Nanoseconds a test.
fn time_of<T: TriangleTest>(shots: &Shots) -> f64 {
    let rays: Vec<T> = shots.aimed.iter().map(|(ray, _)| T::new(ray.origin, ray.direction)).collect();
    let (mut hits, mut tests) = (0_usize, 0_usize);
    let started = Instant::now();
    for (index, ray) in rays.iter().enumerate() {
        for corners in &shots.near[index] {
            hits += usize::from(ray.intersect(*corners, f32::INFINITY).is_some());
        }
        tests += shots.near[index].len();
    }
    let seconds = started.elapsed().as_secs_f64();
    black_box(hits);
    seconds * 1e9 / tests as f64
}

fn largest(sorted: &[f64]) -> f64 {
    sorted.last().copied().unwrap_or(0.0)
}

/// In a unit.
const UNITS: f64 = 16_777_216.0;
