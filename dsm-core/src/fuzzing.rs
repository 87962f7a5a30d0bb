//! What the fuzzer and the tests run on bytes from outside.

use crate::home::Home;
use crate::id::{NodeId, PageId, PortId};
use crate::node::{Config, Fault, Node, Output};
use crate::placement::Stripes;
use crate::replacement::{Policy, PolicyKind};
use crate::storage::{PageEntry, PeerEntry, RequestEntry, SlotEntry, Storage};
use crate::time::Instant;
use crate::wire::{HEADER_BYTES, Message};

/// Gives `bytes`, as a message, to everything that takes messages, and checks that none of them is impressed: what
/// parses emits to the same bytes, and every invariant holds after.
///
/// # Panics
/// When one does not.
pub fn message(bytes: &[u8]) {
    if let Ok(message) = Message::parse(bytes) {
        let mut again = [0; HEADER_BYTES];
        message.emit(&mut again);
        assert_eq!(again, bytes[..HEADER_BYTES], "what parses emits to the same bytes");
    }
    let Ok(placement) = Stripes::new(6, 1, NodeId(0), 2) else { return };
    let config = Config::new(NodeId(0), placement, 4096);
    let _ = Home::new(NodeId(0), config.cluster, config.epoch, placement, 4096).handle_message(bytes);

    let (mut pages, mut slots) = ([PageEntry::EMPTY; 6], [SlotEntry::EMPTY; 2]);
    let (mut peers, mut requests) = ([PeerEntry::EMPTY; 2], [RequestEntry::EMPTY; 4]);
    let storage =
        Storage { pages: &mut pages, slots: &mut slots, peers: &mut peers, requests: &mut requests };
    let Ok(mut node) = Node::new(config, storage, Policy::new(PolicyKind::Fifo, 1)) else { return };
    let now = Instant::ZERO;
    assert_eq!(node.handle_fault(now, PageId(1), PortId(0)), Fault::Fetch);
    drain(&mut node);
    let _ = node.handle_message(now, bytes);
    drain(&mut node);
    node.check_invariants();
}

fn drain(node: &mut Node<'_>) {
    while !matches!(node.poll(&mut [0; HEADER_BYTES]), Output::Idle(_)) {}
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bytes_from_outside_impress_nobody(
            mut bytes in prop::collection::vec(any::<u8>(), 0..52), looks_right in any::<bool>(), kind in 1u8..4,
        ) {
            if looks_right && bytes.len() >= crate::wire::HEADER_BYTES {
                bytes[..4].copy_from_slice(&[b'M', b'S', crate::wire::VERSION, kind]);
                bytes[4..16].fill(0);
                bytes[16..].iter_mut().for_each(|byte| *byte %= 3);
            }
            super::message(&bytes);
        }
    }
}
