//! A node with its threads.

use dsm_core::id::NodeId;
use rt_core::TileId;
use rt_core::schedule::message::{Body, MESSAGE_BYTES_MAX};
use rt_core::schedule::worker::{Output, WorkerConfig};
use rt_core::schedule::{Message, Worker, WorkerStorage};

use super::gather::{Costs, Gather, Outlet};
use super::letters::{HELLO_BYTES, Letter, Letters, Task};
use super::world::Workload;
use crate::cluster::Io;
use crate::time::us;

/// One node: its worker, and the threads that draw.
#[derive(Debug)]
pub(super) struct Node<'m, W> {
    config: WorkerConfig,
    /// `None` while it is down.
    pub(super) worker: Option<Worker<'m>>,
    storage: Option<WorkerStorage<'m>>,
    /// Threads that draw nothing.
    idle: Vec<u16>,
    outlet: Option<Outlet>,
    /// What communication takes.
    costs: Costs,
    /// The frame in which this node drew each tile last.
    last_drawn: Vec<u32>,
    workload: &'m W,
    letters: Letters,
    pixels_bytes: u32,
    life: u16,
    has_been_dealt: bool,
    look_at_us: Option<u64>,
    /// Time spent drawing, by frame.
    pub(super) busy_ns: Vec<u64>,
    /// Tiles begun, by frame.
    pub(super) begun: Vec<u32>,
}

impl<'m, W: Workload> Node<'m, W> {
    pub(super) fn new(
        config: WorkerConfig,
        storage: WorkerStorage<'m>,
        workload: &'m W,
        letters: Letters,
        pixels_bytes: u32,
        gather: Option<Gather>,
    ) -> Self {
        let outlet = gather.map(|gather| Outlet::new(gather, config.tiles, config.me, config.threads));
        Self {
            config,
            worker: None,
            storage: Some(storage),
            idle: (0..config.threads).collect(),
            outlet,
            costs: gather.map_or_else(Costs::default, |gather| gather.costs),
            last_drawn: vec![0; config.tiles.count() as usize],
            workload,
            letters,
            pixels_bytes,
            life: 0,
            has_been_dealt: false,
            look_at_us: None,
            busy_ns: Vec::new(),
            begun: Vec::new(),
        }
    }

    pub(super) fn start(&mut self, io: &mut Io<'_, Letter, Task>) {
        let Some(storage) = self.storage.take() else { return };
        self.life = io.incarnation();
        // The seed of another life, so that it does not repeat its choices.
        let seed = self.config.seed ^ u64::from(self.life);
        self.worker = Some(Worker::new(WorkerConfig { seed, ..self.config }, storage));
        self.has_been_dealt = self.life <= 1;
        self.go_on(io);
    }

    pub(super) fn crash(&mut self) {
        self.storage = self.worker.take().map(Worker::into_storage);
        self.idle = (0..self.config.threads).collect();
        self.look_at_us = None;
    }

    pub(super) fn handle_message(&mut self, io: &mut Io<'_, Letter, Task>, letter: Letter) {
        if let Letter::Credit { display, bytes } = letter {
            self.outlet.iter_mut().for_each(|outlet| outlet.credit(display, bytes));
            self.send_parcels(io);
            return;
        }
        let (Some(worker), Some(message)) = (self.worker.as_mut(), self.letters.read(letter)) else { return };
        self.has_been_dealt |= matches!(message.body, Body::Deal { .. });
        // What is refused changes nothing.
        let _ = worker.handle_message(io.clock().as_micros(), &message);
        self.go_on(io);
    }

    pub(super) fn handle_peer_down(&mut self, peer: NodeId) {
        self.worker.iter_mut().for_each(|worker| worker.handle_peer(peer.0, true));
    }

    pub(super) fn handle_task(&mut self, io: &mut Io<'_, Letter, Task>, task: Task) {
        let Some(worker) = self.worker.as_mut() else { return };
        let now_us = io.clock().as_micros();
        match task {
            Task::Drawn { thread, frame, tile, cost_us } => {
                self.idle.push(thread);
                let map = self.workload.map(tile);
                let is_wanted = worker.handle_drawn(now_us, frame, TileId(tile), cost_us, map);
                let last = core::mem::replace(&mut self.last_drawn[tile as usize], frame);
                if let Some(outlet) = self.outlet.as_mut().filter(|_| is_wanted) {
                    let bytes = self.workload.bytes(frame, tile, last + 1 == frame);
                    outlet.push(&self.letters, thread, frame, tile, bytes);
                }
            }
            Task::Send { to, bytes, letter } => return io.send(NodeId(to), bytes, letter),
            Task::Placed(_) | Task::Read(_) => return,
            Task::Look => {
                self.look_at_us = None;
                worker.handle_timeout(now_us);
            }
        }
        self.go_on(io);
    }

    /// Sends what is due and puts idle threads to work.
    fn go_on(&mut self, io: &mut Io<'_, Letter, Task>) {
        while let Some(worker) = self.worker.as_mut()
            && let Some(thread) = self.idle.last().copied()
            && let Some(tile) = worker.take(io.clock().as_micros())
            && let Some(stamp) = worker.stamp()
        {
            self.idle.pop();
            let frame = stamp.frame;
            let ns = self.workload.cost_ns(frame, tile.0, self.config.me) + self.costs.tile_out;
            let ns = io.time_of_work(ns);
            self.note(frame, ns);
            let cost_us = u32::try_from(ns / 1000).unwrap_or(u32::MAX);
            io.at(io.now().after(ns), Task::Drawn { thread, frame, tile: tile.0, cost_us });
        }
        for thread in &self.idle {
            self.outlet.iter_mut().for_each(|outlet| outlet.flush(&self.letters, *thread));
        }
        self.send_parcels(io);
        let deadline = self.send(io);
        self.look_at(io, deadline);
    }

    /// Sends the parcels that there is credit for, one after the other.
    fn send_parcels(&mut self, io: &mut Io<'_, Letter, Task>) {
        let (to, mut at) = (self.config.nodes, io.now());
        let Some(outlet) = self.outlet.as_mut() else { return };
        while let Some((number, bytes)) = outlet.next(&self.letters) {
            at = at.after(io.time_of_work(self.costs.parcel_out));
            io.at(at, Task::Send { to, bytes, letter: Letter::Parcel(number) });
        }
    }

    fn note(&mut self, frame: u32, ns: u64) {
        let index = frame as usize;
        self.busy_ns.resize(self.busy_ns.len().max(index + 1), 0);
        self.begun.resize(self.begun.len().max(index + 1), 0);
        self.busy_ns[index] += ns;
        self.begun[index] += 1;
    }

    /// Sends what is due, and tells when there will be more.
    fn send(&mut self, io: &mut Io<'_, Letter, Task>) -> Option<u64> {
        let display = NodeId(self.config.nodes);
        let mut buffer = [0; MESSAGE_BYTES_MAX];
        let now_us = io.clock().as_micros();
        let worker = self.worker.as_mut()?;
        let mut deadline = loop {
            match worker.poll(now_us, &mut buffer) {
                Output::Transmit { to, length } => {
                    let bytes = u32::try_from(length).unwrap_or(u32::MAX);
                    io.send(NodeId(to), bytes, self.letters.add(&buffer[..length]));
                }
                Output::Deliver { tile } => {
                    let Some(stamp) = worker.stamp() else { continue };
                    let body = Body::Drawn { tile, cost_us: worker.cost_us(tile) };
                    let WorkerConfig { epoch, me: from, nodes: to, .. } = self.config;
                    let length = Message { epoch, stamp, from, to, body }.emit(&mut buffer);
                    let bytes = u32::try_from(length).unwrap_or(u32::MAX) + self.pixels_bytes;
                    io.send(display, bytes, self.letters.add(&buffer[..length]));
                }
                Output::Idle(deadline) => break deadline,
            }
        };
        if !self.has_been_dealt {
            if self.look_at_us.is_none() {
                io.send(display, HELLO_BYTES, Letter::Hello { life: self.life });
            }
            deadline = Some(deadline.unwrap_or(u64::MAX).min(now_us + self.config.resend_us));
        }
        deadline
    }

    /// Has itself woken at `deadline`, if nothing wakes it before.
    fn look_at(&mut self, io: &mut Io<'_, Letter, Task>, deadline: Option<u64>) {
        let Some(at_us) = deadline else { return };
        if self.look_at_us.is_none_or(|planned| at_us < planned) {
            self.look_at_us = Some(at_us);
            let wait_us = at_us.saturating_sub(io.clock().as_micros()).max(1);
            io.at(io.now().after(us(wait_us)), Task::Look);
        }
    }
}
