//! A whole run: plan, start, frames, report.

use core::num::NonZeroU16;
use core::time::Duration;
use std::ffi::{OsStr, OsString};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::thread::{self, available_parallelism};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, bail};
use dsm_core::replacement::{PolicyKind, ReferenceSource};
use fault_linux::BackendKind;
use rt_core::schedule::ledger::{DealtNode, DealtTile, LedgerConfig};
use rt_core::schedule::{Balancer, Ledger, LedgerStorage};
use rt_core::{Frame, Header, HeaderError, Isosurface, Kernel, SceneNeeds, Solver, Tiles, TriangleTestKind};
use scene::builtin::BuiltIn;
use transport_shm::{Inbox, Layout, PageFile};

pub use crate::control::{BindTo, Prefetch, TransportKind};
pub use crate::isovalue::{Isovalue, Surface};
pub use crate::loss::{Kill, Loss, Moment};
pub use crate::picture::Picture;
pub use crate::scene_source::{Source, VolumeInput};

use crate::balance::{self, RESEND_US};
use crate::control::{Files, SetUp};
use crate::diagnostic::{Diagnostic, FrameFacts, Wants, sheet_of, sheet_of_all};
use crate::gather::{DISPLAYS_MAX, Gathered};
use crate::isovalue::Surfaces;
use crate::plan::{Demand, Plan};
use crate::ports::EPOCH;
use crate::progress::FrameBar;
use crate::report::{FrameReport, RunReport, SceneReport, Totals};
use crate::scene_source::Image;
use crate::session::{Replay, Session, Step};
use crate::size::{Memory, PictureSize};
use crate::supervisor::{Drawing, Supervisor};

/// What to render, and on what.
#[derive(Clone, Debug)]
pub struct Options {
    /// What is rendered.
    pub source: Source,
    /// Processes that render.
    pub nodes: u16,
    /// Processes that hold pages and render nothing.
    pub stores: u16,
    /// Render threads of each node; `None`: the processor's cores, divided by the nodes.
    pub threads: Option<NonZeroU16>,
    /// Where render threads run; `None`: each on a core of its own, if there are enough.
    pub bind_to: Option<BindTo>,
    /// What one node may hold; `None`: its home pages and 15 % of the image besides.
    pub memory: Option<Memory>,
    /// Length of a page; `None`: what the image was prepared for.
    pub page_bytes: Option<u32>,
    /// How pages appear; `None`: the best way that the system does not refuse.
    pub backend: Option<BackendKind>,
    /// Which page leaves.
    pub policy: PolicyKind,
    /// How it learns which pages are used.
    pub reference: ReferenceSource,
    /// How many per cent of its slots hold hidden pages, where soft faults are the source.
    pub hidden_per_cent: u32,
    /// Which pages come before they are touched.
    pub prefetch: Prefetch,
    /// How tiles are drawn; `None`: by the fastest kernel that the node's processor has.
    pub kernel: Option<Kernel>,
    /// How pages travel.
    pub transport: TransportKind,
    /// How tiles come to nodes.
    pub balance: Balancer,
    /// Threads that put pictures together, each a part of them.
    pub displays: u16,
    /// The picture's size.
    pub size: PictureSize,
    /// What is looked at, moment by moment.
    pub session: Session,
    /// Which of its moments are drawn.
    pub replay: Replay,
    /// Isosurfaces of a volume, where the session does not say; none: one, at [`Isovalue::Auto`].
    pub isosurfaces: Vec<Surface>,
    /// How their roots are found.
    pub solver: Solver,
    /// How triangles are tested.
    pub triangle_test: TriangleTestKind,
    /// A fault that is not served, or a process that says nothing, for this long ends the run.
    pub deadline: Duration,
    /// Messages that are lost on purpose, in a thousand.
    pub lose_per_mille: u32,
    /// Copies of each page, on as many owners. With two or more, processes may die and the others go on.
    pub replicas: u8,
    /// Pictures of what happens that are to be had of each frame.
    pub diagnostics: Vec<Diagnostic>,
    /// Processes that are killed on purpose.
    pub kills: Vec<Kill>,
    /// Makes everything that is random repeatable.
    pub seed: u64,
    /// No progress bars.
    pub quiet: bool,
    /// What was typed, for the report.
    pub command: Vec<String>,
}

impl Default for Options {
    /// The built-in scene on four nodes, one frame.
    fn default() -> Self {
        Self {
            source: Source::BuiltIn(BuiltIn::Knot { triangles: 600_000 }),
            nodes: 4,
            stores: 0,
            threads: None,
            bind_to: None,
            memory: None,
            page_bytes: None,
            backend: None,
            policy: PolicyKind::Recall,
            reference: ReferenceSource::Hints,
            hidden_per_cent: HIDDEN_PER_CENT,
            prefetch: Prefetch::Tiles,
            kernel: None,
            transport: TransportKind::Shm,
            balance: Balancer::StealNear,
            displays: 1,
            size: PictureSize { width: 512, height: 512 },
            session: Session::default(),
            replay: Replay::Frames,
            isosurfaces: Vec::new(),
            solver: Solver::default(),
            triangle_test: TriangleTestKind::default(),
            deadline: Duration::from_secs(5),
            lose_per_mille: 0,
            replicas: 1,
            diagnostics: Vec::new(),
            kills: Vec::new(),
            seed: 1,
            quiet: false,
            command: Vec::new(),
        }
    }
}

/// A frame that was drawn, as soon as it is whole.
#[derive(Debug)]
pub struct Shown<'a> {
    /// The moment of the session that it shows.
    pub moment: u32,
    /// The frame.
    pub picture: &'a Picture,
    facts: Option<&'a FrameFacts>,
    diagnostics: &'a [Diagnostic],
}

/// Replays the session and hands over each frame.
///
/// The calling program must begin with [`run_as_node_if_asked`](crate::run_as_node_if_asked).
///
/// # Errors
/// The options contradict themselves or the scene; the scene cannot be used; a process of the cluster ended, hung, or
/// could not go on. No process is left behind in any case.
pub fn run(options: &Options, mut on_frame: impl FnMut(&Shown<'_>) -> Result<()>) -> Result<RunReport> {
    options.check()?;
    let image = options.source.open(options.page_bytes, options.quiet)?;
    check_built(&image)?;
    if options.triangle_test == TriangleTestKind::Moller && image.header.volume.is_some() {
        bail!("--triangle-test moller draws meshes; {} is a volume", image.name);
    }
    let image = if options.is_replicated() { image.freeze()? } else { image };
    let run = Run::plan(options, &image)?;
    let (name, header) = (image.name.clone(), image.header);
    let Options { session, size, solver, .. } = options;
    let shown = Surfaces::new(&options.isosurfaces, session, &options.source, &image)?;
    let mut moments = session.frames(&header.view, *size, *solver, |asked| shown.of_moment(asked))?;
    for frame in &mut moments {
        *frame = frame.with_triangle_test(options.triangle_test);
    }
    let notes = image.notes.iter().map(ToString::to_string).chain(left_out_of_frames()).collect();
    let (mailboxes, letters) = balance::mailboxes(run.mailboxes(options))?;
    let files = run.files(image, mailboxes)?;
    let mut supervisor =
        Supervisor::start(&run.set_ups(options), &files, &letters, options.deadline, options.kills.clone())?;
    supervisor.wait_until_ready()?;
    // Each process has its own part now; nobody holds the whole.
    drop((files, letters));

    let mut dealt = Dealt::new(&run, options);
    let mut ledger = dealt.ledger(&run, options);
    let frames = replay(options, &moments, (&mut supervisor, &mut ledger), &mut on_frame)?;
    let (nodes, losses) = supervisor.finish()?;
    Ok(RunReport {
        command: options.command.clone(),
        scene: run.scene_report(name, &header, moments[0].isosurfaces(), notes),
        session: session.name().to_owned(),
        replay: options.replay.name().to_owned(),
        size: [size.width, size.height],
        transport: serde_json::to_value(options.transport)?.as_str().unwrap_or_default().to_owned(),
        balance: options.balance.to_string(),
        totals: Totals::of(&frames, &nodes),
        displays: options.displays,
        frames,
        nodes,
        replicas: options.replicas,
        losses,
    })
}

/// Refuses what a build without some kernels cannot draw, before anybody is started.
fn check_built(image: &Image) -> Result<()> {
    match image.header.needs.without(SceneNeeds::BUILT) {
        SceneNeeds::NONE => Ok(()),
        missing => Err(HeaderError::LeftOut(missing)).with_context(|| format!("cannot draw {}", image.name)),
    }
}

/// What pictures lack because this build lacks it.
fn left_out_of_frames() -> Option<String> {
    let without = "no shadows: they were left out of this build; enable the feature shadows";
    (!cfg!(feature = "shadows")).then(|| without.to_owned())
}

/// Draws moments of the session until it is over.
fn replay(
    options: &Options,
    moments: &[Frame],
    (supervisor, ledger): (&mut Supervisor, &mut Ledger<'_>),
    on_frame: &mut impl FnMut(&Shown<'_>) -> Result<()>,
) -> Result<Vec<FrameReport>> {
    let bar = FrameBar::new(options.quiet, options.session.count());
    let (start, mut frames, mut drawn) = (Instant::now(), Vec::new(), None);
    while let Some(Step { moment, wait }) = options.replay.next(&options.session, drawn, start.elapsed()) {
        // Only `--replay time` waits: the next moment of the session has not come.
        thread::sleep(wait);
        // Nodes count frames, not moments: no number is left out.
        let frame = Frame { number: u32::try_from(frames.len())?, ..moments[moment] };
        let drawing = supervisor.draw(frame, ledger)?;
        let number = u32::try_from(moment)?;
        on_frame(&drawing.shown(number, &options.diagnostics))?;
        let time = options.session.moments()[moment].time;
        frames.push(drawing.report(number, time, frame.isosurfaces()));
        bar.set(number + 1);
        drawn = Some(moment);
    }
    Ok(frames)
}

/// The arithmetic of a run, done.
struct Run {
    plan: Plan,
    image_bytes: u64,
    threads: u16,
    transport: TransportKind,
}

impl Run {
    fn plan(options: &Options, image: &Image) -> Result<Self> {
        let image_bytes = image.header.image_bytes;
        let demand = Demand {
            nodes: options.nodes,
            stores: options.stores,
            memory: options.memory,
            image_bytes,
            page_bytes: options.page_bytes.unwrap_or(image.header.page_bytes),
            replicated: options.is_replicated(),
            replicas: options.replicas,
        };
        let plan = Plan::new(&demand)?;
        let threads = options.threads.map_or_else(|| cores().div_ceil(plan.nodes), NonZeroU16::get);
        Ok(Self { plan, image_bytes, threads, transport: options.transport })
    }

    /// Mailboxes of nodes: one each where they take tiles from each other.
    fn mailboxes(&self, options: &Options) -> u16 {
        if options.balance.steals() && self.plan.nodes > 1 { self.plan.nodes } else { 0 }
    }

    /// The image, a file for the pages of each owner and its inbox, and the mailboxes.
    fn files(&self, image: Image, mailboxes: Vec<OwnedFd>) -> Result<Files<OwnedFd>> {
        let placement = &self.plan.placement;
        let pages = placement.owner_ids().map(|owner| {
            let bytes = u64::from(self.plan.own_pages(owner)) * u64::from(self.plan.page_bytes);
            Ok(PageFile::create(bytes).context("cannot get memory for the owners' pages")?.into())
        });
        // At most 64 nodes of 256 threads.
        let layout = Layout::new(self.plan.page_bytes, self.plan.nodes * self.threads.min(THREADS_MAX))?;
        let inboxes = placement
            .owner_ids()
            .filter(|_| self.transport == TransportKind::ShmRing)
            .map(|_| Ok(Inbox::create(layout).context("cannot get memory for rings")?.into()));
        Ok(Files {
            image: image.into(),
            pages: pages.collect::<Result<_>>()?,
            inboxes: inboxes.collect::<Result<_>>()?,
            mailboxes,
            displays: Vec::new(),
        })
    }

    fn set_ups(&self, options: &Options) -> Vec<SetUp> {
        let cluster = cluster_id();
        let Plan { nodes, stores, page_bytes, budget_bytes, slots, .. } = self.plan;
        let processes = nodes + stores;
        let set_up = |node| SetUp {
            node,
            nodes,
            processes,
            cluster,
            placement: self.plan.placement_numbers(),
            page_bytes,
            image_bytes: self.image_bytes,
            budget_bytes,
            slots,
            threads: self.threads,
            threads_per_core: self.threads_per_core(),
            binds_to_cores: self.binds_to_cores(options),
            backend: options.backend.map_or("auto", BackendKind::name).to_owned(),
            policy: options.policy.name().to_owned(),
            reference: options.reference.name().to_owned(),
            hidden_per_cent: options.hidden_per_cent,
            prefetch: options.prefetch,
            kernel: options.kernel.map_or("auto", Kernel::name).to_owned(),
            transport: self.transport,
            spin_us: self.spin_us(),
            deadline_us: u64::try_from(options.deadline.as_micros()).unwrap_or(u64::MAX),
            lose_per_mille: options.lose_per_mille,
            seed: options.seed,
            mailboxes: self.mailboxes(options),
            balance: options.balance.to_string(),
            size: [options.size.width, options.size.height],
            batch_tiles: match options.balance {
                // The next tile is sent when one has come.
                Balancer::Demand { .. } => 1,
                _ if options.kills.is_empty() => u16::MAX,
                _ => BATCH_TILES_COUNTED,
            },
            displays: options.displays,
            wants: Wants {
                facts: !options.diagnostics.is_empty(),
                owners: options.diagnostics.contains(&Diagnostic::PageOwner),
            },
        };
        (0..processes).map(set_up).collect()
    }

    /// Whether every render thread can have a core, and shall.
    fn binds_to_cores(&self, options: &Options) -> bool {
        options.bind_to.map_or(self.threads_per_core() <= 1, |bind_to| bind_to == BindTo::Core)
    }

    /// Render threads that have to share a core: 1 when each can have its own.
    fn threads_per_core(&self) -> u16 {
        self.plan.nodes.saturating_mul(self.threads).div_ceil(cores())
    }

    /// How long a thread looks for an answer before it sleeps: not at all where threads share cores.
    fn spin_us(&self) -> u64 {
        const SPIN_US: u64 = 50;
        let owners = self.plan.placement.owner_count();
        let servers = if self.transport == TransportKind::ShmRing { owners } else { 0 };
        let threads = u32::from(self.plan.nodes) * u32::from(self.threads) + u32::from(servers);
        if threads > u32::from(cores()) { 0 } else { SPIN_US }
    }

    fn scene_report(
        &self,
        name: String,
        header: &Header,
        isosurfaces: &[Isosurface],
        notes: Vec<String>,
    ) -> SceneReport {
        SceneReport {
            name,
            triangles: header.triangles,
            spheres: header.spheres,
            image_bytes: header.image_bytes,
            pages: self.plan.placement.page_count(),
            page_bytes: self.plan.page_bytes,
            needs: header.needs.to_string(),
            volume: header.volume.map(|volume| volume.dims),
            isovalues: isosurfaces.iter().map(|surface| surface.value).collect(),
            notes,
        }
    }
}

/// The memory of the display's part of the balance.
struct Dealt {
    tiles: Vec<DealtTile>,
    order: Vec<u32>,
    nodes: Vec<DealtNode>,
}

impl Dealt {
    fn new(run: &Run, options: &Options) -> Self {
        let tiles = Tiles::of(options.size.width, options.size.height).count() as usize;
        Self {
            tiles: vec![DealtTile::EMPTY; tiles],
            order: vec![0; tiles],
            nodes: vec![DealtNode::EMPTY; run.plan.nodes.into()],
        }
    }

    fn ledger(&mut self, run: &Run, options: &Options) -> Ledger<'_> {
        let config = LedgerConfig {
            epoch: EPOCH.0,
            nodes: run.plan.nodes,
            threads: run.threads,
            threads_per_core: run.threads_per_core(),
            tiles: Tiles::of(options.size.width, options.size.height),
            balancer: options.balance,
            resend_us: RESEND_US,
            confirms: false,
            seed: options.seed,
        };
        let Self { tiles, order, nodes } = self;
        Ledger::new(config, LedgerStorage { tiles, order, nodes })
    }
}

impl Options {
    fn check(&self) -> Result<()> {
        if self.threads.is_some_and(|threads| threads.get() > THREADS_MAX) {
            bail!("a node has at most {THREADS_MAX} render threads");
        }
        if !(1..=DISPLAYS_MAX).contains(&self.displays) {
            bail!("--displays is a number from 1 to {DISPLAYS_MAX}; got {}", self.displays);
        }
        if self.deadline.is_zero() {
            bail!("--deadline 0 leaves no time for anything");
        }
        if self.is_replicated() && self.replicas > 1 {
            bail!(
                "--replicas are copies of pages that are dealt; with --backend replicated every node holds them all"
            );
        }
        if self.is_replicated() && self.stores > 0 {
            bail!(
                "--stores hold pages for nodes that do not; with --backend replicated every node holds them all"
            );
        }
        Ok(())
    }

    fn is_replicated(&self) -> bool {
        self.backend == Some(BackendKind::Replicated)
    }
}

impl Shown<'_> {
    /// Writes the frame to a PNG file, and the diagnostics that were asked for beside it: with `out.png` go
    /// `out.misses.png` and so on, and, if there are several, `out.diagnostic.png` with all side by side.
    ///
    /// # Errors
    /// What the system says.
    pub fn write(&self, path: &Path) -> Result<()> {
        let Self { picture, facts, diagnostics, .. } = self;
        picture.write(path)?;
        let Some(facts) = facts else { return Ok(()) };
        for kind in *diagnostics {
            sheet_of(*kind, picture, facts).write(&beside(path, kind.name()))?;
        }
        if diagnostics.len() > 1 {
            sheet_of_all(diagnostics, picture, facts).write(&beside(path, "diagnostic"))?;
        }
        Ok(())
    }
}

/// A file of this kind beside another one.
fn beside(path: &Path, kind: &str) -> PathBuf {
    let extension = path.extension().unwrap_or(OsStr::new("png"));
    let mut new = OsString::from(kind);
    new.push(".");
    new.push(extension);
    path.with_extension(new)
}

impl Drawing {
    fn shown<'a>(&'a self, moment: u32, diagnostics: &'a [Diagnostic]) -> Shown<'a> {
        Shown { moment, picture: &self.gathered.picture, facts: self.facts.as_ref(), diagnostics }
    }

    /// What is told of the frame, which showed a moment of this number and time and these isosurfaces.
    fn report(&self, moment: u32, time: f64, isosurfaces: &[Isosurface]) -> FrameReport {
        let Gathered { picture, counts, traffic } = &self.gathered;
        FrameReport {
            frame: counts.frame,
            moment,
            time,
            isovalues: isosurfaces.iter().map(|surface| surface.value).collect(),
            ms: self.ms,
            image_hash: picture.hash(),
            primary_rays: counts.primary_rays,
            hits: counts.hits,
            shadow_rays: counts.shadow_rays,
            lit: counts.lit,
            damaged_pixels: counts.damaged,
            gather_ms: traffic.busy_ns as f64 / 1e6,
            gather_parcels: traffic.parcels,
            gather_bytes: traffic.bytes,
            changed_tiles: traffic.changed_tiles,
            moved_tiles: self.moved_tiles,
        }
    }
}

/// Slots that hold hidden pages, in per cent: more of them bring little and cost many soft faults.
pub(crate) const HIDDEN_PER_CENT: u32 = 25;

/// Tiles sent at a time where a process is to be killed after so many.
const BATCH_TILES_COUNTED: u16 = 2;

/// Threads that one region can serve.
const THREADS_MAX: u16 = 256;

fn cores() -> u16 {
    available_parallelism().map_or(1, |cores| u16::try_from(cores.get()).unwrap_or(u16::MAX))
}

/// A number that another run, past or beside this one, hardly has.
fn cluster_id() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let nanoseconds = u64::try_from(since.as_nanos() & u128::from(u64::MAX)).unwrap_or(0);
    nanoseconds.rotate_left(20) ^ u64::from(std::process::id())
}
