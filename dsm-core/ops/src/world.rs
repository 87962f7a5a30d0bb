//! A cluster, its network, and the operations on them.

use dsm_core::home::{Answer, HomeError};
use dsm_core::id::{Epoch, Incarnation, NodeId, PageId};
use dsm_core::node::{Config, Fault};
use dsm_core::page_state::PageState;
use dsm_core::placement::Stripes;
use dsm_core::replacement::PolicyKind;
use dsm_core::stats::NodeStats;
use dsm_core::time::Instant;
use dsm_core::wire::{Body, HEADER_BYTES, Message};

use crate::member::{Member, Thread, Wait, Work, port};
use crate::op::{Op, Stray};
use crate::oracle::{self, carried, holds};

/// What a cluster is made of.
#[derive(Clone, Copy, Debug)]
pub struct Setup {
    /// Nodes, of which the last `owners` own the pages.
    pub nodes: u8,
    /// Nodes that own pages.
    pub owners: u8,
    /// Pages of the address space.
    pub pages: u8,
    /// Pages of a stripe.
    pub stripe_pages: u8,
    /// Copies of each page.
    pub replicas: u8,
    /// Threads of each node.
    pub threads: u8,
    /// Slots of each node.
    pub slots: u8,
    /// Requests that a node can have under way.
    pub requests: u8,
    /// Which page has to leave.
    pub policy: PolicyKind,
    /// See [`Config::evict_batch`].
    pub evict_batch: u8,
    /// See [`Config::evict_ahead`].
    pub evict_ahead: u8,
    /// See [`Config::hidden_max`]; less than the slots.
    pub hidden: u8,
    /// Parts in which pages travel; 1 for whole pages.
    pub fragments: u8,
    /// Sendings to one copy before the next is asked.
    pub tries: u8,
    /// All timeouts are the same, whatever has been measured: a model stays finite.
    pub is_rigid: bool,
    /// Peers die of silence alone before a fault is given up, else after.
    pub buries_early: bool,
}

/// A cluster and its network.
#[derive(Clone, Debug)]
pub struct World {
    pub(crate) setup: Setup,
    pub(crate) now: Instant,
    pub(crate) members: Vec<Member>,
    pub(crate) under_way: Vec<Packet>,
    /// Faults that were answered with their page.
    pub served: u64,
    /// Faults that were not.
    pub failed: u64,
    /// What nodes had counted when they ended.
    ended: Tally,
}

/// What a run has come by: to see that it has come by everything.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(missing_docs, reason = "each is the count of that name in `NodeStats`, over all nodes")]
pub struct Tally {
    pub faults: u64,
    pub fetched_pages: u64,
    pub evicted_pages: u64,
    pub resends: u64,
    pub failovers: u64,
    pub fragments: u64,
    pub dead_peers: u64,
    pub late_answers: u64,
    pub refused_messages: u64,
    pub restarts: u64,
}

/// A message under way.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Packet {
    pub(crate) header: [u8; HEADER_BYTES],
    /// The page whose bytes follow; `None` for no bytes, or for bytes that nobody vouches for.
    pub(crate) page: Option<u32>,
}

/// Reads of pages from this number on ask for them ahead.
const AHEAD: u8 = 192;

/// Length of a page. Real ones are longer; what matters is that there are units to be cut into.
pub(crate) const PAGE_BYTES: u32 = 64;

const RESEND_US: u64 = 1_000;
const DEADLINE_US: u64 = 20_000;

/// In a model every moment counts, for each makes other states.
const RIGID_DEADLINE_US: u64 = 8 * RESEND_US;

/// Runs `ops` on a cluster, with everything checked after each, then lets it come to rest and reads what can be had.
///
/// # Panics
/// When an invariant does not hold; the message names it.
pub fn run(setup: Setup, ops: impl IntoIterator<Item = Op>) -> World {
    let mut world = World::new(setup);
    for op in ops {
        world.apply(op);
    }
    world.come_to_rest();
    world.read_all_that_live();
    world
}

/// Runs the operations that `bytes` stand for on the cluster that their first bytes stand for: the fuzzer's way in.
///
/// # Panics
/// When an invariant does not hold; the message names it.
pub fn run_bytes(bytes: &[u8]) {
    if let Some((setup, ops)) = bytes.split_first_chunk::<{ Setup::BYTES }>() {
        run(Setup::from_bytes(*setup), Op::list_from_bytes(ops));
    }
}

impl Setup {
    /// Bytes that a set-up is made of.
    pub const BYTES: usize = 4;

    /// The set-up that these bytes stand for. All bytes stand for one.
    #[must_use]
    pub fn from_bytes([cluster, node, asking, parts]: [u8; Self::BYTES]) -> Self {
        let policies = PolicyKind::ALL;
        Self {
            nodes: 3 + cluster % 2,
            replicas: 1 + cluster / 2 % 3,
            stripe_pages: 1 + cluster / 6 % 3,
            slots: 1 + node % 4,
            hidden: (node / 24 % 4).min(node % 4),
            policy: policies[usize::from(node / 4) % policies.len()],
            evict_batch: 1 + asking % 3,
            evict_ahead: asking / 3 % 3,
            requests: 1 + asking / 9 % 4,
            tries: 1 + parts % 3,
            fragments: [1, 4, 32][usize::from(parts / 3) % 3],
            buries_early: parts / 9 % 2 == 0,
            ..Self::SMALL
        }
    }

    /// Three nodes of two threads, all of which own pages, with two copies of each.
    pub const SMALL: Self = Self {
        nodes: 3,
        owners: 3,
        pages: 9,
        stripe_pages: 2,
        replicas: 2,
        threads: 2,
        slots: 2,
        requests: 4,
        policy: PolicyKind::Fifo,
        evict_batch: 1,
        evict_ahead: 0,
        hidden: 0,
        fragments: 1,
        tries: 2,
        is_rigid: false,
        buries_early: true,
    };

    pub(crate) const fn deadline_us(&self) -> u64 {
        if self.is_rigid { RIGID_DEADLINE_US } else { DEADLINE_US }
    }

    /// The configuration of one node.
    pub(crate) fn config(&self, me: NodeId, incarnation: Incarnation) -> Config {
        let first_owner = NodeId(u16::from(self.nodes - self.owners));
        let stripes =
            Stripes::new(self.pages.into(), self.stripe_pages.into(), first_owner, self.owners.into());
        let placement = stripes.and_then(|stripes| stripes.with_replicas(self.replicas));
        let placement = placement.expect("the set-up is consistent");
        Config {
            epoch: Epoch(3),
            incarnation,
            evict_batch: self.evict_batch.into(),
            evict_ahead: self.evict_ahead.into(),
            hidden_max: self.hidden.into(),
            fragments: self.fragments > 1,
            resend_us: RESEND_US,
            resend_us_min: RESEND_US,
            resend_us_max: if self.is_rigid { RESEND_US } else { DEADLINE_US },
            tries: self.tries,
            suspect_after_us: 2 * RESEND_US,
            dead_after_us: if self.buries_early { self.deadline_us() / 2 } else { self.deadline_us() * 2 },
            deadline_us: self.deadline_us(),
            ..Config::new(me, placement, PAGE_BYTES)
        }
    }
}

impl World {
    /// A cluster in which nothing has happened.
    ///
    /// # Panics
    /// When the set-up contradicts itself.
    #[must_use]
    pub fn new(setup: Setup) -> Self {
        let members = (0..setup.nodes).map(|node| Member::new(&setup, NodeId(node.into()), Incarnation(0)));
        Self {
            setup,
            // Clocks may jump back; the world begins late enough for that.
            now: Instant::from_micros(1_000_000),
            members: members.collect(),
            under_way: Vec::new(),
            served: 0,
            failed: 0,
            ended: Tally::default(),
        }
    }

    /// Lets one thing happen, and checks what must hold after it.
    ///
    /// # Panics
    /// When an invariant does not hold; the message names it.
    pub fn apply(&mut self, op: Op) {
        let node_of = |node: u8| usize::from(node % self.setup.nodes);
        match op {
            Op::Read { node, thread, page } => {
                let (node, thread) = (node_of(node), usize::from(thread % self.setup.threads));
                let is_ahead = page >= AHEAD;
                let page = PageId(u32::from(page % self.setup.pages));
                if self.members[node].is_alive && self.members[node].threads[thread] == Thread::Running {
                    if is_ahead {
                        self.prefetch(node, thread, page);
                    } else {
                        self.fault(node, thread, page, None);
                    }
                }
            }
            Op::Deliver(index) => {
                if let Some(index) = pick(index, self.under_way.len()) {
                    let packet = self.under_way.remove(index);
                    self.deliver(&packet);
                }
            }
            Op::Drop(index) => {
                if let Some(index) = pick(index, self.under_way.len()) {
                    self.under_way.remove(index);
                }
            }
            Op::Duplicate(index) => {
                if let Some(index) = pick(index, self.under_way.len()) {
                    self.deliver(&self.under_way[index].clone());
                }
            }
            Op::Finish { node, work } => self.finish(node_of(node), work),
            Op::Advance { us } => self.advance(u64::from(us)),
            Op::Timer { node, thread } => self.fire(node_of(node), usize::from(thread % self.setup.threads)),
            Op::Jump { node, ms } => self.jump(node_of(node), ms),
            Op::Crash(node) => self.crash(node_of(node)),
            Op::Restart(node) => self.restart(node_of(node)),
            Op::TellDown { node, of } => self.tell_down(node_of(node), node_of(of)),
            Op::TellHeard { node, of } => self.tell_heard(node_of(node), node_of(of)),
            Op::Stray { message, how } => {
                if let Some(index) = pick(message, self.under_way.len())
                    && let Some(packet) = self.stray(&self.under_way[index], how)
                {
                    self.deliver(&packet);
                }
            }
            Op::Corrupt { message, byte, xor } => {
                if let Some(index) = pick(message, self.under_way.len()) {
                    // A changed number or page can still make a believable message; its bytes count as right.
                    let mut packet = Packet { page: None, ..self.under_way[index].clone() };
                    packet.header[usize::from(byte) % HEADER_BYTES] ^= xor;
                    self.deliver(&packet);
                }
            }
        }
        self.check();
    }

    /// What can happen now and is not a repetition of something else in this list, as a model checker wants it. Losses,
    /// crashes and the like are left to the caller, who knows how many there are to be.
    #[must_use]
    pub fn enabled(&self) -> Vec<Op> {
        let mut ops = Vec::new();
        let small = |index: usize| u8::try_from(index).unwrap_or(u8::MAX);
        ops.extend((0..self.under_way.len()).map(|index| Op::Deliver(small(index))));
        for (node, member) in self.members.iter().enumerate().filter(|(_, member)| member.is_alive) {
            let node = small(node);
            ops.extend((0..member.work.len()).map(|work| Op::Finish { node, work: small(work) }));
            for (thread, _) in
                member.threads.iter().enumerate().filter(|(_, state)| **state == Thread::Running)
            {
                let foreign = (0..self.setup.pages).filter(|page| !member.memory.contains(&u32::from(*page)));
                ops.extend(foreign.map(|page| Op::Read { node, thread: small(thread), page }));
            }
        }
        ops
    }

    /// The timers that could go off, with whether something is still on its way that would make them go off in vain.
    #[must_use]
    pub fn timers(&self) -> Vec<(Op, bool)> {
        let mut timers = Vec::new();
        for (index, member) in self.members.iter().enumerate().filter(|(_, member)| member.is_alive) {
            for (thread, state) in member.threads.iter().enumerate() {
                let Thread::Fetching(wait) = state else { continue };
                let is_early = self.is_under_way(index, wait.page);
                let (node, thread) = (u8::try_from(index), u8::try_from(thread));
                if let (Ok(node), Ok(thread)) = (node, thread) {
                    timers.push((Op::Timer { node, thread }, is_early));
                }
            }
        }
        timers
    }

    /// Whether a request or an answer about `page` is under way that can still reach its end, or the page is here already.
    fn is_under_way(&self, node: usize, page: PageId) -> bool {
        let is_of = |packet: &Packet| {
            let Some(message) = packet.message() else { return false };
            let (asker, owner) = asker_and_owner(&message);
            let arrives = matches!(message.body, Body::Grant { .. } | Body::Refusal(_))
                || self.members.get(owner.index()).is_some_and(|member| member.is_alive);
            asker.index() == node && message.page == page && arrives && self.is_current(&message)
        };
        self.members[node].is_filling(page) || self.under_way.iter().any(is_of)
    }

    /// Whether a message belongs to a request that is under way.
    pub(crate) fn is_current(&self, message: &Message) -> bool {
        let (asker, _) = asker_and_owner(message);
        let incarnation = match message.body {
            Body::Request { .. } => message.from_incarnation,
            Body::Grant { .. } | Body::Refusal(_) => message.to_incarnation,
        };
        self.members.get(asker.index()).is_some_and(|member| {
            let number = member.oracle.asked.get(&message.page.0).map(|asked| asked.number);
            let waits = member
                .threads
                .iter()
                .any(|thread| matches!(thread, Thread::Fetching(wait) if wait.page == message.page));
            member.incarnation == incarnation && number == Some(message.request) && waits
        })
    }

    /// Whether nothing more will happen by itself.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        let rests = |member: &Member| {
            !member.is_alive || member.work.is_empty() && member.threads.iter().all(|t| *t == Thread::Running)
        };
        self.under_way.is_empty() && self.members.iter().all(rests)
    }

    /// Whether a node is alive.
    #[must_use]
    pub fn is_alive(&self, node: u8) -> bool {
        self.members[usize::from(node)].is_alive
    }

    /// Messages under way.
    #[must_use]
    pub fn message_count(&self) -> usize {
        self.under_way.len()
    }

    /// What has been counted by all nodes.
    #[must_use]
    pub fn tally(&self) -> Tally {
        let mut tally = self.ended;
        self.members.iter().for_each(|member| tally.add(member.stats()));
        tally
    }

    /// Delivers everything, finishes all work and lets time pass until nobody waits.
    fn come_to_rest(&mut self) {
        for _ in 0..1_000 {
            while let Some(packet) = self.under_way.pop() {
                self.deliver(&packet);
                self.check();
            }
            for node in 0..self.members.len() {
                while !self.members[node].work.is_empty() {
                    self.finish(node, 0);
                    self.check();
                }
            }
            if self.is_at_rest() {
                return;
            }
            if self.under_way.is_empty() {
                self.advance(RESEND_US - 3);
                self.check();
            }
        }
        panic!("NO_LOST_WAITER: a thread waits for ever");
    }

    /// Reads every page that has a live copy on every live node: `SURVIVES`.
    fn read_all_that_live(&mut self) {
        for node in 0..self.members.len() {
            for page in (0..u32::from(self.setup.pages)).map(PageId) {
                if self.members[node].is_alive && self.can_be_had(node, page) {
                    let failed = self.failed;
                    self.fault(node, 0, page, None);
                    self.come_to_rest();
                    assert_eq!(
                        self.failed, failed,
                        "SURVIVES: node {node} cannot have {page}, which has a live copy"
                    );
                }
            }
        }
    }

    /// Whether some live node holds `page`, of which this one does not think as dead, and the page has not failed here.
    fn can_be_had(&mut self, node: usize, page: PageId) -> bool {
        let owners: Vec<NodeId> = self.members[node].config.placement.holders(page).as_slice().to_vec();
        let believes = owners.iter().any(|owner| {
            let Member { is_alive, incarnation, .. } = self.members[owner.index()];
            is_alive && self.members[node].oracle.asks(*owner, incarnation)
        });
        believes && self.members[node].with_node(|node| node.table().state(page) != Some(PageState::Failed))
    }

    fn fault(&mut self, node: usize, thread: usize, page: PageId, again: Option<Wait>) {
        let world_now = self.now;
        let member = &mut self.members[node];
        let now = member.time(world_now);
        let (answer, sent, woken) = member.input(None, |node| match again {
            None => node.handle_fault(now, page, port(thread)),
            Some(wait) => node.handle_fault_again(now, page, port(thread), wait.since),
        });
        match answer {
            Fault::Ready => self.served += 1,
            Fault::Failed(_) => self.failed += 1,
            Fault::Fetch | Fault::Show | Fault::Wait | Fault::Full => {}
        }
        let wait = again.unwrap_or(Wait { page, since: now, world_since: world_now });
        member.settle(thread, answer, wait);
        self.carry_out(node, sent, woken);
    }

    /// A thread asks for a page before it touches it, and waits for it, if it may.
    fn prefetch(&mut self, node: usize, thread: usize, page: PageId) {
        let world_now = self.now;
        let now = self.members[node].time(world_now);
        let (_, sent, woken) = self.members[node].input(None, |node| node.handle_prefetch_wish(now, 1));
        self.carry_out(node, sent, woken);
        let member = &mut self.members[node];
        let (is_asked, sent, woken) =
            member.input(None, |node| node.handle_prefetch(now, page, port(thread)));
        if is_asked {
            member.threads[thread] = Thread::Fetching(Wait { page, since: now, world_since: world_now });
        }
        self.carry_out(node, sent, woken);
    }

    /// Does what an input has caused: sends, and lets the woken ask again.
    fn carry_out(&mut self, node: usize, sent: Vec<Packet>, woken: Vec<usize>) {
        let (member, now) = (&mut self.members[node], self.now);
        for message in sent.iter().filter_map(Packet::message) {
            member.oracle.note_request(&message);
        }
        if let Some(message) = sent.last().and_then(Packet::message) {
            let thread = member
                .threads
                .iter()
                .position(|thread| matches!(thread, Thread::Fetching(wait) if wait.page == message.page));
            // The deadline may come before the next sending; then it is not known when that would be.
            if let Some(thread) = thread
                && let Some(wait) = member.threads[thread].wait()
                && let Some(next) = member.next_timer(thread)
                && next.since(wait.world_since) + 1 < DEADLINE_US
                && member.slack_us == 0
                && !self.setup.is_rigid
            {
                let left_us = DEADLINE_US.saturating_sub(now.since(wait.world_since));
                let round = u64::from(self.setup.replicas) * u64::from(self.setup.tries);
                member.oracle.note_interval(message.page, next.since(now), left_us / (round + 1));
            }
        }
        self.under_way.extend(sent);
        self.look_again(node, &woken);
        // A thread that fetches goes on when its page is there, or has failed.
        let member = &mut self.members[node];
        let fetching = member.waiting(|thread| matches!(thread, Thread::Fetching(_)));
        let done = fetching.into_iter().filter(|thread| {
            let page = member.threads[*thread].wait().map_or(PageId(u32::MAX), |wait| wait.page);
            let state = member.with_node(|node| node.table().state(page));
            state != Some(PageState::Requested) && !member.is_filling(page)
        });
        let done: Vec<usize> = done.collect();
        self.look_again(node, &done);
    }

    /// These threads ask again. Waking one may have changed what the next finds.
    fn look_again(&mut self, node: usize, threads: &[usize]) {
        for thread in threads {
            if let Some(wait) = self.members[node].threads[*thread].wait() {
                self.fault(node, *thread, wait.page, Some(wait));
            }
        }
    }

    fn deliver(&mut self, packet: &Packet) {
        let Some(message) = packet.message() else {
            // Not even a message: whoever gets it counts it.
            let now = self.now;
            let member = &mut self.members[0];
            let time = member.time(now);
            if member.is_alive {
                let _ = member.with_node(|node| node.handle_message(time, &packet.header));
            }
            return;
        };
        let to = message.to.index();
        if !self.members.get(to).is_some_and(|member| member.is_alive) {
            return;
        }
        match message.body {
            Body::Request { .. } => self.deliver_request(to, packet, &message),
            Body::Grant { .. } | Body::Refusal(_) => self.deliver_answer(to, packet, &message),
        }
    }

    fn deliver_request(&mut self, to: usize, packet: &Packet, request: &Message) {
        let member = &mut self.members[to];
        let answer = member.home.handle_message(&packet.header);
        if oracle::must_drop(&member.config, request) {
            assert!(answer.is_err(), "BELIEVES_NO_STRANGER: {to} answers {request:?}");
        }
        match answer {
            Ok(Answer::Grant { message, held_index }) => {
                let page = member.memory.get(held_index as usize).copied().unwrap_or(u32::MAX);
                for message in message.fragments(PAGE_BYTES / u32::from(self.setup.fragments)) {
                    let mut header = [0; HEADER_BYTES];
                    message.emit(&mut header);
                    self.under_way.push(Packet { header, page: Some(page) });
                }
            }
            Ok(Answer::Refuse { message }) => {
                let mut header = [0; HEADER_BYTES];
                message.emit(&mut header);
                self.under_way.push(Packet { header, page: None });
            }
            Err(HomeError::Parse(_)) => unreachable!("it parsed"),
            Err(_) => {}
        }
    }

    fn deliver_answer(&mut self, to: usize, packet: &Packet, message: &Message) {
        let member = &mut self.members[to];
        let now = member.time(self.now);
        let distrust = member.oracle.distrust(&member.config, message);
        let round_trip = |member: &mut Member| member.with_node(|node| node.round_trip_us(message.from));
        let before = round_trip(member);
        let (answer, sent, woken) =
            member.input(Some(packet), |node| node.handle_message(now, &packet.header));
        let is_late = answer == Err(dsm_core::node::MessageError::Late(message.page));
        let is_believed = answer.is_ok() || is_late;
        assert!(
            !is_believed || distrust.is_none(),
            "BELIEVES_NO_STRANGER: {message:?} {}",
            distrust.unwrap_or("")
        );
        if answer.is_ok() {
            member.oracle.check_effect(message);
        }
        if is_believed {
            let after = round_trip(member);
            if after.is_some() && before != after {
                member.oracle.check_measured(message);
            }
            member.oracle.note_heard(message.from, message.from_incarnation);
        }
        if carried(message).is_none() {
            // A refusal leads to another sending at once; its interval is no sign of silence.
            member.oracle.forgive(message.page);
        }
        self.carry_out(to, sent, woken);
    }

    fn finish(&mut self, node: usize, work: u8) {
        let member = &mut self.members[node];
        let Some(index) = pick(work, member.work.len()) else { return };
        let work: Work = member.work.remove(index);
        let now = member.time(self.now);
        let (sent, woken) = member.complete(work, now);
        if let Work::Fill { page, .. } = work {
            // The thread that fetched goes on by itself, before anybody that is woken can have the page evicted again.
            let fetched =
                member.waiting(|thread| matches!(thread, Thread::Fetching(wait) if wait.page == page));
            for thread in fetched {
                member.threads[thread] = Thread::Running;
                self.served += 1;
            }
        }
        self.carry_out(node, sent, woken);
    }

    fn advance(&mut self, us: u64) {
        self.now = self.now.after(us);
        for node in 0..self.members.len() {
            for thread in 0..usize::from(self.setup.threads) {
                self.look_after(node, thread);
            }
        }
    }

    /// The next timer of a thread goes off.
    fn fire(&mut self, node: usize, thread: usize) {
        if !self.members[node].is_alive {
            return;
        }
        if let Some(next) = self.members[node].next_timer(thread) {
            self.now = self.now.max(next);
            self.look_after(node, thread);
        }
    }

    /// A thread looks what time it is.
    fn look_after(&mut self, node: usize, thread: usize) {
        let member = &mut self.members[node];
        if !member.is_alive {
            return;
        }
        let now = member.time(self.now);
        let ((), sent, woken) = member.input(None, |node| node.handle_timeout(now, port(thread)));
        let owners: Vec<NodeId> = member.config.placement.owner_ids().collect();
        let Member { oracle, .. } = member;
        let mut oracle = core::mem::take(oracle);
        member.with_node(|node| oracle.note_silence(node, owners.into_iter()));
        member.oracle = oracle;
        self.carry_out(node, sent, woken);
        // A wait for a slot is a timed one: it looks again now and then, and so finds its own deadline.
        if let Some(Thread::WaitingForSlot(_)) = self.members[node].threads.get(thread) {
            self.look_again(node, &[thread]);
        }
        self.check_deadline(node, thread);
    }

    fn check_deadline(&self, node: usize, thread: usize) {
        let member = &self.members[node];
        if let Thread::Fetching(wait) = member.threads[thread] {
            let waited = self.now.since(wait.world_since);
            let is_late =
                waited > self.setup.deadline_us() + member.slack_us && !member.is_filling(wait.page);
            assert!(!is_late, "NO_LOST_WAITER: {} is asked for {waited} us after its fault", wait.page);
        }
    }

    fn jump(&mut self, node: usize, ms: i8) {
        let member = &mut self.members[node];
        let us = i64::from(ms) * 1000;
        // Far enough from the beginning of time that the clock can jump back again and again.
        if member.is_alive && (member.skew_us + us).abs() < 500_000 {
            member.skew_us += us;
            member.slack_us += us.unsigned_abs();
        }
    }

    fn crash(&mut self, node: usize) {
        let member = &mut self.members[node];
        if member.is_alive {
            member.is_alive = false;
            member.threads.fill(Thread::Running);
            member.work.clear();
        }
    }

    fn restart(&mut self, node: usize) {
        let member = &mut self.members[node];
        if !member.is_alive {
            self.ended.add(member.stats());
            self.ended.restarts += 1;
            let incarnation = Incarnation(member.incarnation.0 + 1);
            *member = Member::new(&self.setup, NodeId(u16::try_from(node).unwrap_or(0)), incarnation);
        }
    }

    fn tell_down(&mut self, node: usize, of: usize) {
        if self.members[of].is_alive || !self.members[node].is_alive {
            return;
        }
        let of = NodeId(u16::try_from(of).unwrap_or(0));
        let member = &mut self.members[node];
        let now = member.time(self.now);
        let ((), sent, woken) = member.input(None, |node| node.handle_peer_down(now, of));
        member.oracle.note_down(of);
        self.carry_out(node, sent, woken);
        self.check_left(node, of);
    }

    /// What was asked of a dead node is due. `DEAD_ARE_LEFT`.
    fn check_left(&mut self, node: usize, dead: NodeId) {
        let now = self.now;
        let member = &mut self.members[node];
        for thread in member.waiting(|thread| matches!(thread, Thread::Fetching(_))) {
            let Some(wait) = member.threads[thread].wait() else { continue };
            let last_to = member.oracle.asked.get(&wait.page.0).map(|asked| asked.last_to);
            let is_requested =
                member.with_node(|node| node.table().state(wait.page)) == Some(PageState::Requested);
            if last_to == Some(dead) && is_requested {
                let next = member.next_timer(thread);
                assert!(
                    next.is_some_and(|next| next <= now),
                    "DEAD_ARE_LEFT: {} is waited for until {next:?}",
                    wait.page
                );
            }
        }
    }

    fn tell_heard(&mut self, node: usize, of: usize) {
        if !self.members[of].is_alive || !self.members[node].is_alive {
            return;
        }
        let incarnation = self.members[of].incarnation;
        let of = NodeId(u16::try_from(of).unwrap_or(0));
        let member = &mut self.members[node];
        let now = member.time(self.now);
        let ((), sent, woken) = member.input(None, |node| node.handle_peer_heard(now, of, incarnation));
        if !member.oracle.is_dead_in(of, incarnation) {
            member.oracle.note_heard(of, incarnation);
        }
        self.carry_out(node, sent, woken);
    }

    /// A copy of a packet that is for somebody else, where there can be such.
    fn stray(&self, packet: &Packet, how: Stray) -> Option<Packet> {
        let mut message = packet.message()?;
        let is_answer = !matches!(message.body, Body::Request { .. });
        match how {
            Stray::Epoch => message.epoch.0 += 1,
            Stray::Cluster => message.cluster.0 += 1,
            Stray::From if is_answer => {
                let placement = self.members.first()?.config.placement;
                let stranger =
                    (0..self.members.len()).filter_map(|node| u16::try_from(node).ok()).map(NodeId);
                message.from = stranger.into_iter().find(|node| !holds(&placement, *node, message.page))?;
            }
            Stray::Incarnation if is_answer => message.to_incarnation.0 += 1,
            Stray::From | Stray::Incarnation => return None,
        }
        let mut header = [0; HEADER_BYTES];
        message.emit(&mut header);
        Some(Packet { header, page: packet.page })
    }

    fn check(&mut self) {
        for member in self.members.iter_mut().filter(|member| member.is_alive) {
            let mut slots: Vec<u32> = member.visible.values().copied().collect();
            slots.sort_unstable();
            let shares = slots.windows(2).any(|pair| pair[0] == pair[1]);
            assert!(!shares, "SLOT_HOLDS_ONE_PAGE: two visible pages share a slot");
            let waits: Vec<Thread> =
                member.threads.iter().filter(|thread| **thread != Thread::Running).copied().collect();
            let is_filling: Vec<bool> = waits
                .iter()
                .map(|thread| thread.wait().is_some_and(|wait| member.is_filling(wait.page)))
                .collect();
            member.with_node(|node| {
                for (thread, is_filling) in waits.iter().zip(is_filling) {
                    match thread {
                        Thread::WaitingForPage(wait) => {
                            let state = node.table().state(wait.page);
                            let is_coming = matches!(
                                state,
                                Some(
                                    PageState::Requested
                                        | PageState::Filling
                                        | PageState::Leaving
                                        | PageState::Hiding
                                )
                            );
                            assert!(is_coming, "NO_LOST_WAITER: for {}, which is {state:?}", wait.page);
                        }
                        Thread::WaitingForSlot(_) => {
                            let is_full = node.table().free_count() == 0
                                || node.request_count() == usize::from(self.setup.requests);
                            assert!(is_full, "NO_LOST_WAITER: for a slot, and one is free");
                        }
                        Thread::Fetching(wait) => {
                            let is_asked = node.table().state(wait.page) == Some(PageState::Requested);
                            assert!(is_asked || is_filling, "NO_LOST_WAITER: nobody fetches {}", wait.page);
                        }
                        Thread::Running => {}
                    }
                }
            });
        }
    }
}

impl Tally {
    /// Both together.
    #[must_use]
    pub const fn plus(self, other: Self) -> Self {
        Self {
            faults: self.faults + other.faults,
            fetched_pages: self.fetched_pages + other.fetched_pages,
            evicted_pages: self.evicted_pages + other.evicted_pages,
            resends: self.resends + other.resends,
            failovers: self.failovers + other.failovers,
            fragments: self.fragments + other.fragments,
            dead_peers: self.dead_peers + other.dead_peers,
            late_answers: self.late_answers + other.late_answers,
            refused_messages: self.refused_messages + other.refused_messages,
            restarts: self.restarts + other.restarts,
        }
    }

    /// Each count with its name.
    #[must_use]
    pub const fn named(&self) -> [(&'static str, u64); 10] {
        [
            ("faults", self.faults),
            ("fetched pages", self.fetched_pages),
            ("evicted pages", self.evicted_pages),
            ("resends", self.resends),
            ("failovers", self.failovers),
            ("fragments", self.fragments),
            ("dead peers", self.dead_peers),
            ("late answers", self.late_answers),
            ("refused messages", self.refused_messages),
            ("restarts", self.restarts),
        ]
    }

    fn add(&mut self, stats: NodeStats) {
        self.faults += stats.faults;
        self.fetched_pages += stats.fetched_pages;
        self.evicted_pages += stats.evicted_pages;
        self.resends += stats.resends;
        self.failovers += stats.failovers;
        self.fragments += stats.fragments;
        self.dead_peers += stats.dead_peers;
        self.late_answers += stats.late_answers;
        self.refused_messages += stats.refused_messages;
    }
}

/// Who asked, and who is asked, in a request or its answer.
pub(crate) fn asker_and_owner(message: &Message) -> (NodeId, NodeId) {
    match message.body {
        Body::Request { .. } => (message.from, message.to),
        Body::Grant { .. } | Body::Refusal(_) => (message.to, message.from),
    }
}

fn pick(index: u8, count: usize) -> Option<usize> {
    usize::from(index).checked_rem(count)
}
