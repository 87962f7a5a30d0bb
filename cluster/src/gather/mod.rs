//! Gathering: tiles on their way from the threads that draw them to the displays that put the picture together.
//!
//! | module | what it holds |
//! |---|---|
//! | [`codec`] | the pixels of a tile, made small without loss |
//! | `parcel` | tiles in a packet |
//! | `credit` | how much a node may have under way |
//! | `outlet` | a node's side: what changed goes out, in parcels, as far as credit goes |
//! | `display` | a display: takes parcels and puts tiles in place |
//! | `part` | the part of the picture that one display puts together |
//!
//! Rows of tiles go to the displays in turn, so each has its share of what is costly. A tile that is as it was in the last
//! frame travels without pixels: the node that drew it then knows, and the displays have it, since no frame begins
//! before the one before it is whole. A tile that has changed hands travels whole, and so does every tile while a death
//! may have had some drawn twice. What the displays put in place they note for the supervisor, who counts.

pub mod codec;
mod credit;
mod display;
mod outlet;
mod parcel;
mod part;

pub(crate) use display::{Arrived, Displays, Gathered};
pub(crate) use outlet::{Outlets, Sender};
pub use part::place;

use rt_core::TileId;

/// Displays of a run at most.
pub const DISPLAYS_MAX: u16 = 16;

/// The display that a tile goes to, in a picture of so many columns of tiles.
fn display_of(TileId(id): TileId, columns: u32, displays: usize) -> usize {
    (id / columns.max(1)) as usize % displays.max(1)
}
