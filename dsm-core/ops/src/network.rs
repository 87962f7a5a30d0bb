//! What becomes of messages under way.

use dsm_core::home::{Answer, HomeError};
use dsm_core::id::NodeId;
use dsm_core::wire::{Body, HEADER_BYTES, Message};

use crate::member::Member;
use crate::op::Stray;
use crate::oracle::{self, carried, holds};
use crate::packet::Packet;
use crate::setup::PAGE_BYTES;
use crate::world::World;

impl World {
    /// Gives a packet to whom it is for.
    pub(crate) fn deliver(&mut self, packet: &Packet) {
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
            if member.slack_us == 0
                && let Some(after) = round_trip(member).filter(|after| before != Some(*after))
                && let Some(trip) = member.oracle.round_trip_us(message, self.now)
            {
                check_measured(message, before, after, trip);
            }
            member.oracle.note_heard(message.from, message.from_incarnation);
        }
        if carried(message).is_none() {
            // A refusal leads to another sending at once; its interval is no sign of silence.
            member.oracle.forgive(message.page);
        }
        self.carry_out(to, sent, woken);
    }

    /// A copy of a packet that is for somebody else, where there can be such.
    pub(crate) fn stray(&self, packet: &Packet, how: Stray) -> Option<Packet> {
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
}

/// The smoothed round trip has become `after`: it must have moved towards that of the sending which was answered. `KARN`.
fn check_measured(message: &Message, before: Option<u64>, after: u64, trip: u64) {
    // A round trip of 0 counts as 1, and eighths are cut off.
    let trip = trip.max(1);
    let before = before.unwrap_or(trip);
    let is_between = before.min(trip) <= after + 1 && after <= before.max(trip) + 1;
    assert!(
        is_between,
        "KARN: {message:?} after {trip} us moved the round trip from {before} us to {after} us"
    );
}
