//! A cluster, its network, and the operations on them.

mod checks;

use dsm_core::id::{Incarnation, NodeId, PageId};
use dsm_core::node::{Fault, Node};
use dsm_core::page_state::PageState;
use dsm_core::prefetch::Foretold;
use dsm_core::time::Instant;
use dsm_core::wire::{Body, HEADER_BYTES, Message};

use crate::member::{Member, Thread, Wait, Work, port};
use crate::op::Op;

use crate::packet::{Packet, asker_and_owner};
use crate::setup::{DEADLINE_US, RESEND_US, Setup};
use crate::tally::Tally;

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

/// Reads of pages from this number on ask for them ahead.
const AHEAD: u8 = 192;

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

    /// Pages that idle threads could ask for ahead: what [`enabled`](Self::enabled) leaves out.
    #[must_use]
    pub fn asking_ahead(&self) -> Vec<Op> {
        let ahead = |op: Op| match op {
            Op::Read { node, thread, page } => {
                let number = (AHEAD..=u8::MAX).find(|number| number % self.setup.pages == page)?;
                Some(Op::Read { node, thread, page: number })
            }
            _ => None,
        };
        self.enabled().into_iter().filter_map(ahead).collect()
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
                    let is_asked_ahead = self.state(node, page) == Some(PageState::Requested);
                    self.fault(node, 0, page, None);
                    self.come_to_rest();
                    // Who has left that one without an answer for long enough is dead before anybody asks again.
                    let is_buried = is_asked_ahead && !self.is_trusted(node, page);
                    assert!(
                        self.failed == failed || is_buried,
                        "SURVIVES: node {node} cannot have {page}, which has a live copy"
                    );
                }
            }
        }
    }

    /// Whether some live node holds `page`, of which this one does not think as dead, and the page has not failed here.
    fn can_be_had(&mut self, node: usize, page: PageId) -> bool {
        self.is_trusted(node, page) && self.state(node, page) != Some(PageState::Failed)
    }

    /// Whether some live node holds `page`, of which this one does not think as dead.
    fn is_trusted(&self, node: usize, page: PageId) -> bool {
        let member = &self.members[node];
        member.config.placement.holders(page).as_slice().iter().any(|owner| {
            let Member { is_alive, incarnation, .. } = self.members[owner.index()];
            is_alive && member.oracle.asks(*owner, incarnation)
        })
    }

    fn state(&mut self, node: usize, page: PageId) -> Option<PageState> {
        self.members[node].with_node(|node| node.table().state(page))
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
        let adopted = if answer == Fault::Wait { member.note_missed(page, world_now) } else { None };
        let wait = again.unwrap_or(Wait {
            page,
            since: now,
            world_since: world_now,
            is_ahead: false,
            is_missed: false,
        });
        member.settle(thread, answer, wait);
        if let Some(fetcher) = adopted {
            self.check_adopted(node, fetcher, wait);
        }
        self.carry_out(node, sent, woken);
        if answer == Fault::Fetch {
            self.bring_neighbours(node, thread, page);
        }
    }

    /// A thread has missed a page and asks for some that follow it. It looks after them as after all that left through its
    /// port, and waits for none.
    fn bring_neighbours(&mut self, node: usize, thread: usize, page: PageId) {
        let now = self.members[node].time(self.now);
        let (count, sent, woken) =
            self.members[node].input(None, |node| node.handle_neighbour_wish(now, page));
        self.carry_out(node, sent, woken);
        for next in (1..=count).map(|step| PageId(page.0 + step)) {
            let ask =
                |node: &mut Node<'_>| node.handle_prefetch(now, next, port(thread), Foretold::ByNeighbour);
            let (_, sent, woken) = self.members[node].input(None, ask);
            self.carry_out(node, sent, woken);
        }
    }

    /// A thread asks for a page before it touches it, and waits for it, if it may.
    fn prefetch(&mut self, node: usize, thread: usize, page: PageId) {
        let world_now = self.now;
        let now = self.members[node].time(world_now);
        let (_, sent, woken) = self.members[node].input(None, |node| node.handle_prefetch_wish(now, 1));
        self.carry_out(node, sent, woken);
        let member = &mut self.members[node];
        let (is_asked, sent, woken) =
            member.input(None, |node| node.handle_prefetch(now, page, port(thread), Foretold::ByTile));
        if is_asked {
            member.threads[thread] = Thread::Fetching(Wait {
                page,
                since: now,
                world_since: world_now,
                is_ahead: true,
                is_missed: false,
            });
        }
        self.carry_out(node, sent, woken);
    }

    /// Does what an input has caused: sends, and lets the woken ask again.
    pub(crate) fn carry_out(&mut self, node: usize, sent: Vec<Packet>, woken: Vec<usize>) {
        let (member, now) = (&mut self.members[node], self.now);
        for message in sent.iter().filter_map(Packet::message) {
            member.oracle.note_request(&message, now);
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
                // What it has asked for besides has times of its own.
                && self.setup.neighbours == 0
                && !self.setup.is_rigid
            {
                let left_us = self.setup.patience_us(&wait).saturating_sub(now.since(wait.world_since));
                let round = u64::from(self.setup.replicas) * u64::from(self.setup.tries);
                member.oracle.note_interval(message.page, next.since(now), left_us / (round + 1));
            }
        }
        self.under_way.extend(sent);
        // Who asked ahead is done before somebody that is woken asks for the same page anew.
        let done = self.done_fetching(node, |wait| wait.is_ahead);
        self.look_again(node, &done);
        self.look_again(node, &woken);
        let done = self.done_fetching(node, |_| true);
        self.look_again(node, &done);
    }

    /// Threads that have fetched a page which is there, or has failed.
    fn done_fetching(&mut self, node: usize, which: impl Fn(&Wait) -> bool) -> Vec<usize> {
        let member = &mut self.members[node];
        let fetching = member.waiting(|thread| matches!(thread, Thread::Fetching(wait) if which(wait)));
        let is_done = |thread: &usize| {
            let page = member.threads[*thread].wait().map_or(PageId(u32::MAX), |wait| wait.page);
            let state = member.with_node(|node| node.table().state(page));
            state != Some(PageState::Requested) && !member.is_filling(page)
        };
        fetching.into_iter().filter(is_done).collect()
    }

    /// These threads ask again. Waking one may have changed what the next finds.
    fn look_again(&mut self, node: usize, threads: &[usize]) {
        for thread in threads {
            if let Some(wait) = self.members[node].threads[*thread].wait() {
                if wait.is_ahead {
                    self.members[node].threads[*thread] = Thread::Running;
                    continue;
                }
                self.fault(node, *thread, wait.page, Some(wait));
            }
        }
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
}

fn pick(index: u8, count: usize) -> Option<usize> {
    usize::from(index).checked_rem(count)
}
