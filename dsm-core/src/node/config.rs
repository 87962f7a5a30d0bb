//! What a node must know before it starts.

use core::fmt;

use crate::id::{ClusterId, Epoch, NodeId};
use crate::page_table::StorageError;
use crate::placement::Stripes;

/// What a node must know before it starts.
#[derive(Clone, Copy, Debug)]
pub struct Config {
    /// This node's number.
    pub me: NodeId,
    /// The run it takes part in.
    pub cluster: ClusterId,
    /// The epoch it works in.
    pub epoch: Epoch,
    /// Which node is home to which page.
    pub placement: Stripes,
    /// Length of a page in bytes.
    pub page_bytes: u32,
    /// Victims chosen at a time, in `1..=`[`EVICT_BATCH_MAX`]. Taking many away at once is cheaper by far.
    pub evict_batch: u32,
    /// Evict when fewer slots than this are free or leaving, in the shadow of a request that is under way anyway.
    /// 0: evict when a fault finds no slot.
    pub evict_ahead: u32,
    /// First time to the resending of a request; it doubles each time.
    pub resend_us: u64,
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
    /// A time of 0.
    ZeroTime,
}

impl Config {
    /// A configuration with defaults for everything but what has none.
    #[must_use]
    pub const fn new(me: NodeId, placement: Stripes, page_bytes: u32) -> Self {
        Self {
            me,
            cluster: ClusterId(0),
            epoch: Epoch(0),
            placement,
            page_bytes,
            evict_batch: 1,
            evict_ahead: 0,
            resend_us: 10_000,
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
            Self { resend_us: 0, .. } | Self { deadline_us: 0, .. } => Err(ConfigError::ZeroTime),
            _ => Ok(()),
        }
    }
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Storage(error) => write!(f, "{error}"),
            Self::PageBytes(got) => write!(f, "a page of {got} bytes is no power of two"),
            Self::EvictBatch(got) => write!(f, "a batch of {got} victims is not in 1..={EVICT_BATCH_MAX}"),
            Self::ZeroTime => write!(f, "a resend time or deadline of 0"),
        }
    }
}

impl core::error::Error for ConfigError {}

/// Victims that can be chosen at a time.
pub const EVICT_BATCH_MAX: u32 = 32;
