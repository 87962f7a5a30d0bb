//! Starts the processes of a run, watches them, gathers their tiles, and ends them, however the run ends.

use core::time::Duration;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Instant;

use anyhow::{Context, Error, Result, anyhow, bail};
use rt_core::{Frame, Tiles};

use crate::control::{Drawn, Files, News, Order, SetUp, TileBatch};
use crate::link::{Link, wait_for_any};
use crate::node::NODE_COMMAND;
use crate::picture::Picture;
use crate::report::ProcessReport;
use crate::size::PictureSize;

/// The processes of a run. Dropping it ends them all.
#[derive(Debug)]
pub(crate) struct Supervisor {
    processes: Vec<Process>,
    /// Render threads over all nodes; each says when it has drawn a frame.
    painters: usize,
    /// A process that says nothing for this long is given up.
    deadline: Duration,
    /// What the run is busy with, for messages about its end.
    doing: String,
}

/// A child process and the way to it.
#[derive(Debug)]
struct Process {
    name: String,
    child: Child,
    link: Link,
    last_heard: Instant,
    is_done: bool,
}

/// A frame that is whole.
#[derive(Debug)]
pub(crate) struct Drawing {
    pub(crate) picture: Picture,
    pub(crate) counts: Drawn,
    pub(crate) ms: f64,
}

/// A frame that is being put together.
struct Canvas {
    frame: Frame,
    tiles: Tiles,
    picture: Picture,
    missing: usize,
    is_there: Vec<bool>,
    counts: Drawn,
    painters_done: usize,
}

/// How long one look at the links takes at most, so that a silent process is noticed soon.
const LOOK_MS: u32 = 50;

impl Supervisor {
    /// Starts a process for each plan and gives it its files.
    pub(crate) fn start(plans: &[SetUp], files: &Files<OwnedFd>, deadline: Duration) -> Result<Self> {
        let renders = |plan: &&SetUp| plan.node < plan.nodes;
        let painters = plans.iter().filter(renders).map(|plan| usize::from(plan.threads)).sum();
        let doing = "the cluster was started".to_owned();
        let mut supervisor = Self { processes: Vec::new(), painters, deadline, doing };
        for plan in plans {
            let process = Process::start(plan).with_context(|| format!("cannot start {}", name_of(plan)))?;
            supervisor.processes.push(process);
        }
        let list: Vec<BorrowedFd<'_>> = files.iter().map(AsFd::as_fd).collect();
        for (index, plan) in plans.iter().enumerate() {
            let packet = Order::SetUp(Box::new(plan.clone())).to_packet()?;
            supervisor.send(index, &packet, &list)?;
        }
        Ok(supervisor)
    }

    /// Waits until every process has filled its home pages, then lets them fetch from each other.
    pub(crate) fn wait_until_ready(&mut self) -> Result<()> {
        "the home pages were filled".clone_into(&mut self.doing);
        let mut ready = vec![false; self.processes.len()];
        while ready.contains(&false) {
            for (index, news) in self.listen()? {
                match news {
                    News::Ready => ready[index] = true,
                    other => self.reject(index, &other)?,
                }
            }
        }
        self.tell_all(&Order::Go)
    }

    /// Has one frame drawn.
    pub(crate) fn draw(&mut self, frame: Frame) -> Result<Drawing> {
        self.doing = format!("frame {} was drawn", frame.number);
        let start = Instant::now();
        self.tell_all(&Order::Draw(frame))?;
        let mut canvas = Canvas::new(frame);
        while canvas.missing > 0 || canvas.painters_done < self.painters {
            for (index, news) in self.listen()? {
                match news {
                    News::Tiles(batch) => {
                        let context = || format!("{} sent", self.processes[index].name);
                        canvas.put(&batch).with_context(context)?;
                    }
                    News::Drawn(drawn) => canvas.count(&drawn),
                    other => self.reject(index, &other)?,
                }
            }
        }
        let ms = start.elapsed().as_secs_f64() * 1000.0;
        Ok(Drawing { picture: canvas.picture, counts: canvas.counts, ms })
    }

    /// Has every process report, and sees each one end.
    pub(crate) fn finish(mut self) -> Result<Vec<ProcessReport>> {
        "the cluster ended".clone_into(&mut self.doing);
        self.tell_all(&Order::Stop)?;
        let mut reports: Vec<Option<ProcessReport>> = self.processes.iter().map(|_| None).collect();
        while reports.iter().any(Option::is_none) {
            for (index, news) in self.listen()? {
                match news {
                    News::Report(report) => {
                        reports[index] = Some(*report);
                        self.processes[index].is_done = true;
                    }
                    other => self.reject(index, &other)?,
                }
            }
        }
        for process in &mut self.processes {
            process.see_end(self.deadline)?;
        }
        Ok(reports.into_iter().flatten().collect())
    }

    /// What processes have to say, waiting a little for the first; and whether all are well.
    fn listen(&mut self) -> Result<Vec<(usize, News)>> {
        let open: Vec<usize> =
            (0..self.processes.len()).filter(|index| !self.processes[*index].is_done).collect();
        let links: Vec<&Link> = open.iter().map(|index| &self.processes[*index].link).collect();
        let ready = wait_for_any(&links, LOOK_MS)?;
        let mut heard = Vec::new();
        for index in ready.into_iter().map(|ready| open[ready]) {
            let process = &mut self.processes[index];
            let packet = process.link.receive().unwrap_or(None);
            let Some(packet) = packet else { return Err(self.death()) };
            process.last_heard = Instant::now();
            match News::from_packet(&packet.bytes).with_context(|| format!("{} sent", process.name))? {
                News::Alive => {}
                News::Failed(why) => return Err(self.gave_up(index, &why)),
                news => heard.push((index, news)),
            }
        }
        self.check_silence()?;
        Ok(heard)
    }

    /// Gives up a process that has said nothing for the deadline.
    fn check_silence(&self) -> Result<()> {
        let silent = |process: &&Process| !process.is_done && process.last_heard.elapsed() > self.deadline;
        match self.processes.iter().find(silent) {
            None => Ok(()),
            Some(process) => Err(anyhow!(
                "{} {} while {}: it said nothing for {:.1} s",
                process.name,
                if process.is_stopped() { "was stopped" } else { "hung" },
                self.doing,
                self.deadline.as_secs_f64(),
            )),
        }
    }

    /// Why a process that has closed its link has ended.
    fn death(&mut self) -> Error {
        // A process that has closed its link is about to end, unless it only closed its link.
        let end = Instant::now() + self.deadline;
        loop {
            for process in self.processes.iter_mut().filter(|process| !process.is_done) {
                if let Ok(Some(status)) = process.child.try_wait() {
                    return anyhow!("{} {} while {}", process.name, how_it_ended(status), self.doing);
                }
            }
            if Instant::now() > end {
                return anyhow!("a process closed its link and did not end, while {}", self.doing);
            }
            std::thread::yield_now();
        }
    }

    /// A process says that it cannot go on. If that is because another one is gone, that one is named.
    fn gave_up(&mut self, index: usize, why: &str) -> Error {
        for process in self.processes.iter_mut().filter(|process| !process.is_done) {
            if let Ok(Some(status)) = process.child.try_wait()
                && !status.success()
                && status.signal().is_some()
            {
                return anyhow!("{} {} while {}", process.name, how_it_ended(status), self.doing);
            }
        }
        let (name, doing) = (&self.processes[index].name, &self.doing);
        match self.processes.iter().find(|process| process.is_stopped()) {
            Some(stopped) => anyhow!("{} was stopped while {doing}; {name} gave up: {why}", stopped.name),
            None => anyhow!("{name} gave up while {doing}: {why}"),
        }
    }

    fn reject(&self, index: usize, news: &News) -> Result<()> {
        bail!("{} sent {news:?} while {}", self.processes[index].name, self.doing)
    }

    fn tell_all(&mut self, order: &Order) -> Result<()> {
        let packet = order.to_packet()?;
        (0..self.processes.len()).try_for_each(|index| self.send(index, &packet, &[]))
    }

    fn send(&mut self, index: usize, packet: &[u8], files: &[BorrowedFd<'_>]) -> Result<()> {
        match self.processes[index].link.send_with(packet, files) {
            Ok(()) => Ok(()),
            Err(_) => Err(self.death()),
        }
    }
}

impl Drop for Supervisor {
    fn drop(&mut self) {
        for process in &mut self.processes {
            let _ = process.child.kill();
        }
        for process in &mut self.processes {
            let _ = process.child.wait();
        }
    }
}

impl Process {
    fn start(plan: &SetUp) -> Result<Self> {
        let (ours, theirs) = Link::pair()?;
        let child = Command::new("/proc/self/exe")
            .arg0("memsavvy")
            .args([NODE_COMMAND, &plan.node.to_string()])
            .stdin(Stdio::from(theirs.into_socket()))
            .stdout(Stdio::null())
            .spawn()?;
        Ok(Self { name: name_of(plan), child, link: ours, last_heard: Instant::now(), is_done: false })
    }

    /// Waits for the end of a process that has reported.
    fn see_end(&mut self, deadline: Duration) -> Result<()> {
        let end = Instant::now() + deadline;
        loop {
            match self.child.try_wait()? {
                Some(status) if status.success() => return Ok(()),
                Some(status) => bail!("{} {} after it had reported", self.name, how_it_ended(status)),
                None if Instant::now() > end => bail!("{} reported and did not end", self.name),
                None => std::thread::yield_now(),
            }
        }
    }

    /// Whether somebody has stopped it, as SIGSTOP does.
    fn is_stopped(&self) -> bool {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.child.id())).unwrap_or_default();
        // The state follows the name, which is in parentheses and may hold anything.
        let state = stat.rsplit_once(") ").and_then(|(_, rest)| rest.chars().next());
        matches!(state, Some('T' | 't'))
    }
}

impl Canvas {
    fn new(frame: Frame) -> Self {
        let tiles = Tiles::of(frame.width, frame.height);
        let count = tiles.ids().len();
        Self {
            frame,
            tiles,
            picture: Picture::new(PictureSize { width: frame.width, height: frame.height }),
            missing: count,
            is_there: vec![false; count],
            counts: Drawn { frame: frame.number, ..Drawn::default() },
            painters_done: 0,
        }
    }

    /// Puts tiles in place, each once.
    fn put(&mut self, batch: &TileBatch) -> Result<()> {
        if batch.frame() != self.frame.number {
            bail!("tiles of frame {} for frame {}", batch.frame(), self.frame.number);
        }
        for tile in batch.tiles(self.tiles) {
            let (id, tile, pixels) = tile?;
            if core::mem::replace(&mut self.is_there[id.0 as usize], true) {
                bail!("tile {} twice", id.0);
            }
            self.picture.put(tile, pixels);
            self.missing -= 1;
        }
        Ok(())
    }

    fn count(&mut self, drawn: &Drawn) {
        self.painters_done += 1;
        self.counts.primary_rays += drawn.primary_rays;
        self.counts.hits += drawn.hits;
        self.counts.shadow_rays += drawn.shadow_rays;
        self.counts.lit += drawn.lit;
        self.counts.damaged += drawn.damaged;
    }
}

fn name_of(plan: &SetUp) -> String {
    let role = if plan.node < plan.nodes { "node" } else { "store" };
    format!("{role} {}", plan.node)
}

fn how_it_ended(status: ExitStatus) -> String {
    match (status.signal(), status.code()) {
        (Some(signal), _) => format!("was killed by {}", signal_name(signal)),
        (None, Some(code)) => format!("ended with exit code {code}"),
        (None, None) => format!("ended: {status}"),
    }
}

fn signal_name(signal: i32) -> String {
    let names = [
        (2, "SIGINT"),
        (4, "SIGILL"),
        (6, "SIGABRT"),
        (7, "SIGBUS"),
        (8, "SIGFPE"),
        (9, "SIGKILL"),
        (11, "SIGSEGV"),
        (15, "SIGTERM"),
    ];
    let known = names.iter().find(|(number, _)| *number == signal);
    known.map_or_else(|| format!("signal {signal}"), |(_, name)| (*name).to_owned())
}
