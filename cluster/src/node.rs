//! A process of the cluster: fills its home pages, serves them, draws its tiles, reports.

use core::sync::atomic::{AtomicBool, Ordering};
use core::time::Duration;
use std::fs::{self, File};
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::FileExt;
use std::process::ExitCode;
use std::sync::Arc;
use std::thread::{self, JoinHandle};

use anyhow::{Context, Result, anyhow, bail};
use dsm_core::id::{ClusterId, NodeId};
use dsm_core::node::{Config, NEIGHBOURS_MAX};
use dsm_core::placement::Stripes;
use dsm_core::replacement::{PolicyKind, ReferenceSource};
use dsm_core::stats::{Histogram, HomeStats};
use fault_linux::{BackendKind, Region, Setup, ThreadStats};
use rt_core::Kernel;
use rustix::process::{Signal, set_parent_process_death_signal};
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use transport_shm::{HeldPages, Server, now};

use crate::balance::{Balance, BalanceStats};
use crate::control::{Files, News, Order, Prefetch, SetUp};
use crate::gather::Outlets;
use crate::link::Link;
use crate::painter::Painter;
use crate::ports::{EPOCH, Routes, layout};
use crate::report::ProcessReport;

/// The hidden subcommand under which a process of the cluster is started.
pub(crate) const NODE_COMMAND: &str = "node";

/// Runs a process of the cluster if that is what this process was started as.
///
/// Any program that calls [`run`](crate::run::run) calls this first: the cluster's processes are started from the
/// running program itself, as `PROGRAM node NUMBER`, with the supervisor's socket as standard input.
#[must_use]
pub fn run_as_node_if_asked() -> Option<ExitCode> {
    let mut arguments = std::env::args_os().skip(1);
    let asked = arguments.next().is_some_and(|command| command == NODE_COMMAND) && arguments.next().is_some();
    (asked && arguments.next().is_none()).then(main)
}

fn main() -> ExitCode {
    // Whatever happens to the supervisor, its processes do not outlive it.
    let bound = set_parent_process_death_signal(Some(Signal::KILL));
    let socket = io::stdin().as_fd().try_clone_to_owned();
    let link = match (bound, socket) {
        (Ok(()), Ok(socket)) => Arc::new(Link::from_socket(socket)),
        _ => return ExitCode::FAILURE,
    };
    match Process::set_up(&link).and_then(Process::run) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // If the supervisor is gone there is nobody to tell.
            let _ = News::Failed(format!("{error:#}")).to_packet().and_then(|news| Ok(link.send(&news)?));
            ExitCode::FAILURE
        }
    }
}

/// A process whose pages are in place.
struct Process {
    set_up: SetUp,
    link: Arc<Link>,
    routes: Routes,
    outlets: Arc<Outlets>,
    image: OwnedFd,
    /// The way to each node, and where their letters come in.
    mailboxes: Vec<OwnedFd>,
    letters: Option<OwnedFd>,
    placement: Stripes,
}

/// The threads of a running process.
struct Crew {
    region: Option<Arc<Region>>,
    balance: Option<Arc<Balance>>,
    painters: Vec<JoinHandle<Result<ThreadStats>>>,
    /// What the painters have counted that have ended.
    miss_ns: Histogram,
    server: Option<JoinHandle<HomeStats>>,
    stop: Arc<AtomicBool>,
    /// A store's pages, so that they count as its memory.
    _held: Option<HeldPages>,
}

impl Process {
    /// Learns who it is and fills its home pages.
    fn set_up(link: &Arc<Link>) -> Result<Self> {
        let Some(packet) = link.receive()? else { bail!("the supervisor ended before saying anything") };
        let Order::SetUp(set_up) = Order::from_packet(&packet.bytes)? else {
            bail!("the first order is no plan")
        };
        let placement = set_up.placement.placement()?;
        let owners = usize::from(placement.owner_count());
        let mut files = packet.files;
        let has_letters = set_up.node < set_up.mailboxes;
        let letters = has_letters.then(|| files.pop()).flatten();
        let Files { image, pages, inboxes, mailboxes, displays } = Files::from_list(files, owners, &set_up)?;
        let outlets = Arc::new(Outlets::new(displays.into_iter().map(Link::from_socket).collect()));
        let routes = Routes::new(&set_up, placement, pages, inboxes)?;
        say_alive(link, set_up.deadline_us)?;
        let process = Self {
            set_up: *set_up,
            link: link.clone(),
            routes,
            outlets,
            image,
            mailboxes,
            letters,
            placement,
        };
        process.fill_home().context("cannot read the scene image")?;
        link.send(&News::Ready.to_packet()?)?;
        Ok(process)
    }

    /// Copies this node's own stripes, home and replicas, from the image, through a small buffer.
    fn fill_home(&self) -> Result<()> {
        let Some((pages, _)) = self.routes.own() else { return Ok(()) };
        if self.is_replicated() {
            return Ok(());
        }
        let image = File::from(self.image.try_clone()?);
        let page_bytes = u64::from(self.set_up.page_bytes);
        let mut buffer = vec![0; 1 << 20];
        let mut to = 0;
        for stripe in self.placement.held_stripes_of(self.me()) {
            let (start, end) = (u64::from(stripe.start) * page_bytes, u64::from(stripe.end) * page_bytes);
            copy(&image, start..end.min(self.set_up.image_bytes), pages.file(), to, &mut buffer)?;
            to += end - start;
        }
        pages.freeze()?;
        Ok(())
    }

    fn run(mut self) -> Result<()> {
        // Until every process has filled its pages, or is dead, nobody reads any: what is read never changes.
        let mut dead = Vec::new();
        loop {
            match self.next_order()? {
                Some(Order::Go) => break,
                Some(Order::Down(process)) => dead.push(process),
                Some(_) => bail!("the order after the plan is not to go"),
                None => return Ok(()),
            }
        }
        let mut crew = self.start()?;
        dead.into_iter().for_each(|process| crew.bury(process));
        loop {
            match self.next_order()? {
                Some(Order::Draw(frame, deal)) => {
                    crew.balance.iter().for_each(|balance| balance.begin(frame));
                    crew.balance.iter().try_for_each(|balance| balance.handle_deal(&deal))?;
                }
                Some(Order::Balance(deal)) => {
                    crew.balance.iter().try_for_each(|balance| balance.handle_deal(&deal))?;
                }
                Some(Order::Down(process)) => crew.bury(process),
                Some(Order::Halt) => {
                    crew.halt()?;
                    self.link.send(&News::Halted.to_packet()?)?;
                }
                Some(Order::Stop) => break,
                Some(Order::SetUp(_) | Order::Go) => bail!("a second plan, or a second start"),
                // The supervisor is gone. So is the reason to be here.
                None => return Ok(()),
            }
        }
        let report = self.report(crew)?;
        self.link.send(&News::Report(Box::new(report)).to_packet()?)?;
        Ok(())
    }

    /// The next order, or `None` when the supervisor is gone.
    fn next_order(&self) -> Result<Option<Order>> {
        self.link.receive()?.map(|packet| Order::from_packet(&packet.bytes)).transpose()
    }

    fn start(&mut self) -> Result<Crew> {
        let stop = Arc::new(AtomicBool::new(false));
        let server = self.start_server(&stop)?;
        if !self.renders() {
            let held = self.routes.own().map(|(pages, _)| pages.hold()).transpose()?;
            return Ok(Crew {
                region: None,
                balance: None,
                painters: Vec::new(),
                miss_ns: Histogram::EMPTY,
                server,
                stop,
                _held: held,
            });
        }
        let region = self.region()?;
        let kernel = self.kernel()?;
        let mailboxes = core::mem::take(&mut self.mailboxes);
        let balance = Arc::new(Balance::new(&self.set_up, self.link.clone(), mailboxes, region.clone())?);
        self.letters.take().map_or(Ok(()), |letters| balance.start_reading(letters))?;
        let painters = (0..self.set_up.threads).map(|thread| {
            let painter = Painter {
                region: region.clone(),
                port: self.routes.port(thread)?,
                link: self.link.clone(),
                outlets: self.outlets.clone(),
                balance: balance.clone(),
                image_bytes: self.set_up.image_bytes,
                kernel,
                batch_tiles: self.set_up.batch_tiles,
                wants: self.set_up.wants,
                placement: self.placement,
            };
            let link = self.link.clone();
            let name = format!("render {thread}");
            let core = self
                .set_up
                .binds_to_cores
                .then(|| usize::from(self.set_up.node * self.set_up.threads + thread));
            let body = move || {
                core.into_iter().for_each(bind_to_core);
                painter.run().inspect_err(|error| tell(&link, error))
            };
            Ok(thread::Builder::new().name(name).spawn(body)?)
        });
        let painters = painters.collect::<Result<_>>()?;
        Ok(Crew {
            region: Some(region),
            balance: Some(balance),
            painters,
            miss_ns: Histogram::EMPTY,
            server,
            stop,
            _held: None,
        })
    }

    fn start_server(&self, stop: &Arc<AtomicBool>) -> Result<Option<JoinHandle<HomeStats>>> {
        let Some((pages, Some(inbox))) = self.routes.own() else { return Ok(None) };
        let (home, layout) = (self.routes.home(self.me()), layout(&self.set_up)?);
        let mut server = Server::new(home, pages.clone(), inbox, layout, self.set_up.spin_us)?;
        let stop = stop.clone();
        let body = move || {
            const LOOK_US: u64 = 50_000;
            while !stop.load(Ordering::Relaxed) {
                server.serve(now().after(LOOK_US));
            }
            server.home().stats()
        };
        Ok(Some(thread::Builder::new().name("server".to_owned()).spawn(body)?))
    }

    fn region(&self) -> Result<Arc<Region>> {
        let SetUp { page_bytes, image_bytes, slots, cluster, deadline_us, .. } = self.set_up;
        if self.is_replicated() {
            let pages = u32::try_from(image_bytes.div_ceil(u64::from(page_bytes)))?;
            // SAFETY: the image is a memory file that the supervisor has sealed against writing and shrinking.
            return Ok(unsafe { Region::replicated(self.image.as_fd(), pages, page_bytes as usize) }?);
        }
        let SetUp { hidden_per_cent, prefetch, .. } = self.set_up;
        let has_neighbours = matches!(prefetch, Prefetch::Neighbours | Prefetch::Both);
        let node = Config {
            cluster: ClusterId(cluster),
            epoch: EPOCH,
            resend_us: RESEND_US.min(deadline_us),
            resend_us_min: RESEND_US.min(deadline_us),
            dead_after_us: deadline_us,
            deadline_us,
            neighbours_max: if has_neighbours { NEIGHBOURS_MAX } else { 0 },
            ..Config::new(self.me(), self.placement, page_bytes)
        };
        let home = match self.routes.own() {
            Some((pages, _)) if self.own_pages() > 0 => Some(pages.as_fd().try_clone_to_owned()?),
            _ => None,
        };
        let policy: PolicyKind = self.set_up.policy.parse()?;
        let reference: ReferenceSource = self.set_up.reference.parse()?;
        let backend = match self.set_up.backend.as_str() {
            "auto" => None,
            name => Some(name.parse::<BackendKind>()?),
        };
        let seed = self.set_up.seed ^ u64::from(self.set_up.node);
        let setup = Setup {
            node,
            policy,
            reference,
            hidden_per_cent,
            prefetch: matches!(prefetch, Prefetch::Tiles | Prefetch::Both),
            seed,
            slot_count: slots,
            home,
            backend,
        };
        // SAFETY: every process freezes its page file once it is filled, and only then says that it is ready; the
        // supervisor lets nobody draw before. From then on a page has the same bytes whoever grants it.
        Ok(unsafe { Region::new(setup) }?)
    }

    fn kernel(&self) -> Result<Kernel> {
        match self.set_up.kernel.as_str() {
            "auto" => Ok(Kernel::fastest()),
            name => name.parse().with_context(|| format!("kernel {name}")),
        }
    }

    /// Ends the threads and writes down what they have counted.
    fn report(&self, crew: Crew) -> Result<ProcessReport> {
        let region = crew.region.clone();
        let (miss_ns, home, balance) = crew.end()?;
        let stats = region.as_ref().map(|region| region.stats()).unwrap_or_default();
        let slots = region.as_ref().map_or(0, |region| region.slot_count());
        let choice = region.as_ref().map(|region| region.choice());
        let us = |per_mille| miss_ns.quantile(per_mille) as f64 / 1000.0;
        Ok(ProcessReport {
            node: self.set_up.node,
            role: if self.renders() { "node" } else { "store" }.to_owned(),
            threads: if self.renders() { self.set_up.threads } else { 0 },
            budget_bytes: if self.renders() { self.set_up.budget_bytes } else { self.held_bytes_max(0) },
            home_pages: self.own_pages(),
            slots,
            slots_withheld: choice.map_or(0, |choice| choice.slots_withheld),
            held_bytes_max: self.held_bytes_max(slots),
            peak_resident_bytes: resident_bytes("VmHWM:")?,
            program_bytes: resident_bytes("RssFile:")?,
            backend: choice.map(|choice| choice.used.to_string()).unwrap_or_default(),
            backends_declined: choice
                .map_or(Vec::new(), |choice| choice.declined.iter().map(ToString::to_string).collect()),
            kernel: if self.renders() { self.kernel()?.to_string() } else { String::new() },
            policy: if slots > 0 { self.set_up.policy.clone() } else { String::new() },
            reference: region.as_ref().map_or("", |region| region.reference().name()).to_owned(),
            faults: stats.faults,
            merged_faults: stats.merged_faults,
            fetched_pages: stats.fetched_pages,
            received_bytes: stats.received_bytes,
            evictions: stats.evicted_pages,
            soft_faults: stats.soft_faults,
            prefetched: stats.prefetch().asked,
            prefetch_used: stats.prefetch().used,
            prefetch_wasted: stats.prefetch().wasted,
            neighbours: stats.neighbour_prefetch.asked,
            neighbours_used: stats.neighbour_prefetch.used,
            neighbours_wasted: stats.neighbour_prefetch.wasted,
            resends: stats.resends,
            miss_p50_us: us(500),
            miss_p99_us: us(990),
            granted_pages: home.granted_pages,
            tiles_drawn: balance.worker.drawn,
            tiles_taken: balance.worker.taken,
            tiles_given: balance.worker.given,
            busy_ms: balance.worker.busy_us as f64 / 1000.0,
            idle_ms: balance.idle.as_secs_f64() * 1000.0,
        })
    }

    fn held_bytes_max(&self, slots: u32) -> u64 {
        if self.is_replicated() {
            return if self.renders() { self.set_up.image_bytes } else { 0 };
        }
        let pages = u64::from(self.own_pages()) + u64::from(slots);
        let tables = if self.renders() {
            crate::plan::bookkeeping_bytes(self.placement.page_count(), slots)
        } else {
            0
        };
        pages * u64::from(self.set_up.page_bytes) + tables
    }

    const fn me(&self) -> NodeId {
        NodeId(self.set_up.node)
    }

    const fn renders(&self) -> bool {
        self.set_up.node < self.set_up.nodes
    }

    /// Pages that lie in this process's own file: it is their home, or holds a replica.
    fn own_pages(&self) -> u32 {
        if self.is_replicated() { 0 } else { self.placement.held_pages(self.me()) }
    }

    fn is_replicated(&self) -> bool {
        self.set_up.backend == BackendKind::Replicated.name()
    }
}

impl Crew {
    /// Another process is dead.
    fn bury(&self, process: u16) {
        self.region.iter().for_each(|region| region.handle_peer_down(NodeId(process)));
        self.balance.iter().for_each(|balance| balance.handle_peer_down(process));
    }

    /// Waits until the tiles under way are drawn. Nobody wants them: they were drawn twice because somebody died, or the
    /// run is over.
    fn halt(&mut self) -> Result<BalanceStats> {
        let balance = self.balance.as_ref().map(|balance| balance.end()).unwrap_or_default();
        for thread in self.painters.drain(..) {
            self.miss_ns.merge(&thread.join().map_err(|_| anyhow!("a render thread panicked"))??.miss_ns);
        }
        Ok(balance)
    }

    fn end(mut self) -> Result<(Histogram, HomeStats, BalanceStats)> {
        let balance = self.halt()?;
        self.stop.store(true, Ordering::Relaxed);
        let home = self.server.map(|server| server.join().map_err(|_| anyhow!("the server thread panicked")));
        Ok((self.miss_ns, home.transpose()?.unwrap_or_default(), balance))
    }
}

/// First time to the sending again of a request, within one machine.
const RESEND_US: u64 = 20_000;

/// Says again and again that this process is here, whatever else it is busy with, from now to its end.
fn say_alive(link: &Arc<Link>, deadline_us: u64) -> Result<()> {
    let pause =
        Duration::from_micros(deadline_us / 8).clamp(Duration::from_millis(5), Duration::from_millis(250));
    let (link, alive) = (link.clone(), News::Alive.to_packet()?);
    let body = move || {
        while link.send(&alive).is_ok() {
            thread::sleep(pause);
        }
    };
    thread::Builder::new().name("alive".to_owned()).spawn(body)?;
    Ok(())
}

/// Keeps the calling thread to one of the cores this process may use, counted round robin. Where the system does not
/// let it, it runs where it is put.
fn bind_to_core(number: usize) {
    let Ok(allowed) = sched_getaffinity(None) else { return };
    let cores: Vec<usize> = (0..CpuSet::MAX_CPU).filter(|core| allowed.is_set(*core)).collect();
    let mut one = CpuSet::new();
    if let Some(core) = cores.get(number % cores.len().max(1)) {
        one.set(*core);
        let _ = sched_setaffinity(None, &one);
    }
}

/// Tells the supervisor why a thread has given up.
fn tell(link: &Link, error: &anyhow::Error) {
    let _ = News::Failed(format!("{error:#}")).to_packet().and_then(|news| Ok(link.send(&news)?));
}

/// Copies a range of one file to a place in another.
fn copy(
    from: &File,
    range: core::ops::Range<u64>,
    to: &File,
    mut place: u64,
    buffer: &mut [u8],
) -> io::Result<()> {
    let mut start = range.start;
    while start < range.end {
        let length = usize::try_from(range.end - start).unwrap_or(usize::MAX).min(buffer.len());
        let piece = &mut buffer[..length];
        from.read_exact_at(piece, start)?;
        to.write_all_at(piece, place)?;
        start += length as u64;
        place += length as u64;
    }
    Ok(())
}

/// A figure of this process's resident memory, as the system counts it.
fn resident_bytes(field: &str) -> Result<u64> {
    let status = fs::read_to_string("/proc/self/status").context("cannot read /proc/self/status")?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix(field))
        .context("no such field in /proc/self/status")?;
    let kilobytes: u64 = line.trim().trim_end_matches("kB").trim().parse()?;
    Ok(kilobytes * 1024)
}
