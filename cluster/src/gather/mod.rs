//! Gathering: tiles on their way from the threads that draw them to the displays that put the picture together.
//!
//! | module | what it holds |
//! |---|---|
//! | `bands` | which display puts which part of the picture together |
//! | [`codec`] | the pixels of a tile, made small without loss |
//! | [`head`] | what is said of a tile before its pixels |
//! | `parcel` | tiles in a packet |
//! | `credit` | how much a node may have under way |
//! | `outlet` | a node's side: what changed goes out, in parcels, as far as credit goes |
//! | `display` | a display: takes parcels and puts tiles in place |
//! | `part` | the part of the picture that one display puts together |
//!
//! A tile that is as it was in the last
//! frame travels without pixels: the node that drew it then knows, and the displays have it, since no frame begins
//! before the one before it is whole. A tile that has changed hands travels whole, and so does every tile while a death
//! may have had some drawn twice. What the displays put in place they note for the supervisor, who counts.

mod bands;
pub mod codec;
mod credit;
mod display;
pub mod head;
mod outlet;
mod parcel;
mod part;

pub(crate) use display::{Arrived, Displays, Gathered};
pub(crate) use outlet::{Outlets, Sender};
pub use part::place;

/// Displays of a run at most.
pub const DISPLAYS_MAX: u16 = 16;
