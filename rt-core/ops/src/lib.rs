//! All the world can do to a cluster that balances its tiles, and the oracle that watches.
//!
//! One description drives every engine: proptest makes up lists of [`Op`]s, the fuzzer makes them of bytes
//! ([`Op::from_bytes`]), the model checker tries each that [`World::enabled`] gives in every state it reaches. All of them
//! go through [`World::apply`], and after each the oracle checks what must hold, by name:
//!
//! | invariant | what must hold |
//! |---|---|
//! | `EXACTLY_ONCE` | no tile of a frame is displayed twice, and of a frame that is whole each is displayed |
//! | `NO_LOST_TILE` | a tile that is missing is with somebody who lives, or will be sent again, or is known to be to be dealt anew |
//! | `DRAWN_ONCE` | in the view that holds no missing tile is begun twice, whatever the network loses, doubles or reorders |
//! | `TERMINATES` | when the network delivers and somebody lives, the frame becomes whole |
//! | `RESTS` | when a frame is whole and all has been delivered, nobody has anything more to say |
//! | `BELIEVES_NO_STRANGER` | bytes that changed on the way, another epoch, a message for somebody else: refused |
//!
//! besides those that [`Worker::check_invariants`](rt_core::schedule::Worker::check_invariants) and
//! [`Ledger::check_invariants`](rt_core::schedule::Ledger::check_invariants) know themselves. A broken one panics with its
//! name.

mod member;
mod op;
mod setup;
mod tally;
mod world;

pub use member::Memory;
pub use op::{Op, Stray};
pub use setup::Setup;
pub use tally::Tally;
pub use world::{World, run, run_bytes};
