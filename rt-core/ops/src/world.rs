//! A cluster, its network, and the operations on them.

mod checks;
mod fingerprint;

use core::hash::Hash;
use std::collections::BTreeMap;

use rt_core::TileId;
use rt_core::schedule::ledger::{self, Arrival};
use rt_core::schedule::message::{Body, MESSAGE_BYTES_MAX};
use rt_core::schedule::worker;
use rt_core::schedule::{Balancer, Ledger, Message, PageMap, Stamp, Worker};

use crate::member::{Member, Memory};
use crate::op::{Op, Stray};
use crate::setup::{EPOCH, RESEND_US, Setup};
use crate::tally::Tally;

/// A cluster and its network.
#[derive(Debug)]
pub struct World<'m> {
    setup: Setup,
    now_us: u64,
    ledger: Ledger<'m>,
    members: Vec<Member<'m>>,
    under_way: Vec<Packet>,
    /// How often each tile of this frame was displayed.
    shown: Vec<u8>,
    /// How often each tile of this frame was begun in each view, as long as that was the display's and the tile missing.
    begun: BTreeMap<(u32, u16), u8>,
    tally: Tally,
}

/// A message under way.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Packet {
    to: u16,
    bytes: Vec<u8>,
}

/// Runs `ops` on a cluster, with everything checked after each, then lets it come to rest and draws one more frame.
///
/// # Panics
/// When an invariant does not hold; the message names it.
pub fn run(setup: Setup, ops: impl IntoIterator<Item = Op>) -> Tally {
    let mut memory = Memory::new(&setup);
    let mut world = World::new(setup, &mut memory);
    for op in ops {
        world.apply(op);
    }
    world.come_to_rest();
    world.apply(Op::NextFrame);
    world.come_to_rest();
    world.tally()
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

impl<'m> World<'m> {
    /// A cluster that has begun its first frame.
    pub fn new(setup: Setup, memory: &'m mut Memory) -> Self {
        let (ledger, storages) = memory.lend();
        let member = |(me, storage)| Member {
            worker: Some(Worker::new(setup.worker(me, 0), storage)),
            storage: None,
            drawing: Vec::new(),
            lives: 0,
        };
        let mut world = Self {
            setup,
            now_us: 0,
            ledger: Ledger::new(setup.ledger(), ledger),
            members: (0..).zip(storages).map(member).collect(),
            under_way: Vec::new(),
            shown: Vec::new(),
            begun: BTreeMap::new(),
            tally: Tally::default(),
        };
        world.begin(1);
        world
    }

    /// Lets one thing happen, and checks what must hold after it.
    ///
    /// # Panics
    /// When an invariant does not hold; the message names it.
    pub fn apply(&mut self, op: Op) {
        self.apply_unchecked(op);
        self.check();
    }

    /// Lets one thing happen of which is known that all holds after it.
    pub fn apply_unchecked(&mut self, op: Op) {
        let node_of = |node: u8| usize::from(node % self.setup.nodes);
        match op {
            Op::Take(node) => self.take(node_of(node)),
            Op::Draw { node, tile, cost } => self.draw(node_of(node), tile, cost),
            Op::Deliver(index) => {
                if let Some(index) = pick(index, self.under_way.len()) {
                    let packet = self.under_way.remove(index);
                    self.deliver(&packet);
                }
            }
            Op::Drop(index) => {
                if let Some(index) = pick(index, self.under_way.len()).filter(|index| self.may_lose(*index)) {
                    self.under_way.remove(index);
                }
            }
            Op::Duplicate(index) => {
                if let Some(index) = pick(index, self.under_way.len()) {
                    self.deliver(&self.under_way[index].clone());
                }
            }
            Op::Timer(who) => self.fire(usize::from(who) % (self.members.len() + 1)),
            Op::Advance { us } => self.advance(u64::from(us)),
            Op::Crash(node) => self.crash(node_of(node)),
            Op::Restart(node) => self.restart(node_of(node)),
            Op::TellDown(node) => self.tell_down(node_of(node)),
            Op::NextFrame => {
                if self.ledger.missing() == 0 {
                    self.begin(self.ledger.stamp().frame + 1);
                }
            }
            Op::Stray { message, how } => {
                if let Some(index) = pick(message, self.under_way.len()) {
                    self.stray(&self.under_way[index].clone(), how);
                }
            }
            Op::Corrupt { message, byte, xor } => {
                if let Some(index) = pick(message, self.under_way.len()) {
                    let mut packet = self.under_way[index].clone();
                    let place = usize::from(byte) % packet.bytes.len();
                    packet.bytes[place] ^= xor;
                    let is_refused = xor == 0 || Message::parse(&packet.bytes).is_err();
                    assert!(is_refused, "BELIEVES_NO_STRANGER: {packet:?} parses");
                }
            }
        }
    }

    /// What can happen now by itself, as a model checker wants it. Losses, crashes and the like are left to the caller, who
    /// knows how many there are to be.
    #[must_use]
    pub fn enabled(&self) -> Vec<Op> {
        let mut ops = Vec::new();
        let small = |index: usize| u8::try_from(index).unwrap_or(u8::MAX);
        ops.extend((0..self.under_way.len()).map(|index| Op::Deliver(small(index))));
        for (node, member) in self.members.iter().enumerate() {
            let node = small(node);
            ops.extend((0..member.drawing.len()).map(|tile| Op::Draw { node, tile: small(tile), cost: 10 }));
            let idle = member.drawing.len() < usize::from(self.setup.threads);
            // A thread that found nothing sleeps until something has come; the first to find nothing begins the search.
            let has_use = |worker: &Worker<'_>| worker.has_queued() || worker.may_ask();
            ops.extend(
                member.worker.as_ref().filter(|worker| idle && has_use(worker)).map(|_| Op::Take(node)),
            );
        }
        ops
    }

    /// The timers that go off next: what is due first, if all messages have arrived.
    #[must_use]
    pub fn timers(&mut self) -> Vec<Op> {
        let Some(first) = self.first_deadline() else { return Vec::new() };
        let mut due = Vec::from_iter(0..=self.members.len());
        due.retain(|who| self.deadline(*who) == Some(first));
        due.into_iter().filter_map(|who| u8::try_from(who).ok()).map(Op::Timer).collect()
    }

    /// Messages under way.
    #[must_use]
    pub fn message_count(&self) -> usize {
        self.under_way.len()
    }

    /// Tiles of this frame that are missing.
    #[must_use]
    pub fn missing(&self) -> u32 {
        self.ledger.missing()
    }

    /// Whether a node is alive, and whether the display believes so.
    #[must_use]
    pub fn is_alive(&self, node: u8) -> (bool, bool) {
        (self.members[usize::from(node)].is_alive(), self.ledger.is_up(node.into()))
    }

    /// What has happened.
    #[must_use]
    pub fn tally(&self) -> Tally {
        let workers = self.members.iter().filter_map(|member| member.worker.as_ref());
        let stolen: u64 = workers.map(|worker| worker.stats().taken).sum();
        Tally { stolen: self.tally.stolen + stolen, ..self.tally }
    }

    /// Of the messages under way one of each kind: which arrives of two that are the same does not matter.
    #[must_use]
    pub fn distinct_messages(&self) -> Vec<u8> {
        let is_first = |index: &usize| {
            let packet = &self.under_way[*index];
            !self.under_way[..*index].contains(packet)
        };
        (0..self.under_way.len()).filter(is_first).filter_map(|index| u8::try_from(index).ok()).collect()
    }

    /// Tells of all deaths, delivers everything, draws everything and lets time pass until the frame is whole and nobody
    /// has anything more to say.
    ///
    /// # Panics
    /// When that does not come.
    pub fn come_to_rest(&mut self) {
        for node in 0..self.members.len() {
            self.tell_down(node);
        }
        if !self.members.iter().any(Member::is_alive) {
            self.restart(0);
        }
        for _ in 0..ROUNDS_MAX {
            self.do_all();
            if self.ledger.missing() == 0 && self.is_at_rest() {
                let is_each = self.shown.iter().all(|shown| *shown == 1);
                assert!(
                    is_each,
                    "EXACTLY_ONCE: of a whole frame tiles were displayed {:?} times",
                    self.shown
                );
                return;
            }
            // A node that lets others have its core first may wait for much longer than for an answer.
            let next_us = self.first_deadline().unwrap_or(0).saturating_sub(self.now_us);
            self.advance(RESEND_US.max(next_us));
            self.check();
        }
        assert_eq!(self.ledger.missing(), 0, "TERMINATES: the frame does not become whole");
        panic!("RESTS: somebody has always more to say");
    }

    /// Delivers and draws until there is nothing left to deliver and nothing to draw.
    fn do_all(&mut self) {
        for _ in 0..STEPS_MAX {
            if let Some(packet) = self.under_way.pop() {
                self.deliver(&packet);
                self.check();
                continue;
            }
            let Some(op) = self.enabled().pop() else { return };
            self.apply(op);
        }
        // The paper's thief asks for ever, as long as somebody answers.
        assert!(self.setup.balancer == Balancer::Steal, "RESTS: a circle");
    }

    /// Whether nobody has anything more to say. The paper's thieves ask until the next frame.
    fn is_at_rest(&mut self) -> bool {
        let is_quiet = self.under_way.is_empty() && self.timers().is_empty();
        is_quiet || self.setup.balancer == Balancer::Steal
    }

    fn begin(&mut self, frame: u32) {
        self.shown = vec![0; self.setup.tiles().count() as usize];
        self.begun.clear();
        self.ledger.begin(frame);
        self.send_ledger();
        self.check();
    }

    fn take(&mut self, node: usize) {
        let (now_us, threads) = (self.now_us, usize::from(self.setup.threads));
        let member = &mut self.members[node];
        let Some(worker) = member.worker.as_mut().filter(|_| member.drawing.len() < threads) else { return };
        if let (Some(tile), Some(stamp)) = (worker.take(now_us), worker.stamp()) {
            member.drawing.push((stamp.frame, tile));
            // A node that has come back may hear of a view that ended with its former life; that one is void.
            if stamp == self.ledger.stamp() && !self.ledger.is_shown(tile) {
                let times = self.begun.entry((tile.0, stamp.view)).or_default();
                *times += 1;
                assert_eq!(*times, 1, "DRAWN_ONCE: {tile:?} is begun twice in {stamp:?}");
            }
        }
        self.send_worker(node);
    }

    fn draw(&mut self, node: usize, tile: u8, cost: u8) {
        let now_us = self.now_us;
        let (display, confirms) = (self.setup.display(), self.setup.confirms);
        let member = &mut self.members[node];
        let Some(index) = pick(tile, member.drawing.len()) else { return };
        let Some(worker) = member.worker.as_mut() else { return };
        let (frame, tile) = member.drawing.remove(index);
        let cost_us = u32::from(cost) * 100;
        let pages = if self.setup.is_pageless { 0..0 } else { tile.0..tile.0 + 2 };
        let map = PageMap::of(pages, self.setup.tiles().count() + 1);
        let is_of_use = worker.handle_drawn(now_us, frame, tile, cost_us, map);
        if is_of_use && !confirms {
            // A way that loses nothing: it arrives, some time.
            let stamp = Stamp { frame, view: 0 };
            let body = Body::Drawn { tile, cost_us };
            let from = u16::try_from(node).unwrap_or(u16::MAX);
            self.push(display, &Message { epoch: EPOCH, stamp, from, to: display, body });
        }
        self.send_worker(node);
    }

    /// Tiles are not lost on a way that loses nothing.
    fn may_lose(&self, index: usize) -> bool {
        let parsed = Message::parse(&self.under_way[index].bytes);
        let is_tile = parsed.is_ok_and(|(message, _)| matches!(message.body, Body::Drawn { .. }));
        self.setup.confirms || !is_tile
    }

    fn deliver(&mut self, packet: &Packet) {
        let (message, _) = Message::parse(&packet.bytes).expect("what was sent parses");
        self.receive(packet.to, &message);
    }

    /// A message reaches a node or the display. Tells whether it was believed.
    fn receive(&mut self, to: u16, message: &Message) -> bool {
        let now_us = self.now_us;
        let believed = if to == self.setup.display() {
            let believed = match message.body {
                Body::Drawn { tile, .. } if message.epoch == EPOCH && message.to == to => {
                    self.arrive(message.from, message.stamp.frame, tile)
                }
                _ => self.ledger.handle_message(message).is_ok(),
            };
            self.send_ledger();
            believed
        } else {
            let Some(worker) = self.members[usize::from(to)].worker.as_mut() else { return false };
            let believed = worker.handle_message(now_us, message).is_ok();
            self.send_worker(to.into());
            believed
        };
        self.tally.refused += u64::from(!believed);
        believed
    }

    fn arrive(&mut self, from: u16, frame: u32, tile: TileId) -> bool {
        match self.ledger.handle_drawn(from, frame, tile) {
            Arrival::First => {
                let shown = &mut self.shown[tile.0 as usize];
                *shown += 1;
                assert_eq!(*shown, 1, "EXACTLY_ONCE: {tile:?} is displayed twice");
                assert_eq!(frame, self.ledger.stamp().frame, "EXACTLY_ONCE: {tile:?} is of another frame");
                self.tally.shown += 1;
                self.tally.frames += u64::from(self.ledger.missing() == 0);
                true
            }
            Arrival::Again => {
                self.tally.again += 1;
                true
            }
            Arrival::Stale => false,
        }
    }

    fn stray(&mut self, packet: &Packet, how: Stray) {
        let (mut message, _) = Message::parse(&packet.bytes).expect("what was sent parses");
        let is_tile = matches!(message.body, Body::Drawn { .. });
        match how {
            Stray::Epoch => message.epoch ^= 1,
            Stray::To => message.to = message.to.wrapping_add(1),
            // A tile is of its frame, whatever the view.
            Stray::View if !is_tile && !matches!(message.body, Body::Deal { .. } | Body::Shown { .. }) => {
                message.stamp.view += 1000;
            }
            Stray::Frame if message.stamp.frame == self.ledger.stamp().frame => message.stamp.frame -= 1,
            Stray::View | Stray::Frame => return,
        }
        if how == Stray::Frame && !is_tile && packet.to != self.setup.display() {
            // A node may not have begun this frame itself.
            let worker = self.members[usize::from(packet.to)].worker.as_ref();
            if worker.and_then(Worker::stamp) != Some(self.ledger.stamp()) {
                return;
            }
        }
        assert!(!self.receive(packet.to, &message), "BELIEVES_NO_STRANGER: {how:?} {message:?}");
    }

    fn fire(&mut self, who: usize) {
        let Some(deadline) = self.deadline(who) else { return };
        self.now_us = deadline.max(self.now_us);
        self.timeout(who, self.now_us);
    }

    fn advance(&mut self, us: u64) {
        self.now_us += us;
        for who in 0..=self.members.len() {
            self.timeout(who, self.now_us);
        }
    }

    fn timeout(&mut self, who: usize, now_us: u64) {
        if who == self.members.len() {
            self.ledger.handle_timeout(now_us);
            self.send_ledger();
        } else if let Some(worker) = self.members[who].worker.as_mut() {
            worker.handle_timeout(now_us);
            self.send_worker(who);
        }
    }

    /// When somebody has something to look after. Asking for it does nothing: all that is due has been sent.
    fn deadline(&mut self, who: usize) -> Option<u64> {
        let mut buffer = [0; MESSAGE_BYTES_MAX];
        if who == self.members.len() {
            return match self.ledger.poll(self.now_us, &mut buffer) {
                ledger::Output::Idle(deadline) => deadline,
                ledger::Output::Transmit { .. } => unreachable!("all that is due has been sent"),
            };
        }
        match self.members[who].worker.as_mut()?.poll(self.now_us, &mut buffer) {
            worker::Output::Idle(deadline) => deadline,
            output => unreachable!("all that is due has been sent, and there is {output:?}"),
        }
    }

    fn first_deadline(&mut self) -> Option<u64> {
        (0..=self.members.len()).filter_map(|who| self.deadline(who)).min()
    }

    fn crash(&mut self, node: usize) {
        let member = &mut self.members[node];
        let Some(worker) = member.worker.take() else { return };
        self.tally.stolen += worker.stats().taken;
        self.tally.crashes += 1;
        member.storage = Some(worker.into_storage());
        member.drawing.clear();
    }

    fn restart(&mut self, node: usize) {
        let me = u16::try_from(node).unwrap_or(u16::MAX);
        let member = &mut self.members[node];
        let Some(storage) = member.storage.take() else { return };
        member.lives += 1;
        member.worker = Some(Worker::new(self.setup.worker(me, member.lives), storage));
        self.tally.restarts += 1;
        self.ledger.handle_up(me);
        self.send_ledger();
        self.tell_peers(me, false);
    }

    fn tell_down(&mut self, node: usize) {
        if self.members[node].is_alive() {
            return;
        }
        let node = u16::try_from(node).unwrap_or(u16::MAX);
        self.tally.dealt_anew += u64::from(self.ledger.handle_down(node));
        self.send_ledger();
        self.tell_peers(node, true);
    }

    fn tell_peers(&mut self, peer: u16, is_down: bool) {
        let workers = self.members.iter_mut().filter_map(|member| member.worker.as_mut());
        workers.for_each(|worker| worker.handle_peer(peer, is_down));
    }

    fn send_worker(&mut self, node: usize) {
        let (display, now_us) = (self.setup.display(), self.now_us);
        let mut buffer = [0; MESSAGE_BYTES_MAX];
        let Some(mut worker) = self.members[node].worker.take() else { return };
        loop {
            match worker.poll(now_us, &mut buffer) {
                worker::Output::Transmit { to, length } => {
                    self.under_way.push(Packet { to, bytes: buffer[..length].to_vec() });
                }
                worker::Output::Deliver { tile } => {
                    let stamp = worker.stamp().expect("what is drawn is of a frame");
                    let from = u16::try_from(node).unwrap_or(u16::MAX);
                    let body = Body::Drawn { tile, cost_us: worker.cost_us(tile) };
                    self.push(display, &Message { epoch: EPOCH, stamp, from, to: display, body });
                }
                worker::Output::Idle(_) => break,
            }
        }
        self.members[node].worker = Some(worker);
    }

    fn send_ledger(&mut self) {
        let mut buffer = [0; MESSAGE_BYTES_MAX];
        while let ledger::Output::Transmit { to, length } = self.ledger.poll(self.now_us, &mut buffer) {
            self.under_way.push(Packet { to, bytes: buffer[..length].to_vec() });
        }
    }

    fn push(&mut self, to: u16, message: &Message) {
        let mut buffer = [0; MESSAGE_BYTES_MAX];
        let length = message.emit(&mut buffer);
        self.under_way.push(Packet { to, bytes: buffer[..length].to_vec() });
    }
}

/// More rounds than any frame needs.
const ROUNDS_MAX: usize = 400;

/// More deliveries and tiles than one round needs.
const STEPS_MAX: usize = 20_000;

fn pick(index: u8, length: usize) -> Option<usize> {
    usize::from(index).checked_rem(length)
}
