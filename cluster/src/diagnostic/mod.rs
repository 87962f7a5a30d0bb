//! Pictures of what happens: who draws which tile, who owns the page behind each pixel, where misses and time go.
//!
//! | module | what it holds |
//! |---|---|
//! | `facts` | what is known of each tile of a frame, and how it travels |
//! | `probe` | a render thread's side: measuring a tile, finding the page behind each pixel |
//! | `bricks` | of a volume, the brick behind a pixel |
//! | `panel` | from facts to colours and legends |
//! | `sheet` | panels side by side in one picture |
//! | `letters` | small letters for legends |
//!
//! The first two kinds are Figures 3 and 4 of DeMarle, Gribble and Parker, "Memory-Savvy Distributed Interactive Ray
//! Tracing", EGPGV 2004. Nothing is measured or sent that was not asked for.

#[cfg(feature = "volumes")]
mod bricks;
#[cfg(not(feature = "volumes"))]
#[path = "no_bricks.rs"]
mod bricks;
mod facts;
mod letters;
mod panel;
mod probe;
mod sheet;

pub(crate) use facts::{FactBatch, FrameFacts};
pub(crate) use probe::{Probe, Wants};
pub(crate) use sheet::Colours;

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

use crate::picture::Picture;

/// A picture of what happens.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Diagnostic {
    /// A grey for each node, over the tiles that it drew: the paper's Figure 3.
    TileOwner,
    /// A hue for each owner of pages, over the pixels whose surface lies in its pages: the paper's Figure 4.
    PageOwner,
    /// How often the drawing of each tile met an absent page.
    Misses,
    /// How long the drawing of each tile took.
    Cost,
}

impl Diagnostic {
    /// The name under which it is chosen.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::TileOwner => "tile-owner",
            Self::PageOwner => "page-owner",
            Self::Misses => "misses",
            Self::Cost => "cost",
        }
    }
}

/// The picture of one kind, and what its colours mean.
pub(crate) fn sheet_of(kind: Diagnostic, picture: &Picture, facts: &FrameFacts) -> Colours {
    sheet::side_by_side(&[panel::of(kind, picture, facts)])
}

/// The frame and the pictures of these kinds, side by side.
pub(crate) fn sheet_of_all(kinds: &[Diagnostic], picture: &Picture, facts: &FrameFacts) -> Colours {
    let of_kinds = kinds.iter().map(|kind| panel::of(*kind, picture, facts));
    let panels: Vec<_> = core::iter::once(panel::of_frame(picture)).chain(of_kinds).collect();
    sheet::side_by_side(&panels)
}
