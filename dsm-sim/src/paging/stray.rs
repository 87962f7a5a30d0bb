//! Messages that look like answers and must not be believed.

use dsm_core::id::{ClusterId, Epoch, Incarnation, NodeId};
use dsm_core::wire::{Body, Message};

use crate::chance::Chance;

/// What stands for bytes that are no page of this epoch. Whoever maps them breaks `RIGHT_PAGE`.
pub(super) const POISON: u64 = 0xBAD;

/// A message like `answer` that strayed here: from another run, epoch or node, for another node's life, to another request, of
/// another length. `holds` says who holds its page.
///
/// Answers of an earlier incarnation of their sender are not among them: until a later one has been heard of, nothing
/// is wrong with them.
pub(super) fn stray_like(
    answer: &Message,
    nodes: u16,
    holds: impl Fn(NodeId) -> bool,
    chance: &mut Chance,
) -> Option<Message> {
    let stray = match chance.below(6) {
        0 => Message { cluster: ClusterId(!answer.cluster.0), ..*answer },
        1 => Message { epoch: Epoch(answer.epoch.0 ^ 1), ..*answer },
        2 => Message { to_incarnation: Incarnation(answer.to_incarnation.0 ^ 1), ..*answer },
        3 => Message { request: answer.request ^ 1, ..*answer },
        4 => {
            let from = NodeId(u16::try_from(chance.below(nodes.into())).unwrap_or(0));
            (!holds(from)).then_some(Message { from, from_incarnation: Incarnation(0), ..*answer })?
        }
        _ => match answer.body {
            Body::Grant { offset, bytes } => {
                Message { body: Body::Grant { offset, bytes: bytes + 1 }, ..*answer }
            }
            Body::Request { .. } | Body::Refusal(_) => return None,
        },
    };
    Some(stray)
}
