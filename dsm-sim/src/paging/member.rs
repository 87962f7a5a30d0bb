//! One node of the cluster: the state machines of `dsm-core`, and around them the smallest correct driver.
//!
//! What the driver of a real system does with system calls is here a task that takes a while. The state machines do not know.

use core::fmt;

use dsm_core::home::{Answer, Home};
use dsm_core::id::{Incarnation, NodeId, PageId, PortId};
use dsm_core::node::{Fault, Node, Output, PageBytes};
use dsm_core::page_state::PageState;
use dsm_core::prefetch::Foretold;
use dsm_core::replacement::Replacement;
use dsm_core::stats::Histogram;
use dsm_core::storage::Storage;
use dsm_core::wire::{Body, HEADER_BYTES, Message, fragment_unit};

use super::config::{Config, MESSAGE_BYTES};
use super::mapping::Mapping;
use super::packet::{Packet, Task};
use super::report::Counts;
use super::stray::{POISON, stray_like};
use super::thread::{Doing, Thread};
use super::workload::{Pattern, contents_of};
use crate::chance::Chance;
use crate::cluster::{Actor, View, stream};
use crate::time::{Moment, us};

type Io<'a> = crate::cluster::Io<'a, Packet, Task>;

/// What all nodes of a world share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) config: Config,
    /// Bytes of a page that a message carries at most.
    pub(super) fragment_bytes: u32,
    pub(super) pattern: Pattern,
}

/// Makes the replacement policy of a node, from its number and a seed.
pub(super) type MakePolicy<'s, R> = dyn Fn(NodeId, u64) -> R + 's;

/// A node, with its threads, its memory and its owner's part.
pub struct Member<'s, R: Replacement> {
    shared: &'s Shared,
    make_policy: std::rc::Rc<MakePolicy<'s, R>>,
    me: NodeId,
    policy_seed: u64,
    /// The state machine; none while the node is down.
    node: Option<Node<'s, R>>,
    /// Its memory while there is none.
    lent: Option<Storage<'s>>,
    home: Home,
    /// The contents of the pages it holds, in the order of their held index.
    held: Vec<u64>,
    mapping: Mapping,
    threads: Vec<Thread>,
    done_threads: usize,
    /// Decides which messages stray.
    chance: Chance,
    timer_at: Moment,
    server_free: Moment,
    /// What earlier incarnations have counted.
    past: Counts,
    latencies: Histogram,
}

impl<'s, R: Replacement> Member<'s, R> {
    pub(super) fn new(
        shared: &'s Shared,
        me: NodeId,
        seed: u64,
        policy_seed: u64,
        lent: Storage<'s>,
        make_policy: std::rc::Rc<MakePolicy<'s, R>>,
    ) -> Self {
        let config = &shared.config;
        let threads = if me.0 < config.renderers { config.threads } else { 0 };
        let chance =
            |thread| Chance::new(seed, stream::ACTORS + u64::from(me.0) * STREAMS + u64::from(thread));
        let node = &config.node;
        let slots = u32::try_from(lent.slots.len()).unwrap_or(u32::MAX);
        Self {
            shared,
            make_policy,
            me,
            policy_seed,
            node: None,
            lent: Some(lent),
            home: Home::new(me, node.cluster, node.epoch, node.placement, node.page_bytes),
            held: node
                .placement
                .held_stripes_of(me)
                .flatten()
                .map(|page| contents_of(PageId(page)))
                .collect(),
            mapping: Mapping::new(&node.placement, me, slots, node.fragments),
            threads: (0..threads).map(|thread| Thread::new(chance(thread))).collect(),
            done_threads: 0,
            chance: chance(u8::MAX),
            timer_at: Moment::NEVER,
            server_free: Moment::ZERO,
            past: Counts::default(),
            latencies: Histogram::EMPTY,
        }
    }

    /// This node's number.
    pub const fn me(&self) -> NodeId {
        self.me
    }

    /// Its state machine, or `None` while it is down.
    pub const fn node(&self) -> Option<&Node<'s, R>> {
        self.node.as_ref()
    }

    /// What it has counted, earlier incarnations included.
    pub fn counts(&self) -> Counts {
        let mut counts = self.past;
        if let Some(node) = &self.node {
            counts.add(&node.stats(), &self.home.stats());
        }
        counts
    }

    /// The times in nanoseconds from the touch of an absent page to its reading.
    pub const fn latencies(&self) -> &Histogram {
        &self.latencies
    }

    fn touch(&mut self, io: &mut Io<'_>, index: u8) {
        let thread = &mut self.threads[usize::from(index)];
        let number = u32::from(self.me.0) * u32::from(self.shared.config.threads) + u32::from(index);
        let page = self.shared.pattern.page(number, thread.touches, &mut thread.chance);
        (thread.page, thread.touched) = (page, io.now());
        self.past.touches += 1;
        if self.mapping.is_seen(page) {
            self.read(page);
            self.tell_of(page);
            self.think(io, index);
        } else {
            self.threads[usize::from(index)].doing = Doing::Trapped;
            io.work(self.shared.config.costs.trap_ns, Task::Fault { thread: index });
        }
    }

    /// Prefetch lives of knowing what was used.
    fn tell_of(&mut self, page: PageId) {
        if self.shared.config.node.neighbours_max > 0
            && let Some(node) = &mut self.node
        {
            node.handle_reference(page);
        }
    }

    /// Asks for pages that follow `page`, which was missed, as far as there is room for them now. Room that has to be made
    /// is for those of the next miss.
    fn bring_neighbours(&mut self, io: &mut Io<'_>, page: PageId, port: PortId) {
        let now = io.clock();
        let Some(node) = &mut self.node else { return };
        let count = node.handle_neighbour_wish(now, page);
        let _ = self.drain(io, 0);
        for next in (1..=count).map(|step| PageId(page.0 + step)) {
            if let Some(node) = &mut self.node {
                node.handle_prefetch(now, next, port, Foretold::ByNeighbour);
            }
            let _ = self.drain(io, 0);
        }
    }

    fn read(&self, page: PageId) {
        if let Some(node) = &self.node {
            self.mapping.read(page, node.table().slot(page));
        }
    }

    /// A touch has ended; the next one comes after a while.
    fn think(&mut self, io: &mut Io<'_>, index: u8) {
        let thread = &mut self.threads[usize::from(index)];
        thread.touches += 1;
        thread.wait += 1;
        if thread.touches >= self.shared.config.touches {
            thread.doing = Doing::Done;
            self.done_threads += 1;
            return;
        }
        thread.doing = Doing::Thinking;
        let ns = thread.chance.tail(self.shared.config.think_ns);
        io.work(ns, Task::Touch { thread: index });
    }

    /// A thread tells the state machine of its fault, for the first time or again, and does what it is told.
    fn fault(&mut self, io: &mut Io<'_>, index: u8, is_first: bool) {
        let Some(node) = &mut self.node else { return };
        let thread = &mut self.threads[usize::from(index)];
        let (now, page, port) = (io.clock(), thread.page, PortId(index));
        let answer = if is_first {
            thread.since = now;
            node.handle_fault(now, page, port)
        } else {
            node.handle_fault_again(now, page, port, thread.since)
        };
        thread.wait += 1;
        let wait = thread.wait;
        let victims = self.drain(io, 0);
        let is_on_its_way = self.is_on_its_way(page);
        let thread = &mut self.threads[usize::from(index)];
        match answer {
            Fault::Fetch | Fault::Show if is_on_its_way => {
                thread.doing = Doing::Fetching;
                if answer == Fault::Fetch {
                    self.bring_neighbours(io, page, port);
                }
            }
            // It has failed already: nobody who holds it is alive.
            Fault::Fetch | Fault::Show => self.fault(io, index, false),
            Fault::Wait => thread.doing = Doing::WaitingForPage,
            Fault::Full => {
                thread.doing = if victims > 0 { Doing::Evicting } else { Doing::WaitingForSlot };
                // This wait is a timed one: at its deadline the thread asks again and is told that it failed.
                let deadline = thread.since.after(self.shared.config.node.deadline_us);
                io.at_clock(deadline, Task::Again { thread: index, wait });
            }
            Fault::Ready => {
                self.latencies.record(io.now().since(thread.touched));
                let is_seen = self.mapping.is_seen(page);
                assert!(is_seen, "RIGHT_PAGE: a thread was told to go on, and {page} is not there");
                self.read(page);
                self.think(io, index);
            }
            Fault::Failed(_) => {
                self.past.failed_touches += 1;
                self.think(io, index);
            }
        }
    }

    /// Does what the state machine wants done, and tells how many victims are among it. `contents` came with the
    /// message it was given last.
    fn drain(&mut self, io: &mut Io<'_>, contents: u64) -> u32 {
        let costs = self.shared.config.costs;
        let page_bytes = self.shared.config.node.page_bytes;
        let mut header = [0; HEADER_BYTES];
        let mut victims = 0;
        loop {
            let Some(node) = &mut self.node else { return victims };
            match node.poll(&mut header) {
                Output::Transmit { to, .. } => io.send(to, MESSAGE_BYTES, Packet { header, contents: 0 }),
                Output::Store { page, slot, offset, bytes } => {
                    self.mapping.store(page, slot, offset, bytes, fragment_unit(page_bytes), contents);
                }
                Output::Map { page, slot, bytes } => {
                    let contents = match bytes {
                        PageBytes::InMessage => contents,
                        PageBytes::Stored => self.mapping.gather(page, slot, page_bytes),
                        PageBytes::Kept => self.mapping.kept(page, slot),
                    };
                    io.work(costs.fill_ns, Task::Filled { page, slot, contents });
                }
                Output::Unmap { page, slot } => {
                    victims += 1;
                    io.work(costs.unmap_ns * u64::from(victims), Task::Unmapped { page, slot });
                }
                Output::Hide { page, slot } => io.work(costs.unmap_ns, Task::Covered { page, slot }),
                Output::WakePage { page } => {
                    let is_meant =
                        |thread: &Thread| thread.doing == Doing::WaitingForPage && thread.page == page;
                    self.call(io, costs.wake_ns, is_meant);
                }
                Output::WakeSlots => {
                    self.call(io, 0, |thread| thread.doing == Doing::Evicting);
                    self.call(io, costs.wake_ns, |thread| thread.doing == Doing::WaitingForSlot);
                }
                Output::Idle(deadline) => {
                    if let Some(deadline) = deadline {
                        self.set_timer(io, io.moment_of(deadline));
                    }
                    return victims;
                }
            }
        }
    }

    /// Has threads ask again, after the time it takes to wake them.
    fn call(&mut self, io: &mut Io<'_>, wake_ns: u64, is_meant: impl Fn(&Thread) -> bool) {
        for (index, thread) in (0..).zip(&mut self.threads) {
            if is_meant(thread) {
                thread.doing = Doing::Called;
                thread.wait += 1;
                io.work(wake_ns, Task::Again { thread: index, wait: thread.wait });
            }
        }
    }

    /// Threads that fetch look for themselves whether their page came or failed; nobody wakes them.
    fn look_after_fetchers(&mut self, io: &mut Io<'_>) {
        for index in (0..).take(self.threads.len()) {
            let Thread { doing, page, .. } = self.threads[usize::from(index)];
            if doing == Doing::Fetching && !self.is_on_its_way(page) {
                self.fault(io, index, false);
            }
        }
    }

    fn is_on_its_way(&self, page: PageId) -> bool {
        let state = self.node.as_ref().and_then(|node| node.table().state(page));
        matches!(state, Some(PageState::Requested | PageState::Filling))
    }

    fn set_timer(&mut self, io: &mut Io<'_>, at: Moment) {
        let at = at.max(io.now());
        if at < self.timer_at {
            self.timer_at = at;
            io.at(at, Task::Timer { at });
        }
    }

    fn look_after_requests(&mut self, io: &mut Io<'_>) {
        self.timer_at = Moment::NEVER;
        for port in (0..).map(PortId).take(self.threads.len()) {
            if let Some(node) = &mut self.node {
                node.handle_timeout(io.clock(), port);
            }
            let _ = self.drain(io, 0);
        }
        self.look_after_fetchers(io);
    }

    /// Takes a request in: the owner's part answers one after the other.
    fn queue_request(&mut self, io: &mut Io<'_>, packet: Packet) {
        let ns = io.time_of_work(self.shared.config.costs.serve_ns);
        if ns == 0 {
            return self.serve(io, packet);
        }
        self.server_free = self.server_free.max(io.now()).after(ns);
        io.at(self.server_free, Task::Serve { packet });
    }

    fn serve(&mut self, io: &mut Io<'_>, packet: Packet) {
        let (message, contents) = match self.home.handle_message(&packet.header) {
            Ok(Answer::Grant { message, held_index }) => (message, self.held[held_index as usize]),
            Ok(Answer::Refuse { message }) => (message, 0),
            Err(_) => return,
        };
        for part in message.fragments(self.shared.fragment_bytes) {
            self.let_stray(io, &part);
            send(io, &part, contents);
        }
    }

    /// By chance, sends a message that looks like this answer and must not be believed.
    fn let_stray(&mut self, io: &mut Io<'_>, answer: &Message) {
        let config = &self.shared.config;
        if self.chance.happens(config.strays_ppm) {
            let holds = |node| config.node.placement.holds(node, answer.page);
            if let Some(stray) = stray_like(answer, config.nodes, holds, &mut self.chance) {
                send(io, &stray, POISON);
            }
        }
    }
}

/// Sends an answer, with what stands for the bytes behind it.
fn send(io: &mut Io<'_>, message: &Message, contents: u64) {
    let mut header = [0; HEADER_BYTES];
    message.emit(&mut header);
    let bytes = match message.body {
        Body::Grant { bytes, .. } => bytes,
        Body::Request { .. } | Body::Refusal(_) => 0,
    };
    io.send(message.to, MESSAGE_BYTES + bytes, Packet { header, contents });
}

impl<R: Replacement> Actor for Member<'_, R> {
    type Message = Packet;
    type Task = Task;

    fn handle_start(&mut self, io: &mut Io<'_>) {
        let Some(lent) = self.lent.take() else { return };
        let incarnation = Incarnation(io.incarnation() - 1);
        let config = dsm_core::node::Config { me: self.me, incarnation, ..self.shared.config.node };
        self.home = Home::new(self.me, config.cluster, config.epoch, config.placement, config.page_bytes)
            .in_incarnation(incarnation);
        let policy = (self.make_policy)(self.me, self.policy_seed ^ u64::from(io.incarnation()));
        // The world has tried this configuration before it made its members.
        let Ok(node) = Node::new(config, lent, policy) else { return };
        self.node = Some(node);
        (self.timer_at, self.server_free) = (Moment::NEVER, io.now());
        for (index, thread) in (0..).zip(&mut self.threads) {
            if !thread.is_done() {
                thread.doing = Doing::Thinking;
                let ns = thread.chance.tail(self.shared.config.think_ns);
                io.work(ns, Task::Touch { thread: index });
            }
        }
    }

    fn handle_message(&mut self, io: &mut Io<'_>, _from: NodeId, packet: Packet) {
        if let Ok(Message { body: Body::Request { .. }, .. }) = Message::parse(&packet.header) {
            return self.queue_request(io, packet);
        }
        let Some(node) = &mut self.node else { return };
        // What is refused is counted by the node. It may still be a sign of life that makes requests due.
        let _ = node.handle_message(io.clock(), &packet.header);
        let _ = self.drain(io, packet.contents);
        self.look_after_fetchers(io);
    }

    fn handle_task(&mut self, io: &mut Io<'_>, task: Task) {
        match task {
            Task::Touch { thread } => self.touch(io, thread),
            Task::Fault { thread } => self.fault(io, thread, true),
            Task::Again { thread, wait } => {
                if self.threads[usize::from(thread)].wait == wait {
                    self.fault(io, thread, false);
                }
            }
            Task::Filled { page, slot, contents } => {
                let Some(node) = &mut self.node else { return };
                self.mapping.map(page, slot, contents);
                node.handle_filled(io.clock(), page);
                let _ = self.drain(io, 0);
                self.look_after_fetchers(io);
            }
            Task::Unmapped { page, slot } => {
                let Some(node) = &mut self.node else { return };
                self.mapping.unmap(page, slot);
                node.handle_unmapped(io.clock(), page);
                let _ = self.drain(io, 0);
            }
            Task::Covered { page, slot } => {
                let Some(node) = &mut self.node else { return };
                self.mapping.hide(page, slot);
                node.handle_covered(io.clock(), page);
                let _ = self.drain(io, 0);
            }
            Task::Timer { at } if at == self.timer_at => self.look_after_requests(io),
            Task::Timer { .. } => {}
            Task::Serve { packet } => self.serve(io, packet),
        }
    }

    fn handle_crash(&mut self) {
        if let Some(node) = self.node.take() {
            self.past.add(&node.stats(), &self.home.stats());
            self.lent = Some(node.into_storage());
        }
        self.mapping.clear();
        for thread in &mut self.threads {
            thread.wait += 1;
        }
    }

    fn handle_peer_down(&mut self, io: &mut Io<'_>, peer: NodeId) {
        let Some(node) = &mut self.node else { return };
        node.handle_peer_down(io.clock(), peer);
        // What was asked of it is due now.
        let _ = self.drain(io, 0);
    }

    fn is_done(&self) -> bool {
        self.done_threads == self.threads.len()
    }

    fn check_invariants(&self, view: View) {
        let Some(node) = &self.node else { return };
        node.check_invariants();
        self.mapping.check_invariants(|page| node.table().slot(page));
        let longest_ns = us(self.shared.config.node.deadline_us) * 2 + SLACK_NS + view.grace_ns;
        for thread in self.threads.iter().filter(|thread| thread.is_waiting()) {
            let waited_ns = view.now.since(thread.touched);
            assert!(
                waited_ns <= longest_ns,
                "NO_LOST_WAITER: a thread of {} has waited {} us for {}",
                self.me,
                waited_ns / 1_000,
                thread.page
            );
        }
    }
}

impl<R: Replacement> fmt::Debug for Member<'_, R> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Member")
            .field("me", &self.me)
            .field("node", &self.node)
            .field("threads", &self.threads)
            .finish_non_exhaustive()
    }
}

/// Streams of chance for each node: one for each thread that there can be, and one for the node.
const STREAMS: u64 = 256;

/// What a wait may last beyond its deadline because work takes time.
const SLACK_NS: u64 = us(100_000);
