//! `memsavvy render`, `prepare`, `info`, `session`, `trace`: flags, help, errors.

mod values;

use core::num::NonZeroU16;
use core::time::Duration;
use std::ffi::OsString;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::builder::styling::{AnsiColor, Styles};
use clap::{Args, Parser, Subcommand};
use dsm_core::replacement::{PolicyKind, ReferenceSource};
use rt_core::schedule::Balancer;
use rt_core::{Solver, TriangleTestKind};
use scene::builtin::BuiltIn;
use scene::volume::StoredType;
use scene::{Info, SceneFile};

use crate::control::{BindTo, Prefetch, TransportKind};
use crate::describe::{describe, describe_histogram, describe_session, describe_trace};
use crate::diagnostic::Diagnostic;
use crate::output::{Destination, check_folder_of, write_whole};
use crate::report::{RunReport, counted};
use crate::run::{HIDDEN_PER_CENT, Kill, Options, Source, Surface, run};
use crate::scene_source::Written;
use crate::session::{Path, Replay, Session, Sweep, Way};
use crate::size::{Bytes, Memory, PictureSize};
use crate::trace::{self, Trace};
use values::{Backend, ChosenKernel, backend, kernel, page_bytes, seconds, stored_type};

/// Renders scenes larger than one machine's memory.
///
/// The scene lies in one address range; each node owns some pages and caches others. A render thread just reads, and a
/// page fault fetches what is absent from its owner, in that very thread.
#[derive(Debug, Parser)]
#[command(name = "memsavvy", version, styles = STYLES, after_help = "\
Without a subcommand: renders a built-in scene of 600,000 triangles on four local nodes, none of which may hold more
than 40 % of it, and writes memsavvy.png.

Examples:
  memsavvy
  memsavvy render dragon.ply -o dragon.png
  memsavvy prepare dragon.ply -o dragon.msv
  memsavvy info dragon.msv")]
struct CommandLine {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    Render(Box<Render>),
    Prepare(Prepare),
    Info(ShowInfo),
    Session(MakeSession),
    Trace(RecordTrace),
}

/// Renders a mesh, a volume, a scene image or a built-in scene on a cluster of local processes
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  memsavvy render bunny.ply -o bunny.png
  memsavvy render sphereflake:3 -o flake.png --radius 0.75 --elevation 20
  memsavvy render scan.nrrd --iso 80.5 -o scan.png
  memsavvy render gyroid:256 --iso 0,0.5@0.3 --radius 0.75 -o gyroid.png
  memsavvy render dragon.msv -o orbit-%03d.png --frames 36 --radius 0.75
  memsavvy render dragon.msv -o walk-%03d.png --session walk.jsonl
  memsavvy render dragon.msv --nodes 2 --stores 2 --memory 16% --report run.json
  memsavvy render dragon.msv -o out.png --diagnostic tile-owner,page-owner,misses,cost
  memsavvy render dragon.msv --nodes 4 --memory 5M --page 4K --backend segv --replacement fifo")]
struct Render {
    /// A mesh (PLY, OBJ), a volume (NRRD, NIfTI, VTI, raw:FILE?dims=XxYxZ&type=u8), a scene image made by `memsavvy
    /// prepare`, or what is built in: knot:TRIANGLES, sphereflake:DEPTH, gyroid:SAMPLES or ml:SAMPLES
    scene: PathBuf,
    #[command(flatten)]
    output: Output,
    #[command(flatten)]
    cluster: Cluster,
    #[command(flatten)]
    view: View,
    /// Which moments of the session are drawn: frames, every one, as fast as can be; or time, those whose time has come
    #[arg(long, value_name = "HOW", value_enum, default_value_t = Replay::Frames, help_heading = "View")]
    replay: Replay,
}

/// Where results go.
#[derive(Debug, Args)]
struct Output {
    /// The picture to write, PNG: the last frame, or each with a pattern like out-%03d.png
    #[arg(short, long, value_name = "FILE")]
    output: Option<String>,
    /// Write pictures of what happens beside each picture, out.misses.png beside out.png and so on, and with several all
    /// side by side in out.diagnostic.png. page-owner traces a ray more for each pixel, whose misses are not counted but
    /// change what is in the caches
    #[arg(long, value_name = "KIND,...", value_enum, value_delimiter = ',', requires = "output")]
    diagnostic: Vec<Diagnostic>,
    /// Write the run report as JSON
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Print nothing but errors and warnings
    #[arg(short, long)]
    quiet: bool,
}

/// Who renders, and what each may hold.
#[derive(Debug, Args)]
#[command(next_help_heading = "Cluster")]
struct Cluster {
    /// Processes that render
    #[arg(long, value_name = "N", default_value_t = 4)]
    nodes: u16,
    /// Further processes that hold all pages and render nothing; then a node's whole memory is cache
    #[arg(long, value_name = "M", default_value_t = 0)]
    stores: u16,
    /// Copies of each page, on as many owners: with 2, any owner and any node may die and the picture is the same
    #[arg(long, value_name = "K", default_value_t = 1)]
    replicas: u8,
    /// Render threads of each node [default: cores / nodes, at least 1]
    #[arg(long, value_name = "T")]
    threads: Option<NonZeroU16>,
    /// Where render threads run: each on a core of its own, or wherever the system puts them
    /// [default: core, if there are enough]
    #[arg(long, value_name = "WHERE", value_enum)]
    bind_to: Option<BindTo>,
    /// What one node may hold, home pages and cache together: a share of the image or a size, as in 40% or 64M
    /// [default: its home pages and 15 % besides]
    #[arg(long, value_name = "SIZE")]
    memory: Option<Memory>,
    /// Page size: a power of two from 4K to 2M [default: 16K, or what the image was prepared for]
    #[arg(long, value_name = "SIZE", value_parser = page_bytes)]
    page: Option<u32>,
    /// How pages appear: auto, uffd, segv, soft or replicated
    #[arg(long, value_name = "NAME", default_value = "auto", value_parser = backend)]
    backend: Backend,
    /// Which page leaves for another: random, fifo, clock, sieve, s3-fifo or recall
    #[arg(long, value_name = "NAME", default_value_t = PolicyKind::Recall)]
    replacement: PolicyKind,
    /// How it learns which pages are used: hints, at the end of each tile; soft-faults, by hiding pages before they
    /// leave; or none
    #[arg(long, value_name = "NAME", default_value_t = ReferenceSource::Hints)]
    reference: ReferenceSource,
    /// With soft-faults, how many per cent of the slots hold hidden pages
    #[arg(long, value_name = "PERCENT", default_value_t = HIDDEN_PER_CENT, value_parser = clap::value_parser!(u32).range(1..=90))]
    hidden: u32,
    /// Which pages come before they are touched: with hints, those that a tile used in the last frame; those that follow a
    /// missed one; both; or none. Either turns itself off where it does not pay
    #[arg(long, value_name = "WHICH", value_enum, default_value_t = Prefetch::Tiles)]
    prefetch: Prefetch,
    /// How tiles are drawn: auto, avx512, avx2, portable (beams with these instructions), rays, or rays-avx2 and so on; all draw the same
    #[arg(long, value_name = "NAME", default_value = "auto", value_parser = kernel)]
    kernel: ChosenKernel,
    /// How triangles are tested: woop, watertight, or moller, for comparison; that one draws ray by ray
    #[arg(long, value_name = "NAME", default_value_t = TriangleTestKind::default())]
    triangle_test: TriangleTestKind,
    /// How pages travel between the processes
    #[arg(long, value_name = "NAME", value_enum, default_value_t = TransportKind::Shm)]
    transport: TransportKind,
    /// How tiles come to nodes: static, demand (from a central queue; demand:K sends K tiles ahead), steal (from a random node,
    /// one at a time) or steal-near (half of what is too much, from and to nodes that use the same pages)
    #[arg(long, value_name = "NAME", default_value_t = Balancer::StealNear)]
    balance: Balancer,
    /// Threads of this process that put the pictures together, each its rows of tiles
    #[arg(long, value_name = "K", default_value_t = 1)]
    displays: u16,
    /// Seconds after which a fault that nobody serves, or a process that says nothing, ends the run
    #[arg(long, value_name = "SECONDS", default_value = "5", value_parser = seconds)]
    deadline: Duration,
    /// Lose this many of a thousand messages, for tests
    #[arg(long, value_name = "N", default_value_t = 0, hide = true, value_parser = clap::value_parser!(u32).range(0..1000))]
    lose: u32,
    /// Kill this process once so many tiles of this frame are there, or at the start, for tests
    #[arg(long, value_name = "PROCESS@FRAME:TILES|start", hide = true)]
    kill: Vec<Kill>,
    /// Makes what is random repeatable
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
}

/// What is looked at.
#[derive(Debug, Args)]
#[command(next_help_heading = "View")]
struct View {
    /// Picture size in pixels
    #[arg(long, value_name = "WxH", default_value = "512x512")]
    size: PictureSize,
    /// Replay this session, one made by `memsavvy session` or recorded
    #[arg(long, value_name = "FILE", conflicts_with_all = ["path", "frames", "circle", "radius", "elevation"])]
    session: Option<PathBuf>,
    /// The way that the eye goes where there is no session; see `memsavvy session --help`
    #[arg(long, value_name = "WAY", value_enum, default_value_t = Way::Orbit)]
    path: Way,
    #[command(flatten)]
    eye: Eye,
    /// Isosurfaces of a volume, where the session has none: values, or auto for one that the histogram suggests; with a
    /// grey from 0 to 1 as in 80.5@0.4 [default: auto]
    #[arg(long, value_name = "VALUE[@GREY],...", value_delimiter = ',', allow_negative_numbers = true)]
    iso: Vec<Surface>,
    /// How isosurfaces are found in a voxel cell: marmitt+newton, marmitt, neubauer, linear or bisect
    #[arg(long, value_name = "NAME", default_value_t = Solver::default())]
    solver: Solver,
}

/// Where the eye is, frame by frame.
#[derive(Debug, Args)]
struct Eye {
    /// Frames; more than one make an orbit, or the way that was asked for
    #[arg(long, value_name = "F", default_value_t = 1)]
    frames: u32,
    /// Frames that a full circle would take: how fast the eye moves [default: as many as there are frames]
    #[arg(long, value_name = "F", value_parser = clap::value_parser!(u32).range(1..))]
    circle: Option<u32>,
    /// Distance of the eye from the middle of the scene, in diagonals of the scene
    #[arg(long, value_name = "R", default_value_t = 1.5)]
    radius: f64,
    /// Height of the eye, in degrees above the horizon
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, allow_negative_numbers = true)]
    elevation: f64,
}

/// Makes a session: where the eye and the light are and which isosurface is shown, moment by moment
///
/// A session fits any scene: its points are offsets from the scene's centre in diagonals of the scene. With frame i of F,
/// radius R, elevation e and a = 360 i / CIRCLE degrees, the eye is at R (sin a cos e, sin e, cos a cos e) and looks at
/// the centre. A walk has radius R (1 - 2/3 i/F); a jump goes to the other side in the middle of the session; a still
/// view has a = 0; a volume is seen from 0.3 R in the second half. Moment i is at i / RATE seconds.
///
/// The file is a line of JSON for each moment, to be written by other programs too. The documentation of the crate's module
/// `session` has the format.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  memsavvy session orbit -o orbit.jsonl --frames 90 --circle 180 --radius 0.75
  memsavvy session walk -o walk.jsonl --frames 60 --elevation 20
  memsavvy session volume -o scan.jsonl --frames 200 --iso 40..120
  memsavvy render dragon.msv --session walk.jsonl --replay time --report run.json")]
struct MakeSession {
    /// The way that the eye goes
    #[arg(value_enum)]
    way: Way,
    /// The session to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    eye: Eye,
    /// Frames a second, for replays by time
    #[arg(long, value_name = "RATE", default_value_t = 25.0)]
    rate: f64,
    /// The isovalue: of the first frame, and of the middle one and all after it; or one for all
    #[arg(long, value_name = "FROM..TO", allow_hyphen_values = true)]
    iso: Option<Sweep>,
    /// Print nothing but errors
    #[arg(short, long)]
    quiet: bool,
}

/// Prepares a mesh, a volume or a built-in scene: writes a scene image
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  memsavvy prepare dragon.ply -o dragon.msv
  memsavvy prepare scan.obj -o scan.msv --page 64K
  memsavvy prepare scan.nrrd -o scan.msv --store u8
  memsavvy prepare knot:5000000 -o knot.msv
  memsavvy prepare sphereflake:6 -o flake.msv")]
struct Prepare {
    /// A mesh, PLY (ascii or binary) or OBJ, a volume (NRRD, NIfTI, VTI, raw:FILE?dims=XxYxZ&type=u8), or what is built
    /// in: knot:TRIANGLES, sphereflake:DEPTH, gyroid:SAMPLES or ml:SAMPLES
    #[arg(required_unless_present = "builtin")]
    mesh: Option<PathBuf>,
    /// The scene image to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// The smallest page that the image may be used with; a power of two from 4K to 2M
    #[arg(long, value_name = "SIZE", default_value = "16K", value_parser = page_bytes)]
    page: u32,
    /// What a sample of a volume is stored as: u8, u16 or f32 [default: the smallest that loses nothing]
    #[arg(long, value_name = "TYPE", value_parser = stored_type)]
    store: Option<StoredType>,
    /// A mesh that stands in the volume, in the same units
    #[arg(long, value_name = "MESH")]
    with: Option<PathBuf>,
    /// Short for knot:TRIANGLES
    #[arg(long, value_name = "TRIANGLES", conflicts_with = "mesh")]
    builtin: Option<usize>,
    /// Print nothing but errors
    #[arg(short, long)]
    quiet: bool,
}

/// Shows what is in a scene image, a session or a page trace
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  memsavvy info dragon.msv
  memsavvy info dragon.trace")]
struct ShowInfo {
    /// A scene image made by `memsavvy prepare`, a session made by `memsavvy session`, or a trace made by `memsavvy trace`
    file: PathBuf,
}

/// Records which pages each tile of a session touches, to compare replacement policies on
///
/// The frames are drawn by this process alone, tile by tile as the nodes of a run would, with the whole image in memory.
/// `cargo run --release -p bench -- replacement` compares policies on traces.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  memsavvy trace dragon.ply -o dragon.trace
  memsavvy trace dragon.msv -o walk.trace --path walk --frames 24 --circle 180 --radius 0.75
  memsavvy trace scan.msv -o scan.trace --session scan.jsonl
  memsavvy trace knot:600000 -o knot.trace --nodes 4 --page 4K
  memsavvy info knot.trace")]
struct RecordTrace {
    /// What `memsavvy render` takes
    scene: PathBuf,
    /// The trace to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Nodes that the tiles are dealt to, as in a run
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u16).range(1..=64))]
    nodes: u16,
    /// Page size: a power of two from 4K to 2M [default: 16K, or what the image was prepared for]
    #[arg(long, value_name = "SIZE", value_parser = page_bytes)]
    page: Option<u32>,
    /// How tiles are drawn, as for `render`; beams read other records than rays do
    #[arg(long, value_name = "NAME", default_value = "auto", value_parser = kernel)]
    kernel: ChosenKernel,
    #[command(flatten)]
    view: View,
    /// Print nothing but errors
    #[arg(short, long)]
    quiet: bool,
}

const STYLES: Styles = Styles::styled()
    .header(AnsiColor::Green.on_default().bold())
    .usage(AnsiColor::Green.on_default().bold())
    .literal(AnsiColor::Cyan.on_default().bold())
    .placeholder(AnsiColor::Cyan.on_default());

/// Runs the command line of this process. What goes wrong is told in one line.
#[must_use]
pub fn main() -> ExitCode {
    if let Some(code) = crate::run_as_node_if_asked() {
        return code;
    }
    let typed: Vec<OsString> = std::env::args_os().collect();
    let command = typed.iter().map(|word| word.to_string_lossy().into_owned()).collect();
    match CommandLine::parse_from(typed).run(command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {}", one_line(&format!("{error:#}")));
            ExitCode::FAILURE
        }
    }
}

impl CommandLine {
    fn run(self, command: Vec<String>) -> Result<()> {
        match self.command {
            None => render_built_in(command),
            Some(Command::Render(render)) => render.run(command),
            Some(Command::Prepare(prepare)) => prepare.run(),
            Some(Command::Info(info)) => info.run(),
            Some(Command::Session(session)) => session.run(),
            Some(Command::Trace(trace)) => trace.run(),
        }
    }
}

/// The main job: the built-in scene on four nodes, each allowed 40 % of it.
fn render_built_in(command: Vec<String>) -> Result<()> {
    let session = Path { frames: 8, radius: 1.05, ..Path::default() }.session()?;
    let options = Options { memory: Some(Memory::Share(0.4)), session, command, ..Options::default() };
    let report = render(&options, Some("memsavvy.png"))?;
    print(&format!("{report}\nwrote memsavvy.png"))
}

impl Render {
    fn run(self, command: Vec<String>) -> Result<()> {
        let Self { scene, output, cluster, view, replay } = self;
        let session = view.session()?;
        let options = Options {
            source: Source::named(&scene)?,
            nodes: cluster.nodes,
            stores: cluster.stores,
            threads: cluster.threads,
            bind_to: cluster.bind_to,
            memory: cluster.memory,
            page_bytes: cluster.page,
            backend: cluster.backend.0,
            policy: cluster.replacement,
            reference: cluster.reference,
            hidden_per_cent: cluster.hidden,
            prefetch: cluster.prefetch,
            kernel: cluster.kernel.0,
            transport: cluster.transport,
            balance: cluster.balance,
            displays: cluster.displays,
            size: view.size,
            session,
            replay,
            isosurfaces: view.iso,
            solver: view.solver,
            triangle_test: cluster.triangle_test,
            deadline: cluster.deadline,
            lose_per_mille: cluster.lose,
            replicas: cluster.replicas,
            kills: cluster.kill,
            diagnostics: output.diagnostic.clone(),
            seed: cluster.seed,
            quiet: output.quiet,
            command,
        };
        output.report.as_deref().map_or(Ok(()), check_folder_of)?;
        let report = render(&options, output.output.as_deref())?;
        for loss in &report.losses {
            eprintln!("warning: {loss}");
        }
        if let Some(path) = &output.report {
            write_whole(path, |file| Ok(serde_json::to_writer_pretty(file, &report)?))?;
        }
        if output.quiet { Ok(()) } else { print(&report.to_string()) }
    }
}

/// Runs and writes the pictures.
fn render(options: &Options, output: Option<&str>) -> Result<RunReport> {
    let destination = output.map(Destination::parse).transpose()?;
    let moments = options.session.count();
    let last = destination.as_ref().and_then(|destination| destination.path(moments - 1, moments));
    last.map_or(Ok(()), |path| check_folder_of(&path))?;
    run(options, |shown| {
        let path = destination.as_ref().and_then(|destination| destination.path(shown.moment, moments));
        path.map_or(Ok(()), |path| shown.write(&path))
    })
}

impl View {
    /// The session that was asked for.
    fn session(&self) -> Result<Session> {
        match &self.session {
            Some(file) => Session::read(file),
            None => self.eye.path(self.path).session(),
        }
    }
}

impl Eye {
    fn path(&self, way: Way) -> Path {
        let Self { frames, circle, radius, elevation } = *self;
        Path { way, frames, circle, radius, elevation, ..Path::default() }
    }
}

impl MakeSession {
    fn run(self) -> Result<()> {
        check_folder_of(&self.output)?;
        let path = Path { rate: self.rate, isovalues: self.iso, ..self.eye.path(self.way) };
        let session = path.session()?;
        write_whole(&self.output, |file| Ok(session.write(file)?))?;
        if self.quiet {
            return Ok(());
        }
        print(&format!("{}\nwrote {}", describe_session(&session), self.output.display()))
    }
}

impl Prepare {
    fn run(self) -> Result<()> {
        check_folder_of(&self.output)?;
        let source = match (&self.mesh, self.builtin) {
            (_, Some(triangles)) => Source::BuiltIn(BuiltIn::Knot { triangles }),
            (Some(path), None) => Source::named(path)?,
            (None, None) => bail!("no mesh was given"),
        };
        if source.is_image()? {
            bail!("{} is a scene image already", self.mesh.unwrap_or_default().display());
        }
        let source = self.with_volume_options(source)?;
        let start = std::time::Instant::now();
        let Written { header, notes, .. } =
            write_whole(&self.output, |file| source.write(self.page, file, self.quiet))?;
        if self.quiet {
            return Ok(());
        }
        let info = Info::from(&header);
        let notes: String = notes.iter().map(|note| format!("\nnote: {note}")).collect();
        print(&format!(
            "{}: {}, {}; prepared in {:.2} s{notes}",
            self.output.display(),
            counted(info.triangles, info.spheres, info.volume.map(|volume| volume.dims)),
            Bytes(info.image_bytes),
            start.elapsed().as_secs_f64(),
        ))
    }

    /// Adds what was asked for a volume.
    fn with_volume_options(&self, mut source: Source) -> Result<Source> {
        match &mut source {
            Source::Volume(volume) => (volume.stored, volume.with) = (self.store, self.with.clone()),
            _ if self.store.is_some() || self.with.is_some() => bail!("--store and --with are for volumes"),
            _ => {}
        }
        Ok(source)
    }
}

impl ShowInfo {
    fn run(&self) -> Result<()> {
        let name = self.file.display();
        if Trace::is_one(&self.file).with_context(|| format!("cannot read {name}"))? {
            let trace = Trace::read(&self.file).with_context(|| format!("cannot use {name}"))?;
            return print(&describe_trace(&trace));
        }
        if Session::is_one(&self.file).with_context(|| format!("cannot read {name}"))? {
            return print(&describe_session(&Session::read(&self.file)?));
        }
        if !SceneFile::is_one(&self.file).with_context(|| format!("cannot read {name}"))? {
            bail!(
                "{name} is no scene image, no session and no trace; make an image with `memsavvy prepare {name} -o scene.msv`"
            );
        }
        let mut file = SceneFile::open(&self.file).with_context(|| format!("cannot use {name}"))?;
        let histogram = file.histogram()?.map(|histogram| describe_histogram(&histogram));
        print(&[describe(&file.info()), histogram.unwrap_or_default()].join("\n"))
    }
}

impl RecordTrace {
    fn run(self) -> Result<()> {
        check_folder_of(&self.output)?;
        let view = self.view;
        let options = trace::Options {
            source: Source::named(&self.scene)?,
            page_bytes: self.page,
            nodes: self.nodes,
            kernel: self.kernel.0,
            session: view.session()?,
            size: view.size,
            isosurfaces: view.iso,
            solver: view.solver,
            quiet: self.quiet,
        };
        let trace = trace::record(&options)?;
        write_whole(&self.output, |file| Ok(trace.write(file)?))?;
        if self.quiet {
            return Ok(());
        }
        print(&format!("{}\nwrote {}", describe_trace(&trace), self.output.display()))
    }
}

/// Prints to standard output. That nobody reads it any more, as with `| head`, is no error.
fn print(text: &str) -> Result<()> {
    match writeln!(std::io::stdout(), "{text}") {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => Ok(other?),
    }
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
