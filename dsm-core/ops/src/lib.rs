//! All the world can do to a cluster of the paging core, and the oracle that watches.
//!
//! One description drives every engine: proptest makes up lists of [`Op`]s, the fuzzer makes them of bytes
//! ([`Op::from_bytes`]), the model checker tries each that [`World::enabled`] gives in every state it reaches. All of them
//! go through [`World::apply`], and after each the oracle checks what must hold, by name:
//!
//! | invariant | what must hold |
//! |---|---|
//! | `SLOT_HOLDS_ONE_PAGE` | no two visible pages share a slot, none is filled twice or taken away unseen |
//! | `RIGHT_BYTES` | every byte of a page that becomes visible is that page's, whoever sent it in however many parts |
//! | `READY_IS_VISIBLE` | a thread that is told to go on can see its page |
//! | `NO_LOST_WAITER` | whoever waits will be woken: its page or a slot is on the way; and nobody waits beyond the deadline |
//! | `BELIEVES_NO_STRANGER` | a message of another epoch, cluster, incarnation, of a dead node or of none that holds the page is refused |
//! | `ONE_ANSWER` | only an answer to the request that is under way has an effect |
//! | `BACKS_OFF` | the time to the next sending to a silent peer doubles |
//! | `KARN` | a round trip is measured from the sending that was answered, whichever that was |
//! | `ADOPTION_RESTARTS` | a fault on a page asked for ahead has all the sendings before it that a request of its own would have |
//! | `DEAD_ARE_LEFT` | what was asked of a node that is known to be dead is due at once |
//! | `SURVIVES` | when the network delivers, every page with a live copy can be had |
//!
//! besides those that [`Node::check_invariants`](dsm_core::node::Node::check_invariants) knows itself. A broken one panics
//! with its name.

mod fingerprint;
mod member;
mod network;
mod op;
mod oracle;
mod packet;
mod setup;
mod tally;
mod world;

pub use op::{Op, Stray};
pub use setup::Setup;
pub use tally::Tally;
pub use world::{World, run, run_bytes};
