//! Starts the processes of a run, watches them, and ends them, however the run ends.

use core::time::Duration;
use std::io::ErrorKind;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Instant;

use anyhow::{Context, Error, Result, anyhow, bail};
use dsm_core::id::NodeId;
use dsm_core::placement::Stripes;
use rt_core::{Frame, TileId};

use crate::canvas::Canvas;
use crate::control::{Files, News, Order, SetUp};
use crate::diagnostic::FrameFacts;
use crate::gather::{Displays, Gathered};
use crate::link::{Link, PACKET_BYTES_MAX, wait_for_any};
use crate::loss::{Kill, Loss, Moment, is_all_there};
use crate::node::NODE_COMMAND;
use crate::report::ProcessReport;
use crate::size::PictureSize;

/// The processes of a run. Dropping it ends them all.
#[derive(Debug)]
pub(crate) struct Supervisor {
    /// The nodes, which render, then the stores.
    processes: Vec<Process>,
    nodes: usize,
    /// Where the tiles go.
    displays: Displays,
    /// Whether somebody wants to know more of tiles than their pixels.
    wants_facts: bool,
    /// Render threads of each node; each says when it has drawn its part of an order.
    threads: u32,
    placement: Stripes,
    losses: Vec<Loss>,
    /// Processes to be killed on purpose.
    kills: Vec<Kill>,
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
    /// It has reported, or is dead.
    is_done: bool,
    is_dead: bool,
    /// Why we have killed it.
    given_up: Option<String>,
}

/// What a process has said, or that it is dead and the others go on.
enum Event {
    News(News),
    Death,
}

/// A frame that is whole.
#[derive(Debug)]
pub(crate) struct Drawing {
    pub(crate) gathered: Gathered,
    pub(crate) ms: f64,
    /// What is known of its tiles, if somebody wants to know.
    pub(crate) facts: Option<FrameFacts>,
}

/// How long one look at the links takes at most, so that a silent process is noticed soon.
const LOOK_MS: u32 = 50;

/// Numbers of tiles that one packet can carry, beside the frame.
const TILES_IN_PACKET_MAX: usize = (PACKET_BYTES_MAX - 1 - size_of::<Frame>()) / size_of::<u32>();

impl Supervisor {
    /// Starts a process for each plan and gives it its files.
    pub(crate) fn start(
        plans: &[SetUp],
        files: &Files<OwnedFd>,
        deadline: Duration,
        kills: Vec<Kill>,
    ) -> Result<Self> {
        let first = plans.first().context("a cluster of no process")?;
        let (nodes, threads) = (first.nodes.into(), first.threads.into());
        let placement = first.placement.placement()?;
        let doing = "the cluster was started".to_owned();
        let (processes, losses) = (Vec::new(), Vec::new());
        let (displays, ends) = Displays::start(first.displays, nodes, !kills.is_empty())?;
        let mut supervisor = Self {
            processes,
            nodes,
            displays,
            wants_facts: first.wants.facts,
            threads,
            placement,
            losses,
            kills,
            deadline,
            doing,
        };
        for plan in plans {
            let process = Process::start(plan).with_context(|| format!("cannot start {}", name_of(plan)))?;
            supervisor.processes.push(process);
        }
        // A node's ends are its own: nobody else holds them, so that its death closes them.
        let mut ends = ends.into_iter();
        for (index, plan) in plans.iter().enumerate() {
            let packet = Order::SetUp(Box::new(plan.clone())).to_packet()?;
            let ends = ends.next().unwrap_or_default();
            let list: Vec<BorrowedFd<'_>> = files.iter().chain(&ends).map(AsFd::as_fd).collect();
            supervisor.processes[index].send(&packet, &list)?;
        }
        Ok(supervisor)
    }

    /// Waits until every process has filled its home pages or is dead, then lets the living fetch from each other. They
    /// know of the dead by then, so nobody reads a page file that is not filled.
    pub(crate) fn wait_until_ready(&mut self) -> Result<()> {
        "the home pages were filled".clone_into(&mut self.doing);
        self.kill_if(|kill| kill.when == Moment::Start);
        let mut ready = vec![false; self.processes.len()];
        while ready.contains(&false) {
            for (index, event) in self.listen()? {
                match event {
                    Event::News(News::Ready) | Event::Death => ready[index] = true,
                    other @ Event::News(_) => self.reject(index, &other)?,
                }
            }
        }
        self.tell_all(&Order::Go)
    }

    /// Has one frame drawn.
    pub(crate) fn draw(&mut self, frame: Frame) -> Result<Drawing> {
        self.doing = format!("frame {} was drawn", frame.number);
        let start = Instant::now();
        self.displays.begin(&frame);
        let mut canvas = Canvas::new(frame, self.nodes);
        let mut facts = self.wants_facts.then(|| FrameFacts::new(&frame));
        for index in self.living_nodes() {
            self.give(index, &Order::Draw(frame), &mut canvas)?;
        }
        // What nodes would have drawn that died in earlier frames.
        self.deal_again(&mut canvas)?;
        self.kill_as_asked(&canvas);
        while !(canvas.is_done() && self.displays.is_whole()) {
            for (index, event) in self.listen()? {
                let context = || format!("{} sent", self.processes[index].name);
                match event {
                    Event::News(News::Facts(batch)) => {
                        let facts =
                            facts.as_mut().context("facts that nobody asked for").with_context(context)?;
                        facts.take(&batch, u16::try_from(index)?).with_context(context)?;
                    }
                    Event::News(News::Drawn(frame)) => canvas.settle(index, frame).with_context(context)?,
                    Event::Death => self.go_on_without(index, &mut canvas)?,
                    other @ Event::News(_) => self.reject(index, &other)?,
                }
            }
            self.kill_as_asked(&canvas);
        }
        let gathered = self.displays.gather(PictureSize { width: frame.width, height: frame.height });
        let ms = start.elapsed().as_secs_f64() * 1000.0;
        Ok(Drawing { gathered, ms, facts })
    }

    /// Has every process report, and sees each one end. Tells of those that did not live to do so.
    pub(crate) fn finish(mut self) -> Result<(Vec<ProcessReport>, Vec<Loss>)> {
        "the cluster ended".clone_into(&mut self.doing);
        self.tell_all(&Order::Stop)?;
        let mut reports: Vec<Option<ProcessReport>> = self.processes.iter().map(|_| None).collect();
        while self.processes.iter().any(|process| !process.is_done) {
            for (index, event) in self.listen()? {
                match event {
                    Event::News(News::Report(report)) => {
                        reports[index] = Some(*report);
                        self.processes[index].is_done = true;
                    }
                    Event::Death => {}
                    other @ Event::News(_) => self.reject(index, &other)?,
                }
            }
        }
        for process in self.processes.iter_mut().filter(|process| !process.is_dead) {
            process.see_end(self.deadline)?;
        }
        Ok((reports.into_iter().flatten().collect(), core::mem::take(&mut self.losses)))
    }

    /// Has the living nodes draw what a node that has just died still owed.
    fn go_on_without(&mut self, index: usize, canvas: &mut Canvas) -> Result<()> {
        canvas.forgive(index);
        let dealt_again = self.deal_again(canvas)?;
        if let Some(loss) = self.losses.last_mut() {
            loss.tiles_dealt_again = dealt_again;
        }
        Ok(())
    }

    /// Deals the missing tiles of dead nodes to the living; tells how many there were.
    fn deal_again(&mut self, canvas: &mut Canvas) -> Result<usize> {
        let living = self.living_nodes();
        let missing =
            canvas.missing_of(|node| self.processes[node].is_dead, |tile| self.displays.is_there(tile));
        for (turn, node) in living.iter().enumerate() {
            let tiles: Vec<TileId> = missing.iter().skip(turn).step_by(living.len()).copied().collect();
            canvas.deal(&tiles, *node);
            for tiles in tiles.chunks(TILES_IN_PACKET_MAX) {
                self.give(*node, &Order::DrawTiles(canvas.frame(), tiles.to_vec()), canvas)?;
            }
        }
        Ok(missing.len())
    }

    /// Gives a node something to draw, of which each of its threads says when it is done.
    fn give(&self, index: usize, order: &Order, canvas: &mut Canvas) -> Result<()> {
        canvas.owe(index, self.threads);
        self.processes[index].send(&order.to_packet()?, &[])
    }

    fn living_nodes(&self) -> Vec<usize> {
        (0..self.nodes).filter(|index| !self.processes[*index].is_dead).collect()
    }

    /// Kills the processes whose time has come.
    fn kill_as_asked(&mut self, canvas: &Canvas) {
        if self.kills.is_empty() {
            return;
        }
        let (drawn, present) = (canvas.frame().number, self.displays.present());
        let is_due =
            |when| matches!(when, Moment::Drawn { frame, tiles } if frame == drawn && present >= tiles);
        self.kill_if(|kill| is_due(kill.when));
    }

    fn kill_if(&mut self, is_due: impl Fn(&Kill) -> bool) {
        let processes = &mut self.processes;
        self.kills.retain(|kill| {
            if is_due(kill)
                && let Some(process) = processes.get_mut(usize::from(kill.process))
            {
                let _ = process.child.kill();
            }
            !is_due(kill)
        });
    }

    /// What processes have to say, waiting a little for the first; and whether all are well.
    fn listen(&mut self) -> Result<Vec<(usize, Event)>> {
        let open: Vec<usize> =
            (0..self.processes.len()).filter(|index| !self.processes[*index].is_done).collect();
        let links = open.iter().map(|index| self.processes[*index].link.as_fd());
        let files: Vec<BorrowedFd<'_>> = links.chain([self.displays.bell()]).collect();
        let ready = wait_for_any(&files, LOOK_MS)?;
        self.displays.listen()?;
        let mut heard = Vec::new();
        // The last is the bell.
        for index in ready.into_iter().filter_map(|ready| open.get(ready).copied()) {
            let process = &mut self.processes[index];
            let packet = process.link.receive().unwrap_or(None);
            let Some(packet) = packet else {
                self.bury(index)?;
                heard.push((index, Event::Death));
                continue;
            };
            process.last_heard = Instant::now();
            match News::from_packet(&packet.bytes).with_context(|| format!("{} sent", process.name))? {
                News::Alive => {}
                News::Failed(why) => return Err(self.gave_up(index, &why)),
                news => heard.push((index, Event::News(news))),
            }
        }
        self.check_silence()?;
        Ok(heard)
    }

    /// Gives up a process that has said nothing for the deadline: kills it, if the others can go on without it.
    fn check_silence(&mut self) -> Result<()> {
        let silent = |process: &Process| !process.is_done && process.last_heard.elapsed() > self.deadline;
        let Some(index) = self.processes.iter().position(silent) else { return Ok(()) };
        let process = &self.processes[index];
        let what = if process.is_stopped() { "was stopped" } else { "hung" };
        let silence_s = self.deadline.as_secs_f64();
        if !self.can_spare(index) {
            bail!("{} {what} while {}: it said nothing for {silence_s:.1} s", process.name, self.doing);
        }
        // Its link closes, and that is how its death is noticed.
        let process = &mut self.processes[index];
        process.given_up = Some(format!("{what}, said nothing for {silence_s:.1} s and was killed"));
        process.last_heard = Instant::now();
        Ok(process.child.kill()?)
    }

    /// Sees the end of a process that has closed its link, and tells the others, who go on if they can.
    fn bury(&mut self, index: usize) -> Result<()> {
        let deadline = self.deadline;
        let how = self.processes[index].how_it_ended(deadline)?;
        let (process, doing) = (self.processes[index].name.clone(), self.doing.clone());
        if !self.can_spare(index) {
            bail!("{process} {how} while {doing}");
        }
        if index < self.nodes {
            self.displays.see_gone(index, deadline)?;
        }
        self.losses.push(Loss { process, how, doing, tiles_dealt_again: 0 });
        self.processes[index].is_done = true;
        self.processes[index].is_dead = true;
        self.tell_all(&Order::Down(u16::try_from(index)?))
    }

    /// Whether the others can go on without a process: somebody renders, and every page is left.
    fn can_spare(&self, index: usize) -> bool {
        let is_dead = |other: usize| other == index || self.processes[other].is_dead;
        let renders = (0..self.nodes).any(|node| !is_dead(node));
        let is_copied = self.placement.replicas() > 1;
        is_copied && renders && is_all_there(&self.placement, |NodeId(node)| is_dead(node.into()))
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

    fn reject(&self, index: usize, event: &Event) -> Result<()> {
        let (name, doing) = (&self.processes[index].name, &self.doing);
        match event {
            Event::News(news) => bail!("{name} sent {news:?} while {doing}"),
            Event::Death => bail!("{name} died while {doing}"),
        }
    }

    fn tell_all(&self, order: &Order) -> Result<()> {
        let packet = order.to_packet()?;
        self.processes.iter().try_for_each(|process| process.send(&packet, &[]))
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
        let (name, last_heard) = (name_of(plan), Instant::now());
        Ok(Self { name, child, link: ours, last_heard, is_done: false, is_dead: false, given_up: None })
    }

    /// Sends a packet. To one that is dead it is lost: its death is noticed when it is listened to.
    fn send(&self, packet: &[u8], files: &[BorrowedFd<'_>]) -> Result<()> {
        match self.link.send_with(packet, files) {
            Err(error) if matches!(error.kind(), ErrorKind::BrokenPipe | ErrorKind::ConnectionReset) => {
                Ok(())
            }
            sent => Ok(sent?),
        }
    }

    /// How a process has ended that has closed its link.
    fn how_it_ended(&mut self, deadline: Duration) -> Result<String> {
        // It is about to end, unless it only closed its link.
        let end = Instant::now() + deadline;
        while Instant::now() < end {
            if let Some(status) = self.child.try_wait()? {
                return Ok(self.given_up.take().unwrap_or_else(|| how_it_ended(status)));
            }
            std::thread::yield_now();
        }
        bail!("{} closed its link and did not end", self.name)
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
