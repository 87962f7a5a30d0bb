//! What makes two states of a cluster the same to everything that can happen to it.

use core::hash::{Hash, Hasher};
use std::collections::hash_map::DefaultHasher;

use dsm_core::time::Instant;
use dsm_core::wire::{Body, Message};

use crate::member::{Member, Thread};
use crate::packet::Packet;
use crate::world::World;

impl World {
    /// A number that two worlds have in common when whatever happens to both leads to the same: times count as distances
    /// from now, requests have no numbers but are current or not, and the order of what is under way does not matter.
    ///
    /// For set-ups with one slot a node, the same timeout always, and clocks that do not jump.
    #[must_use]
    pub fn fingerprint(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        let mut packets: Vec<u64> =
            self.under_way.iter().map(|packet| self.packet_fingerprint(packet)).collect();
        packets.sort_unstable();
        packets.hash(&mut hasher);
        for member in &self.members {
            member_fingerprint(member, self.now, &mut hasher);
        }
        hasher.finish()
    }

    fn packet_fingerprint(&self, packet: &Packet) -> u64 {
        let mut hasher = DefaultHasher::new();
        if let Some(message) = packet.message() {
            let Message { from, to, from_incarnation, to_incarnation, page, body, .. } = message;
            (from, to, from_incarnation, to_incarnation, page, self.is_current(&message)).hash(&mut hasher);
            match body {
                Body::Request { offset, bytes } => (1, offset, bytes).hash(&mut hasher),
                Body::Grant { offset, bytes } => (2, offset, bytes).hash(&mut hasher),
                Body::Refusal(why) => (3, why as u32, 0).hash(&mut hasher),
            }
        }
        packet.page.hash(&mut hasher);
        hasher.finish()
    }
}

fn member_fingerprint(member: &Member, now: Instant, hasher: &mut impl Hasher) {
    (member.is_alive, member.incarnation).hash(hasher);
    if !member.is_alive {
        return;
    }
    let mut member = member.clone();
    member.with_node(|node| node.fingerprint(now, hasher));
    for thread in &member.threads {
        let waited = thread.wait().map(|wait| now.since(wait.world_since));
        match thread {
            Thread::Running => 0u8.hash(hasher),
            Thread::Fetching(wait) => (1u8, wait.page, wait.is_ahead).hash(hasher),
            Thread::WaitingForPage(wait) => (2u8, wait.page, waited).hash(hasher),
            Thread::WaitingForSlot(wait) => (3u8, wait.page, waited).hash(hasher),
        }
    }
    member.work.sort_unstable();
    member.work.hash(hasher);
    member.visible.hash(hasher);
    member.stored.hash(hasher);
    member.oracle.fingerprint(hasher);
}
