//! Packets of 16 rays against the same rays one by one: rays from the eye, 4x4 pixels a packet, and rays that have
//! nothing in common.
//!
//! ```text
//! cargo run --release -p rt-core --example packets -- [MESH.ply] [--size 512] [--loop 7]
//! ```
//! Both find the same hits to the bit, which is checked first. Times alternate, and medians are printed.

use core::error::Error;
use std::path::Path;
use std::time::Instant;

use rt_core::camera::OrbitPlace;
use rt_core::{Flat, Frame, Hit, Hits16, Lanes, Orbit, Packet16, Primitive, Ray, SceneView, WorkCounts};
use scene::{Mesh, build, builtin, read_mesh};

fn main() -> Result<(), Box<dyn Error>> {
    let (mesh, size, reps) = arguments()?;
    let image = build(mesh, &Default::default(), &|_| {})?.to_bytes(16 << 10)?;
    let scene = SceneView::new(Flat::new(&image))?;
    let kinds = [("primary, 4x4 pixels", primary(&scene, size)?), ("random", random(&scene, size))];
    for lanes in Lanes::available() {
        let scene = scene.with_lanes(lanes);
        for (name, rays) in &kinds {
            compare(&scene, &format!("{lanes}, {name}"), rays, reps)?;
        }
    }
    Ok(())
}

/// Checks that packets find what rays find, then times both.
fn compare(scene: &SceneView<Flat<'_>>, name: &str, rays: &[Ray], reps: usize) -> Result<(), Box<dyn Error>> {
    let packets: Vec<(Packet16, u16)> = rays.chunks(16).map(Packet16::pack).collect();
    let (mut of_rays, mut of_packets) = (WorkCounts::default(), WorkCounts::default());
    for ((packet, active), rays) in packets.iter().zip(rays.chunks(16)) {
        let hits = scene.nearest16(packet, *active, &mut of_packets)?;
        for (lane, ray) in rays.iter().enumerate() {
            let (together, alone) = (hits.hit(lane), scene.nearest(ray, &mut of_rays)?);
            assert_eq!(named(scene, together), named(scene, alone), "{ray:?}");
        }
    }
    let (mut alone, mut together) = (Vec::new(), Vec::new());
    for _ in 0..reps {
        let started = Instant::now();
        let sum = rays.iter().try_fold(0.0, |sum, ray| {
            Ok::<_, rt_core::Damaged>(sum + scene.nearest(ray, &mut ())?.map_or(0.0, |hit| hit.t))
        })?;
        alone.push(started.elapsed().as_secs_f64());
        let started = Instant::now();
        for (packet, active) in &packets {
            core::hint::black_box::<Hits16>(scene.nearest16(packet, *active, &mut ())?);
        }
        together.push(started.elapsed().as_secs_f64());
        core::hint::black_box(sum);
    }
    let (alone, together) = (median(alone), median(together));
    let rate = |seconds: f64| rays.len() as f64 / seconds / 1.0e6;
    println!(
        "{name}: {:.2} Mrays/s one by one, {:.2} in packets, ratio {:.2}",
        rate(alone),
        rate(together),
        alone / together
    );
    print_counts("one by one", &of_rays, rays.len());
    print_counts("packets   ", &of_packets, rays.len());
    Ok(())
}

/// A hit, and the number of what was hit: of what is stored in several cells, any place may be found.
fn named(scene: &SceneView<Flat<'_>>, hit: Option<Hit>) -> Option<(Hit, Option<u32>)> {
    hit.map(|hit| (Hit { primitive: Primitive(0), ..hit }, scene.original_id(hit.primitive)))
}

fn print_counts(name: &str, work: &WorkCounts, rays: usize) {
    let per_ray = |count: u64| count as f64 / rays as f64;
    println!(
        "  {name} {:.3} branches, {:.3} leaves, {:.3} clusters, {:.2} triangles read a ray",
        per_ray(work.branches),
        per_ray(work.leaves),
        per_ray(work.clusters),
        per_ray(work.triangles)
    );
}

/// Rays from the eye, block of 4x4 pixels after block.
fn primary(scene: &SceneView<Flat<'_>>, size: u32) -> Result<Vec<Ray>, Box<dyn Error>> {
    let orbit = Orbit::around(&scene.header().view);
    let place = OrbitPlace { radius: 0.75, elevation: 20.0, frame: 0, frames: 12 };
    let camera = Frame::on_orbit(&orbit, &place, size, size)?.camera;
    let mut rays = Vec::new();
    for block in 0..(size / 4) * (size / 4) {
        let (x, y) = (block % (size / 4) * 4, block / (size / 4) * 4);
        for pixel in 0..16 {
            let direction = camera.direction(camera.row(y + pixel / 4), x + pixel % 4);
            rays.push(Ray { origin: camera.eye, direction, t_max: f32::INFINITY });
        }
    }
    Ok(rays)
}

/// As many rays with random origins in the scene's box and random directions.
fn random(scene: &SceneView<Flat<'_>>, size: u32) -> Vec<Ray> {
    let bounds = scene.header().bounds;
    let mut state = 1_u32;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        f32::from(u16::try_from(state >> 16).unwrap_or(0)) / 65_536.0
    };
    let mut vector = || [next(), next(), next()];
    let ray = |_| {
        let origin = bounds.low + (bounds.high - bounds.low) * glam::Vec3::from(vector());
        let direction = glam::Vec3::from(vector()) - 0.5;
        Ray { origin, direction, t_max: f32::INFINITY }
    };
    (0..size * size).map(ray).collect()
}

fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn arguments() -> Result<(Mesh, u32, usize), Box<dyn Error>> {
    let (mut mesh, mut size, mut reps) = (None, 512, 7);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or_else(|| format!("{argument} needs a value"));
        match argument.as_str() {
            "--size" => size = value()?.parse()?,
            "--loop" => reps = value()?.parse::<usize>()?.max(1),
            _ => mesh = Some(read_mesh(Path::new(&argument))?),
        }
    }
    Ok((mesh.unwrap_or_else(|| builtin::knot(200_000)), size, reps))
}
