//! Measures preparing and tracing on one mesh.
//!
//! ```text
//! cargo run --release -p scene --example measure -- MESH.ply
//!     [--radius 1.5,0.75] [--kernels avx512,avx2,portable,rays] [--elevation 0] [--frame 0] [--size 512] [--page 16384] [--slack 0.5]
//!     [--reps 5] [--loop 5] [--threads 1] [--out PICTURE.png]
//! ```
//! Without a mesh, or with a number in its place, the built-in knot is used, of that many triangles; with a name
//! like `sphereflake:3`, that scene; what `memsavvy` takes for a volume is one, shown at
//! `--iso` by `--solver`. Rays are traced by one thread, `--threads` is for preparing. Times are best and median over the repetitions.

use core::cell::RefCell;
use core::error::Error;
use std::collections::HashSet;
use std::io::Cursor;
use std::path::Path;
use std::time::Instant;

use rt_core::camera::OrbitPlace;
use rt_core::shade::ALBEDO;
use rt_core::volume::SampleKind;
use rt_core::{
    Count, Flat, Frame, Isosurface, Kernel, Orbit, SceneMemory, SceneView, Solver, TileCounts, Tiles,
    WorkCounts, render_tile,
};
use scene::builtin::{BuiltIn, BuiltInError};
use scene::volume::{StoredType, VolumeName};
use scene::{BuildOptions, Info, Model, VolumeSource, build, builtin, read_mesh, write_volume};

fn main() -> Result<(), Box<dyn Error>> {
    let mut options = Options::from_arguments()?;
    rayon::ThreadPoolBuilder::new().num_threads(options.threads).build_global()?;
    let image = match options.volume()? {
        Some(mut source) => prepare_volume(source.as_mut(), &options)?,
        None => {
            let started = Instant::now();
            let model = options.model()?;
            println!("read       {:>8.3} s  {} primitives", started.elapsed().as_secs_f64(), model.count());
            prepare(&model, &options)?
        }
    };
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

fn prepare_volume(source: &mut dyn VolumeSource, options: &Options) -> Result<Vec<u8>, Box<dyn Error>> {
    let mut out = Cursor::new(Vec::new());
    let started = Instant::now();
    write_volume(source, None, options.stored, options.page_bytes, &mut out, &|_| {})?;
    let (seconds, samples) = (started.elapsed().as_secs_f64(), source.shape().samples() as f64);
    println!("prepare    {seconds:>8.3} s  {:.1} M samples/s", samples / seconds / 1.0e6);
    Ok(out.into_inner())
}

fn print_info(info: &Info) {
    if let Some(volume) = &info.volume {
        println!(
            "volume     {:?} samples of {:?}, {} bricks, {} ranges on {} levels; image {} bytes",
            volume.dims, volume.sample, volume.bricks, volume.branches, volume.levels, info.image_bytes
        );
        return;
    }
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
    let surfaces: Vec<Isosurface> =
        options.isovalues.iter().map(|&value| Isosurface { value, albedo: ALBEDO }).collect();
    let frame = Frame::on_orbit(&orbit, &place, options.size, options.size)?
        .with_isosurfaces(&surfaces, options.solver)?;
    let (mut whole, mut primary) = (Vec::new(), Vec::new());
    let mut work = WorkCounts::default();
    // What counts and what notes pages are one instance of the kernels, besides the one that is timed.
    let noting = SceneView::new(Noting::new(scene))?;
    let (counts, picture) = draw(&noting, &frame, kernel, &mut work);
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
    if scene.header().volume.is_some() {
        print_pages(scene, &noting.memory().touched.borrow(), &frame);
    }
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
    if work.bricks > 0 {
        println!(
            "           {:.2} bricks, {:.2} voxel cells, {:.2} cubics",
            per_ray(work.bricks),
            per_ray(work.voxel_cells),
            per_ray(work.cubics)
        );
    }
}

/// Memory that notes which pages are read.
struct Noting<'a> {
    bytes: Flat<'a>,
    page_bytes: u64,
    touched: RefCell<HashSet<u64>>,
}

impl<'a> Noting<'a> {
    fn new(scene: &SceneView<Flat<'a>>) -> Self {
        let page_bytes = u64::from(scene.header().page_bytes);
        Self { bytes: *scene.memory(), page_bytes, touched: RefCell::default() }
    }
}

impl SceneMemory for Noting<'_> {
    type Record<'b>
        = &'b [u8]
    where
        Self: 'b;

    const HOLDS_NOTHING: bool = true;

    fn record(&self, offset: u64, length: usize) -> Option<&[u8]> {
        self.touched.borrow_mut().insert(offset / self.page_bytes);
        self.bytes.record(offset, length)
    }

    fn length(&self) -> u64 {
        self.bytes.length()
    }
}

/// Prints how many pages of bricks a frame reads, and on how many any brick has samples on both sides of an isovalue.
fn print_pages(scene: &SceneView<Flat<'_>>, touched: &HashSet<u64>, frame: &Frame) {
    let Some(volume) = scene.header().volume else { return };
    let page_bytes = u64::from(scene.header().page_bytes);
    let start = scene.header().segments.bricks.offset;
    let stored: Vec<f32> = frame.isosurfaces().iter().map(|surface| volume.stored(surface.value)).collect();
    let crosses = |brick: &u64| {
        let Ok(bytes) = scene.brick(*brick) else { return false };
        let samples: Vec<f32> = match volume.sample {
            SampleKind::U8 => bytes.iter().map(|&sample| f32::from(sample)).collect(),
            SampleKind::U16 => {
                bytes.as_chunks().0.iter().map(|&s| f32::from(u16::from_le_bytes(s))).collect()
            }
            SampleKind::F32 => bytes.as_chunks().0.iter().map(|&s| f32::from_le_bytes(s)).collect(),
        };
        let both = |iso: &f32| samples.iter().any(|s| s >= iso) && samples.iter().any(|s| s < iso);
        stored.iter().any(both)
    };
    let page_of = |brick: u64| (start + volume.brick_offset(brick)) / page_bytes;
    let own: HashSet<u64> = (0..volume.bricks).filter(crosses).map(page_of).collect();
    let of_bricks = touched.iter().filter(|page| **page >= start / page_bytes);
    let (all, in_own) = (of_bricks.clone().count(), of_bricks.filter(|page| own.contains(page)).count());
    println!(
        "  pages of bricks: {all} read, {in_own} of them among the {} that the surface lies on, of {} in all; {} others read",
        own.len(),
        scene.header().segments.bricks.bytes.div_ceil(page_bytes),
        touched.len() - all
    );
}

fn draw<M: SceneMemory>(
    scene: &SceneView<M>,
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
    isovalues: Vec<f32>,
    solver: Solver,
    stored: Option<StoredType>,
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
            isovalues: Vec::new(),
            solver: Solver::default(),
            stored: None,
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
                "--iso" => {
                    options.isovalues = value()?.split(',').map(str::parse).collect::<Result<_, _>>()?;
                }
                "--solver" => options.solver = value()?.parse()?,
                "--store" => options.stored = Some(StoredType::named(&value()?).ok_or("u8, u16 or f32")?),
                "--out" => options.out = Some(value()?),
                other if other.starts_with("--") => return Err(format!("unknown option {other}").into()),
                _ => options.mesh = Some(argument),
            }
        }
        Ok(options)
    }

    fn volume(&mut self) -> Result<Option<Box<dyn VolumeSource>>, Box<dyn Error>> {
        let Some(name) = &self.mesh else { return Ok(None) };
        let Some(volume) = VolumeName::recognise(Path::new(name))? else { return Ok(None) };
        if let (VolumeName::Analytic { formula, .. }, true) = (&volume, self.isovalues.is_empty()) {
            self.isovalues = vec![formula.isovalue().to_string().parse()?];
        }
        Ok(Some(volume.open()?))
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
