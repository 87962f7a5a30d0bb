//! The display.

use dsm_core::id::NodeId;
use rt_core::schedule::Ledger;
use rt_core::schedule::ledger::{Arrival, Output};
use rt_core::schedule::message::{Body, MESSAGE_BYTES_MAX};

use super::letters::{Letter, Letters, Task};
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
}

impl<'m> Display<'m> {
    pub(super) fn new(
        ledger: Ledger<'m>,
        letters: Letters,
        epoch: u32,
        frames: u32,
        nodes: u16,
        tiles: u32,
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
        if let Letter::Hello { life } = letter {
            self.handle_hello(from, life);
        } else if let Some(message) = self.letters.read(letter) {
            match message.body {
                Body::Drawn { tile, .. } if message.epoch == self.epoch => {
                    match self.ledger.handle_drawn(message.from, message.stamp.frame, tile) {
                        Arrival::First => {
                            let was_shown = core::mem::replace(&mut self.shown[tile.0 as usize], true);
                            assert!(!was_shown, "EXACTLY_ONCE: {tile:?} is displayed twice");
                        }
                        Arrival::Again => self.again += 1,
                        Arrival::Stale => {}
                    }
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

    pub(super) fn handle_look(&mut self, io: &mut Io<'_, Letter, Task>) {
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
                    io.send(NodeId(to), bytes, self.letters.add(&buffer[..length]));
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
