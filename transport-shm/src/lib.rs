//! Messages and pages between processes of one machine.
//!
//! Two ways, both behind [`dsm_core::transport::Transport`]:
//!
//! - **direct reads** ([`DirectPort`]): the owner's pages lie in a memory file that its peers hold open; a page is
//!   read straight out of it. No server, no wake-up; the faster way.
//! - **rings** ([`RingPort`], [`Server`]): a request goes into a ring in shared memory, the owner's server thread
//!   answers into another. It is how a transport between machines works, without the network.
//!
//! # The memory of the rings
//!
//! An owner has one [`Inbox`], a memory file with a *bell* for its server thread and one *channel* for each thread of
//! its peers:
//!
//! ```text
//! inbox    | bell page | channel 0 | channel 1 | ...
//! channel  | request ring, 8 headers | answer ring, 2 headers | client's bell | page 0 | page 1 |
//! ```
//!
//! Every index in there is written by a process that may crash or lie: it is read once, checked against the ring's
//! size and used; a header is copied out before it is parsed; page bytes are only ever copied.
//!
//! Under `--cfg loom` the crate shrinks to [`ring`] and [`bell`], whose atomics the model checker then drives.

pub mod bell;
pub mod ring;
mod sync;

#[cfg(not(loom))]
mod channel;
#[cfg(not(loom))]
mod clock;
#[cfg(not(loom))]
mod direct;
#[cfg(not(loom))]
mod inbox;
#[cfg(not(loom))]
mod mapping;
#[cfg(not(loom))]
mod port;
#[cfg(not(loom))]
mod server;

#[cfg(not(loom))]
pub use {
    clock::now,
    direct::{DirectPort, HeldPages, PageFile},
    inbox::{ChannelId, Inbox, Layout, LayoutError},
    port::RingPort,
    server::Server,
};
