//! The display.

use dsm_core::id::NodeId;
use rt_core::TileId;
use rt_core::schedule::ledger::{Arrival, Output};
use rt_core::schedule::message::{Body, MESSAGE_BYTES_MAX};
use rt_core::schedule::{Balancer, Ledger, Message};

use super::gather::{Gather, Talk};
use super::letters::{CREDIT_BYTES, FRAME_BYTES, Letter, Letters, Task};
use super::world::FrameReport;
use crate::cluster::Io;
use crate::time::{Moment, us};

/// The display: its ledger, and what it has displayed. A crash of it is a stall; it forgets nothing.
#[derive(Debug)]
pub(super) struct Display<'m> {
    pub(super) ledger: Ledger<'m>,
    letters: Letters,
    epoch: u32,
    frames: u32,
    /// Starts of each node that were heard of.
    lives: Vec<u16>,
    shown: Vec<bool>,
    began: Moment,
    look_at_us: Option<u64>,
    pub(super) done: Vec<FrameReport>,
    again: u32,
    dealt_anew: u32,
    desk: Option<Desk>,
}

/// Where tiles come in parcels: when the displays and the supervisor's own thread have time again.
#[derive(Debug)]
struct Desk {
    gather: Gather,
    balancer: Balancer,
    displays_free: Vec<Moment>,
    supervisor_free: Moment,
    /// Bytes taken from each node by each display, and those of which the node has been told.
    taken: Vec<Vec<[u64; 2]>>,
    talk: Talk,
}

impl<'m> Display<'m> {
    pub(super) fn new(
        ledger: Ledger<'m>,
        letters: Letters,
        (epoch, frames): (u32, u32),
        nodes: u16,
        tiles: u32,
        gather: Option<(Gather, Balancer)>,
    ) -> Self {
        Self {
            ledger,
            letters,
            epoch,
            frames,
            lives: vec![1; nodes.into()],
            shown: vec![false; tiles as usize],
            began: Moment::ZERO,
            look_at_us: None,
            done: Vec::new(),
            again: 0,
            dealt_anew: 0,
            desk: gather.map(|(gather, balancer)| Desk::new(gather, balancer, nodes)),
        }
    }

    pub(super) fn start(&mut self, io: &mut Io<'_, Letter, Task>) {
        if io.incarnation() <= 1 {
            self.begin(io, 1);
        }
        self.look_at_us = None;
        self.go_on(io);
    }

    pub(super) fn is_done(&self) -> bool {
        self.done.len() >= self.frames as usize
    }

    pub(super) fn handle_message(&mut self, io: &mut Io<'_, Letter, Task>, from: NodeId, letter: Letter) {
        if let (Letter::Parcel(number), Some(desk)) = (letter, self.desk.as_mut()) {
            return desk.take(io, number, &self.letters);
        }
        if let Some(desk) = self.desk.as_mut() {
            let at = desk.work(io.now(), desk.gather.costs.message_in);
            return io.at(at, Task::Read(letter));
        }
        self.read(io, from, letter);
    }

    /// A message is read.
    fn read(&mut self, io: &mut Io<'_, Letter, Task>, from: NodeId, letter: Letter) {
        if let Letter::Hello { life } = letter {
            self.handle_hello(from, life);
        } else if let Some(message) = self.letters.read(letter) {
            match message.body {
                Body::Drawn { tile, .. } if message.epoch == self.epoch => {
                    self.show(message.from, message.stamp.frame, tile);
                }
                // What is refused changes nothing.
                _ => drop(self.ledger.handle_message(&message)),
            }
        }
        self.go_on(io);
    }

    pub(super) fn handle_peer_down(&mut self, io: &mut Io<'_, Letter, Task>, peer: NodeId) {
        self.dealt_anew += self.ledger.handle_down(peer.0);
        self.go_on(io);
    }

    pub(super) fn handle_task(&mut self, io: &mut Io<'_, Letter, Task>, task: Task) {
        match task {
            Task::Look => self.look(io),
            Task::Send { to, bytes, letter } => io.send(NodeId(to), bytes, letter),
            // Only hellos are not signed, and nobody says hello over links that lose nothing.
            Task::Read(letter) => self.read(io, NodeId(0), letter),
            Task::Placed(number) => self.place(io, number),
            Task::Drawn { .. } => {}
        }
    }

    /// A display has put the tiles of a parcel in place.
    fn place(&mut self, io: &mut Io<'_, Letter, Task>, number: u32) {
        let parcel = self.letters.take_parcel(number);
        for tile in &parcel.tiles {
            self.show(parcel.from, parcel.frame, TileId(*tile));
        }
        if let Some(desk) = self.desk.as_mut() {
            desk.give_credit(io, parcel.from, parcel.display, parcel.bytes);
            if matches!(desk.balancer, Balancer::Demand { .. }) {
                // The bell rings, and the next tile is dealt.
                desk.work(io.now(), desk.gather.costs.message_in);
            }
        }
        self.go_on(io);
    }

    fn show(&mut self, from: u16, frame: u32, tile: TileId) {
        match self.ledger.handle_drawn(from, frame, tile) {
            Arrival::First => {
                let was_shown = core::mem::replace(&mut self.shown[tile.0 as usize], true);
                assert!(!was_shown, "EXACTLY_ONCE: {tile:?} is displayed twice");
            }
            Arrival::Again => self.again += 1,
            Arrival::Stale => {}
        }
    }

    fn look(&mut self, io: &mut Io<'_, Letter, Task>) {
        self.look_at_us = None;
        self.ledger.handle_timeout(io.clock().as_micros());
        self.go_on(io);
    }

    /// A node has started anew, with empty hands.
    fn handle_hello(&mut self, from: NodeId, life: u16) {
        if let Some(known) = self.lives.get_mut(from.index()).filter(|known| **known < life) {
            *known = life;
            self.ledger.handle_up(from.0);
        }
    }

    fn begin(&mut self, io: &Io<'_, Letter, Task>, frame: u32) {
        self.shown.fill(false);
        self.began = io.now();
        self.ledger.begin(frame);
    }

    /// Notes a frame that is whole and begins the next; sends what is due.
    fn go_on(&mut self, io: &mut Io<'_, Letter, Task>) {
        while self.ledger.missing() == 0 && !self.is_done() {
            assert!(self.shown.iter().all(|shown| *shown), "EXACTLY_ONCE: a whole frame lacks a tile");
            let frame = self.ledger.stamp().frame;
            self.done.push(FrameReport {
                ns: io.now().since(self.began),
                moved: self.ledger.moved(),
                again: core::mem::take(&mut self.again),
                dealt_anew: core::mem::take(&mut self.dealt_anew),
                busy_ns: Vec::new(),
                begun: 0,
                talk: self.desk.as_mut().map(Desk::end_frame).unwrap_or_default(),
            });
            if self.is_done() {
                return;
            }
            self.begin(io, frame + 1);
        }
        let mut buffer = [0; MESSAGE_BYTES_MAX];
        let now_us = io.clock().as_micros();
        let deadline = loop {
            match self.ledger.poll(now_us, &mut buffer) {
                Output::Transmit { to, length } => {
                    let bytes = u32::try_from(length).unwrap_or(u32::MAX);
                    let letter = self.letters.add(&buffer[..length]);
                    let opens_view = self.letters.read(letter).is_some_and(|message| opens_view(&message));
                    match self.desk.as_mut() {
                        Some(desk) if opens_view => desk.send(io, to, bytes + FRAME_BYTES, letter),
                        Some(desk) => desk.send(io, to, bytes, letter),
                        None => io.send(NodeId(to), bytes, letter),
                    }
                }
                Output::Idle(deadline) => break deadline,
            }
        };
        let Some(at_us) = deadline else { return };
        if self.look_at_us.is_none_or(|planned| at_us < planned) {
            self.look_at_us = Some(at_us);
            io.at(io.now().after(us(at_us.saturating_sub(now_us).max(1))), Task::Look);
        }
    }
}

const fn opens_view(message: &Message) -> bool {
    matches!(message.body, Body::Deal { number: 0, .. })
}

impl Desk {
    fn new(gather: Gather, balancer: Balancer, nodes: u16) -> Self {
        let displays = usize::from(gather.displays);
        Self {
            gather,
            balancer,
            displays_free: vec![Moment::ZERO; displays],
            supervisor_free: Moment::ZERO,
            taken: vec![vec![[0; 2]; displays]; nodes.into()],
            talk: Talk::of(gather.displays),
        }
    }

    /// The supervisor has so much to do, now or when it has time; tells when that is done.
    fn work(&mut self, now: Moment, ns: u64) -> Moment {
        self.supervisor_free = self.supervisor_free.max(now).after(ns);
        self.talk.supervisor += ns;
        self.supervisor_free
    }

    fn send(&mut self, io: &mut Io<'_, Letter, Task>, to: u16, bytes: u32, letter: Letter) {
        let at = self.work(io.now(), self.gather.costs.message_out);
        io.at(at, Task::Send { to, bytes, letter });
    }

    /// A parcel has reached its display, which takes it when it has time.
    fn take(&mut self, io: &mut Io<'_, Letter, Task>, number: u32, letters: &Letters) {
        let (display, tiles, bytes) = letters.size_of(number);
        let ns = self.gather.costs.parcel_in + self.gather.costs.tile_in * tiles as u64;
        let free = &mut self.displays_free[usize::from(display)];
        *free = (*free).max(io.now()).after(ns);
        self.talk.displays[usize::from(display)] += ns;
        self.talk.parcels += 1;
        self.talk.bytes += u64::from(bytes);
        io.at(*free, Task::Placed(number));
    }

    /// Tells a node what was taken from it, now and then.
    fn give_credit(&mut self, io: &mut Io<'_, Letter, Task>, node: u16, display: u16, bytes: u32) {
        let [taken, told] = &mut self.taken[usize::from(node)][usize::from(display)];
        *taken += u64::from(bytes);
        if *taken - *told >= self.gather.step_bytes() {
            *told = *taken;
            let ns = self.gather.costs.message_out;
            let free = &mut self.displays_free[usize::from(display)];
            *free = (*free).max(io.now()).after(ns);
            self.talk.displays[usize::from(display)] += ns;
            let letter = Letter::Credit { display, bytes: *taken };
            io.at(*free, Task::Send { to: node, bytes: CREDIT_BYTES, letter });
        }
    }

    fn end_frame(&mut self) -> Talk {
        core::mem::replace(&mut self.talk, Talk::of(self.gather.displays))
    }
}
