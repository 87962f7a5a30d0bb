//! Balancing in virtual time: the [`Worker`](rt_core::schedule::Worker)s and the
//! [`Ledger`](rt_core::schedule::Ledger) of `rt-core`, byte for byte, each node with threads that draw tiles of known
//! cost, over links that lose, double and reorder, while nodes crash, stall and slow down.
//!
//! Tiles come to the display one in a message, which may be lost and is confirmed; or with [`Gather`] as they do between
//! processes: in parcels, as far as credit goes, to several displays whose work takes time.
//!
//! Every tile of every frame is displayed once (EXACTLY_ONCE), or the run panics.

mod display;
mod gather;
mod letters;
mod node;
mod stiff;
mod world;

pub use gather::{Costs, Gather, Talk};
pub use stiff::Case;
pub use world::{Config, FrameReport, Memory, Report, Workload, run};
