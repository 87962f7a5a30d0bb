//! Processes that die while the others go on; and, for tests, when to kill one.

use core::fmt;
use core::str::FromStr;

use anyhow::{Context, Error, Result};
use dsm_core::id::{NodeId, PageId};
use dsm_core::placement::Stripes;
use serde::{Deserialize, Serialize};

/// A process that died while the others went on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Loss {
    /// Which, as in `node 1` or `store 3`.
    pub process: String,
    /// How it ended, as in `was killed by SIGKILL`.
    pub how: String,
    /// What the run was busy with, as in `frame 3 was drawn`.
    pub doing: String,
    /// Tiles that it had not yet delivered, and that others drew in that frame.
    pub tiles_dealt_again: usize,
}

/// Kill process `process` at this moment. Written `PROCESS@FRAME:TILES` or `PROCESS@start`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kill {
    /// Its number; stores follow the nodes.
    pub process: u16,
    /// When.
    pub when: Moment,
}

/// A moment at which a process may be killed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moment {
    /// As soon as every process has its plan: some have filled their pages, some have not.
    Start,
    /// Once so many tiles of this frame are in place.
    Drawn {
        /// Number of the frame.
        frame: u32,
        /// Tiles of it that are there by then.
        tiles: usize,
    },
}

/// Whether every page has a holder that lives.
pub(crate) fn is_all_there(placement: &Stripes, is_dead: impl Fn(NodeId) -> bool) -> bool {
    // All pages of a stripe have the same holders.
    let step = usize::try_from(placement.stripe_pages()).unwrap_or(usize::MAX);
    let mut stripes = (0..placement.page_count()).step_by(step);
    stripes.all(|page| placement.holders(PageId(page)).as_slice().iter().any(|holder| !is_dead(*holder)))
}

impl fmt::Display for Loss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { process, how, doing, tiles_dealt_again } = self;
        write!(f, "{process} {how} while {doing}; ")?;
        match tiles_dealt_again {
            0 => write!(f, "the others went on"),
            1 => write!(f, "1 of its tiles was dealt again to the others"),
            count => write!(f, "{count} of its tiles were dealt again to the others"),
        }
    }
}

impl FromStr for Kill {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let parts = || {
            let (process, moment) = text.split_once('@')?;
            let process = process.parse().ok()?;
            if moment == "start" {
                return Some(Self { process, when: Moment::Start });
            }
            let (frame, tiles) = moment.split_once(':')?;
            let when = Moment::Drawn { frame: frame.parse().ok()?, tiles: tiles.parse().ok()? };
            Some(Self { process, when })
        };
        parts().context("expected PROCESS@FRAME:TILES or PROCESS@start, as in 1@0:200")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn with_two_copies_one_owner_can_be_spared_and_two_cannot() {
        let placement = Stripes::new(1000, 4, NodeId(3), 5).unwrap();
        assert!(is_all_there(&placement, |_| false));
        assert!(!is_all_there(&placement, |node| node == NodeId(4)));
        let twice = placement.with_replicas(2).unwrap();
        for dead in 3..8 {
            assert!(is_all_there(&twice, |node| node == NodeId(dead)));
            assert!(!is_all_there(&twice, |node| node != NodeId(dead)));
        }
    }

    #[test]
    fn moments_are_read_or_refused() {
        assert_eq!(
            "1@2:30".parse::<Kill>().unwrap(),
            Kill { process: 1, when: Moment::Drawn { frame: 2, tiles: 30 } }
        );
        assert_eq!("3@start".parse::<Kill>().unwrap(), Kill { process: 3, when: Moment::Start });
        for text in ["", "1", "1@2", "1:2@3", "a@1:2", "1@-1:0", "70000@1:1"] {
            assert!(text.parse::<Kill>().is_err(), "{text}");
        }
    }
}
