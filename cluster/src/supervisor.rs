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
use rt_core::Frame;
use rt_core::schedule::ledger::{Arrival, Output};
use rt_core::schedule::message::MESSAGE_BYTES_MAX;
use rt_core::schedule::{Balancer, Ledger, Message};
use transport_shm::now;

use crate::control::{Files, News, Order, SetUp};
use crate::diagnostic::FrameFacts;
use crate::gather::{Arrived, Displays, Gathered};
use crate::link::{Link, wait_for_any};
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
    /// Tiles that came from another node than they were dealt to.
    pub(crate) moved_tiles: u32,
    /// What is known of its tiles, if somebody wants to know.
    pub(crate) facts: Option<FrameFacts>,
}

/// How long one look at the links takes at most, so that a silent process is noticed soon.
const LOOK_MS: u32 = 50;

impl Supervisor {
    /// Starts a process for each plan and gives it its files.
    pub(crate) fn start(
        plans: &[SetUp],
        files: &Files<OwnedFd>,
        letters: &[OwnedFd],
        deadline: Duration,
        kills: Vec<Kill>,
    ) -> Result<Self> {
        let first = plans.first().context("a cluster of no process")?;
        let nodes = first.nodes.into();
        let placement = first.placement.placement()?;
        let doing = "the cluster was started".to_owned();
        let (processes, losses) = (Vec::new(), Vec::new());
        // Where the next tile is dealt when one has come, each is waited for; else only what makes a part whole.
        let balancer: Balancer = first.balance.parse().map_err(|error| anyhow!("{error}"))?;
        let rings_always = !kills.is_empty() || matches!(balancer, Balancer::Demand { .. });
        let (displays, ends) = Displays::start(first.displays, nodes, rings_always)?;
        let wants_facts = first.wants.facts;
        let mut supervisor =
            Self { processes, nodes, displays, wants_facts, placement, losses, kills, deadline, doing };
        for plan in plans {
            let process = Process::start(plan).with_context(|| format!("cannot start {}", name_of(plan)))?;
            supervisor.processes.push(process);
        }
        // A node's ends are its own: nobody else holds them, so that its death closes them.
        let mut ends = ends.into_iter();
        for (index, plan) in plans.iter().enumerate() {
            let packet = Order::SetUp(Box::new(plan.clone())).to_packet()?;
            let ends = ends.next().unwrap_or_default();
            let list = files.iter().chain(&ends).chain(letters.get(index));
            let list: Vec<BorrowedFd<'_>> = list.map(AsFd::as_fd).collect();
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
    pub(crate) fn draw(&mut self, frame: Frame, ledger: &mut Ledger<'_>) -> Result<Drawing> {
        self.doing = format!("frame {} was drawn", frame.number);
        let start = Instant::now();
        self.displays.begin(&frame);
        let mut facts = self.wants_facts.then(|| FrameFacts::new(&frame));
        // Whoever died before the first frame is dealt nothing.
        for index in (0..self.nodes).filter(|index| self.processes[*index].is_dead) {
            ledger.handle_down(u16::try_from(index)?);
        }
        ledger.begin(frame.number);
        // Every living node is dealt something, if only the word that the frame begins.
        self.send_deals(ledger, |deal| Order::Draw(frame, deal))?;
        self.kill_as_asked(&frame);
        while ledger.missing() > 0 || !self.is_told(facts.as_ref()) {
            for (index, event) in self.listen()? {
                let context = || format!("{} sent", self.processes[index].name);
                let node = u16::try_from(index)?;
                match event {
                    Event::News(News::Facts(batch)) => {
                        let facts =
                            facts.as_mut().context("facts that nobody asked for").with_context(context)?;
                        facts.take(&batch, node).with_context(context)?;
                    }
                    Event::News(News::Balance(message)) => {
                        let (message, _) = Message::parse(&message).with_context(context)?;
                        // What is refused has been said before, or is of a view that is over.
                        let _ = ledger.handle_message(&message);
                    }
                    Event::Death => {
                        // All that it had sent is in place: the rest is dealt anew.
                        self.take_arrivals(ledger, facts.as_mut());
                        self.go_on_without(node, ledger);
                    }
                    other @ Event::News(_) => self.reject(index, &other)?,
                }
            }
            self.take_arrivals(ledger, facts.as_mut());
            self.deal(ledger)?;
            self.kill_as_asked(&frame);
        }
        let gathered = self.displays.gather(PictureSize { width: frame.width, height: frame.height });
        let ms = start.elapsed().as_secs_f64() * 1000.0;
        Ok(Drawing { gathered, ms, moved_tiles: ledger.moved(), facts })
    }

    /// Has every process report, and sees each one end. Tells of those that did not live to do so.
    pub(crate) fn finish(mut self) -> Result<(Vec<ProcessReport>, Vec<Loss>)> {
        "the cluster ended".clone_into(&mut self.doing);
        self.halt()?;
        self.tell_all(&Order::Stop)?;
        let mut reports: Vec<Option<ProcessReport>> = self.processes.iter().map(|_| None).collect();
        while self.processes.iter().any(|process| !process.is_done) {
            for (index, event) in self.listen()? {
                match event {
                    Event::News(News::Report(report)) => {
                        reports[index] = Some(*report);
                        self.processes[index].is_done = true;
                    }
                    // Of frames that are whole without it.
                    Event::Death | Event::News(News::Facts(_) | News::Balance(_)) => {}
                    other @ Event::News(_) => self.reject(index, &other)?,
                }
            }
        }
        for process in self.processes.iter_mut().filter(|process| !process.is_dead) {
            process.see_end(self.deadline)?;
        }
        Ok((reports.into_iter().flatten().collect(), core::mem::take(&mut self.losses)))
    }

    /// Has every node draw no more. Whoever still draws needs the pages of all others, so nobody ends before.
    fn halt(&mut self) -> Result<()> {
        self.tell_all(&Order::Halt)?;
        let mut is_halted = vec![false; self.processes.len()];
        while (0..self.processes.len()).any(|index| !is_halted[index] && !self.processes[index].is_done) {
            for (index, event) in self.listen()? {
                match event {
                    Event::News(News::Halted) => is_halted[index] = true,
                    // Of frames that are whole without it.
                    Event::Death | Event::News(News::Facts(_) | News::Balance(_)) => {}
                    other @ Event::News(_) => self.reject(index, &other)?,
                }
            }
        }
        Ok(())
    }

    /// Tells the ledger which tiles have come since it last heard.
    fn take_arrivals(&self, ledger: &mut Ledger<'_>, mut facts: Option<&mut FrameFacts>) {
        for Arrived { node, frame, tile } in self.displays.arrivals() {
            if ledger.handle_drawn(node, frame, tile) == Arrival::First
                && let Some(facts) = &mut facts
            {
                facts.note_drawn(tile, node);
            }
        }
    }

    /// Whether all is known that somebody wants to know, and that can be.
    fn is_told(&self, facts: Option<&FrameFacts>) -> bool {
        facts.is_none_or(|facts| facts.is_whole(|node| self.processes[usize::from(node)].is_dead))
    }

    /// Has the living nodes draw what a node that has just died still owed.
    fn go_on_without(&mut self, node: u16, ledger: &mut Ledger<'_>) {
        let dealt_again = ledger.handle_down(node);
        if let Some(loss) = self.losses.last_mut() {
            loss.tiles_dealt_again = dealt_again as usize;
        }
    }

    /// Sends what the ledger has to say. Links lose nothing, so nothing is said again.
    fn deal(&self, ledger: &mut Ledger<'_>) -> Result<()> {
        self.send_deals(ledger, Order::Balance)
    }

    fn send_deals(&self, ledger: &mut Ledger<'_>, order: impl Fn(Vec<u8>) -> Order) -> Result<()> {
        let mut buffer = [0; MESSAGE_BYTES_MAX];
        while let Output::Transmit { to, length } = ledger.poll(now().as_micros(), &mut buffer) {
            let order = order(buffer[..length].to_vec());
            self.processes[usize::from(to)].send(&order.to_packet()?, &[])?;
        }
        Ok(())
    }

    /// Kills the processes whose time has come.
    fn kill_as_asked(&mut self, frame: &Frame) {
        if self.kills.is_empty() {
            return;
        }
        let (drawn, present) = (frame.number, self.displays.present());
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
