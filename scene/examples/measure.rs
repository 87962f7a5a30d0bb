//! Measures preparing and tracing on one mesh.
//!
//! ```text
//! cargo run --release -p scene --example measure -- MESH.ply
//!     [--radius 1.5,0.75] [--kernels avx512,avx2,portable,rays] [--elevation 0] [--frame 0] [--size 512] [--page 16384] [--slack 0.5]
//!     [--reps 5] [--loop 5] [--threads 1] [--out PICTURE.png]
//! ```
//! Without a mesh, or with a number in its place, the built-in knot is used, of that many triangles; with a name
//! like `sphereflake:3`, that scene. Rays are traced by one thread, `--threads` is for preparing. Times are best and median over the repetitions.

use core::error::Error;
use std::path::Path;
use std::time::Instant;

use rt_core::camera::OrbitPlace;
use rt_core::{Count, Flat, Frame, Kernel, Orbit, SceneView, TileCounts, Tiles, WorkCounts, render_tile};
use scene::builtin::{BuiltIn, BuiltInError};
use scene::{BuildOptions, Info, Model, build, builtin, read_mesh};

fn main() -> Result<(), Box<dyn Error>> {
    let options = Options::from_arguments()?;
    rayon::ThreadPoolBuilder::new().num_threads(options.threads).build_global()?;
    let started = Instant::now();
    let model = options.model()?;
    println!("read       {:>8.3} s  {} primitives", started.elapsed().as_secs_f64(), model.count());
    let image = prepare(&model, &options)?;
    let scene = SceneView::new(Flat::new(&image))?;
    print_info(&Info::from(scene.header()));
    for &radius in &options.radii {
        for &kernel in &options.kernels {
            measure_rays(&scene, radius, kernel, &options)?;
        }
    }
    Ok(())
}

fn prepare(model: &Model, options: &Options) -> Result<Vec<u8>, Box<dyn Error>> {
    let mut builds = Vec::new();
    let mut writes = Vec::new();
    let mut image = Vec::new();
    for _ in 0..options.reps {
        let copy = model.clone();
        let started = Instant::now();
        let scene = build(copy, &BuildOptions { slack: options.slack }, &|_| {})?;
        builds.push(started.elapsed().as_secs_f64());
        image = scene.to_bytes(options.page_bytes)?;
        writes.push(started.elapsed().as_secs_f64());
    }
    let (build, all) = (best_and_median(&mut builds), best_and_median(&mut writes));
    let rate = model.count() as f64 / all.0 / 1.0e6;
    println!("build      {:>8.3} s  (median {:.3})", build.0, build.1);
    println!(
        "prepare    {:>8.3} s  (median {:.3})  {rate:.2} M primitives/s, {} threads",
        all.0, all.1, options.threads
    );
    Ok(image)
}

fn print_info(info: &Info) {
    let per_primitive = |bytes: u64| bytes as f64 / (info.triangles + info.spheres) as f64;
    println!(
        "image      {} bytes, {:.2} a primitive, {} pages of {}",
        info.image_bytes, info.bytes_per_primitive, info.pages, info.page_bytes
    );
    for (kind, bytes) in info.segments {
        println!("  {:<9}{bytes:>10}  {:.2} a primitive", format!("{kind}"), per_primitive(bytes));
    }
    println!(
        "grid       {} levels, {} branches, {} leaves, {} clusters of {:.1} primitives",
        info.levels, info.branches, info.leaves, info.clusters, info.primitives_per_cluster
    );
    println!(
        "           duplication {:.3}, {} primitives collapsed, {} repeated",
        info.duplication, info.collapsed, info.repeated
    );
}

fn measure_rays(
    scene: &SceneView<Flat<'_>>,
    radius: f32,
    kernel: Kernel,
    options: &Options,
) -> Result<(), Box<dyn Error>> {
    let orbit = Orbit::around(&scene.header().view);
    let place = OrbitPlace { radius, elevation: options.elevation, frame: options.frame, frames: 12 };
    let frame = Frame::on_orbit(&orbit, &place, options.size, options.size)?;
    let (mut whole, mut primary) = (Vec::new(), Vec::new());
    let mut work = WorkCounts::default();
    let (counts, picture) = draw(scene, &frame, kernel, &mut work);
    for _ in 0..options.reps_of_rays {
        let started = Instant::now();
        draw(scene, &frame, kernel, &mut ());
        whole.push(started.elapsed().as_secs_f64());
        let started = Instant::now();
        let (lit, _) = draw(scene, &Frame { flags: Frame::NO_SHADOWS, ..frame }, kernel, &mut ());
        primary.push(started.elapsed().as_secs_f64());
        assert_eq!(lit.hits, counts.hits, "both trace the same rays");
    }
    print!("{}, ", kernel);
    print_rays(radius, &counts, &work, best_and_median(&mut whole), best_and_median(&mut primary));
    if let Some(path) = &options.out {
        write_png(&picture, options.size, path)?;
    }
    Ok(())
}

fn print_rays(radius: f32, counts: &TileCounts, work: &WorkCounts, whole: (f64, f64), primary: (f64, f64)) {
    let rays = (counts.primary + counts.shadow) as f64;
    let (best, median) = whole;
    println!(
        "radius {radius}: {:.1} ms (median {:.1}), {:.2} Mrays/s total, {:.2} primary, {:.2} shadow and shading",
        best * 1.0e3,
        median * 1.0e3,
        rays / best / 1.0e6,
        counts.primary as f64 / primary.0 / 1.0e6,
        counts.shadow as f64 / (best - primary.0) / 1.0e6
    );
    println!(
        "  hits {} shadow rays {} lit {} mean t {:.7} damaged {}",
        counts.hits,
        counts.shadow,
        counts.lit,
        counts.t_sum / counts.hits as f64,
        counts.damaged
    );
    let per_ray = |count: u64| count as f64 / rays;
    println!(
        "  per ray: {:.4} branches, {:.4} leaves, {:.4} clusters, {:.2} triangles, {:.1} spheres",
        per_ray(work.branches),
        per_ray(work.leaves),
        per_ray(work.clusters),
        per_ray(work.triangles),
        per_ray(work.spheres)
    );
}

fn draw(
    scene: &SceneView<Flat<'_>>,
    frame: &Frame,
    kernel: Kernel,
    work: &mut impl Count,
) -> (TileCounts, Vec<u8>) {
    let tiles = Tiles::of(frame.width, frame.height);
    let mut picture = vec![0; frame.width as usize * frame.height as usize];
    let mut counts = TileCounts::default();
    for tile in tiles.ids().filter_map(|id| tiles.get(id)) {
        let mut pixels = vec![0; tile.pixels()];
        counts += render_tile(scene, frame, tile, kernel, &mut pixels, work);
        for (y, row) in (tile.y..).zip(pixels.chunks(tile.width as usize)) {
            let start = y as usize * frame.width as usize + tile.x as usize;
            picture[start..start + row.len()].copy_from_slice(row);
        }
    }
    (counts, picture)
}

fn write_png(picture: &[u8], size: u32, path: &str) -> Result<(), Box<dyn Error>> {
    let mut encoder = png::Encoder::new(std::fs::File::create(path)?, size, size);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.write_header()?.write_image_data(picture)?;
    Ok(())
}

fn best_and_median(times: &mut [f64]) -> (f64, f64) {
    times.sort_by(f64::total_cmp);
    (times[0], times[times.len() / 2])
}

struct Options {
    mesh: Option<String>,
    radii: Vec<f32>,
    kernels: Vec<Kernel>,
    elevation: f64,
    frame: u32,
    size: u32,
    page_bytes: u32,
    slack: f32,
    reps: usize,
    reps_of_rays: usize,
    threads: usize,
    out: Option<String>,
}

impl Options {
    fn from_arguments() -> Result<Self, Box<dyn Error>> {
        let mut options = Self {
            mesh: None,
            radii: vec![1.5, 0.75],
            kernels: vec![Kernel::fastest(), Kernel::rays()],
            elevation: 0.0,
            frame: 0,
            size: 512,
            page_bytes: 16 << 10,
            slack: BuildOptions::default().slack,
            reps: 5,
            reps_of_rays: 5,
            threads: 0,
            out: None,
        };
        let mut arguments = std::env::args().skip(1);
        while let Some(argument) = arguments.next() {
            let mut value = || arguments.next().ok_or_else(|| format!("{argument} needs a value"));
            match argument.as_str() {
                "--radius" => {
                    options.radii = value()?.split(',').map(str::parse).collect::<Result<_, _>>()?
                }
                "--kernels" => {
                    options.kernels = value()?.split(',').map(str::parse).collect::<Result<_, _>>()?;
                }
                "--elevation" => options.elevation = value()?.parse()?,
                "--frame" => options.frame = value()?.parse()?,
                "--size" => options.size = value()?.parse()?,
                "--page" => options.page_bytes = value()?.parse()?,
                "--slack" => options.slack = value()?.parse()?,
                "--loop" => options.reps_of_rays = value()?.parse::<usize>()?.max(1),
                "--reps" => options.reps = value()?.parse::<usize>()?.max(1),
                "--threads" => options.threads = value()?.parse()?,
                "--out" => options.out = Some(value()?),
                other if other.starts_with("--") => return Err(format!("unknown option {other}").into()),
                _ => options.mesh = Some(argument),
            }
        }
        Ok(options)
    }

    fn model(&self) -> Result<Model, Box<dyn Error>> {
        let Some(name) = &self.mesh else { return Ok(builtin::knot(500_000).into()) };
        if let Ok(triangles) = name.parse() {
            return Ok(builtin::knot(triangles).into());
        }
        match name.parse::<BuiltIn>() {
            Ok(built_in) => Ok(built_in.model()),
            Err(BuiltInError::Unknown) => Ok(read_mesh(Path::new(name))?.into()),
            Err(error) => Err(error.into()),
        }
    }
}
