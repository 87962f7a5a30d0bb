//! What a node must know before it starts.

use core::fmt;

use crate::id::{ClusterId, Epoch, Incarnation, NodeId};
use crate::membership::Patience;
use crate::page_table::StorageError;
use crate::placement::Stripes;
use crate::round_trip::Limits;

/// What a node must know before it starts.
#[derive(Clone, Copy, Debug)]
pub struct Config {
    /// This node's number.
    pub me: NodeId,
    /// The run it takes part in.
    pub cluster: ClusterId,
    /// The epoch it works in.
    pub epoch: Epoch,
    /// How often a node of this number has been started before in this run.
    pub incarnation: Incarnation,
    /// Which nodes hold which page.
    pub placement: Stripes,
    /// Length of a page in bytes.
    pub page_bytes: u32,
    /// Victims chosen at a time, in `1..=`[`EVICT_BATCH_MAX`]. Taking many away at once is cheaper by far.
    pub evict_batch: u32,
    /// Evict when fewer slots than this are free or leaving, in the shadow of a request that is under way anyway.
    /// 0: evict when a fault finds no slot.
    pub evict_ahead: u32,
    /// Pages that are hidden before they leave, at most; less than there are slots. 0: none. See
    /// [`Residents`](crate::replacement::Residents).
    pub hidden_max: u32,
    /// Pages asked for along with one that was missed, at most, in `0..=`[`NEIGHBOURS_MAX`]: those that follow it. How many
    /// they are follows what was used of them, and 0 is possible, for as long as none are.
    pub neighbours_max: u32,
    /// Pages may come in fragments; the driver stores them as [`Output::Store`](super::Output::Store) says. Else a grant
    /// of less than a page is refused.
    pub fragments: bool,
    /// Time to the sending again of a request to a peer whose round trip has not been measured; it doubles each time.
    pub resend_us: u64,
    /// The least such time once it has, however short the round trip: the pause that a peer may make without harm.
    pub resend_us_min: u64,
    /// The greatest such time, however often it has doubled. A cluster whose round trips are longer works, and sends
    /// everything several times.
    pub resend_us_max: u64,
    /// Sendings to one copy of a page before the next one is asked, at least 1.
    pub tries: u8,
    /// A peer that leaves requests unanswered for this long is suspected.
    pub suspect_after_us: u64,
    /// A peer that leaves requests unanswered for this long, and at least
    /// [`UNANSWERED_BEFORE_DEATH`](crate::membership::UNANSWERED_BEFORE_DEATH) of them, is dead to this node.
    pub dead_after_us: u64,
    /// A fault that is not served after this long fails.
    pub deadline_us: u64,
}

/// Why no node came of a configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ConfigError {
    /// The lent storage does not fit.
    Storage(StorageError),
    /// A page length that is no power of two.
    PageBytes(u32),
    /// A batch outside `1..=`[`EVICT_BATCH_MAX`].
    EvictBatch(u32),
    /// More neighbours than [`NEIGHBOURS_MAX`].
    Neighbours(u32),
    /// A time of 0, or no try.
    ZeroTime,
    /// The least time to a resending is longer than the greatest.
    ResendTimes {
        /// The least.
        min_us: u64,
        /// The greatest.
        max_us: u64,
    },
}

impl Config {
    /// A configuration with defaults for everything but what has none.
    #[must_use]
    pub const fn new(me: NodeId, placement: Stripes, page_bytes: u32) -> Self {
        Self {
            me,
            cluster: ClusterId(0),
            epoch: Epoch(0),
            incarnation: Incarnation(0),
            placement,
            page_bytes,
            evict_batch: 1,
            evict_ahead: 0,
            hidden_max: 0,
            neighbours_max: 0,
            fragments: false,
            resend_us: 10_000,
            resend_us_min: 1_000,
            resend_us_max: 60_000_000,
            tries: 2,
            suspect_after_us: 250_000,
            dead_after_us: 2_000_000,
            deadline_us: 2_000_000,
        }
    }

    /// Says whether the numbers make sense by themselves.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        match *self {
            Self { page_bytes, .. } if !page_bytes.is_power_of_two() => {
                Err(ConfigError::PageBytes(page_bytes))
            }
            Self { evict_batch, .. } if !(1..=EVICT_BATCH_MAX).contains(&evict_batch) => {
                Err(ConfigError::EvictBatch(evict_batch))
            }
            Self { neighbours_max, .. } if neighbours_max > NEIGHBOURS_MAX => {
                Err(ConfigError::Neighbours(neighbours_max))
            }
            Self { resend_us: 0, .. }
            | Self { deadline_us: 0, .. }
            | Self { suspect_after_us: 0, .. }
            | Self { dead_after_us: 0, .. }
            | Self { tries: 0, .. } => Err(ConfigError::ZeroTime),
            Self { resend_us_min: min_us, resend_us_max: max_us, .. } if min_us > max_us => {
                Err(ConfigError::ResendTimes { min_us, max_us })
            }
            _ => Ok(()),
        }
    }

    /// Sendings that must fit in before a fault is given up: each copy is asked as often as it may be.
    pub(super) const fn round(&self) -> u64 {
        self.placement.replicas() as u64 * self.tries as u64
    }

    pub(super) const fn limits(&self) -> Limits {
        Limits { first_us: self.resend_us, min_us: self.resend_us_min, max_us: self.resend_us_max }
    }

    pub(super) const fn patience(&self) -> Patience {
        Patience { suspect_after_us: self.suspect_after_us, dead_after_us: self.dead_after_us }
    }
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Storage(error) => write!(f, "{error}"),
            Self::PageBytes(got) => write!(f, "a page of {got} bytes is no power of two"),
            Self::EvictBatch(got) => write!(f, "a batch of {got} victims is not in 1..={EVICT_BATCH_MAX}"),
            Self::Neighbours(got) => {
                write!(f, "{got} neighbours brought along with a page, and {NEIGHBOURS_MAX} can be")
            }
            Self::ZeroTime => write!(f, "a time to resend, suspect, bury or give up of 0, or no try"),
            Self::ResendTimes { min_us, max_us } => {
                write!(f, "the least time to a resending, {min_us} us, is above the greatest, {max_us} us")
            }
        }
    }
}

impl core::error::Error for ConfigError {}

/// Pages that can be asked for along with one that was missed.
pub const NEIGHBOURS_MAX: u32 = 16;

/// Victims that can be chosen at a time.
pub const EVICT_BATCH_MAX: u32 = 32;
