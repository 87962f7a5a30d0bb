//! What a cluster is made of.

use rt_core::schedule::Balancer;
use rt_core::schedule::ledger::LedgerConfig;
use rt_core::schedule::worker::WorkerConfig;
use rt_core::{TILE_SIZE, Tiles};

/// A cluster's make-up. Every value is made one that can be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Setup {
    /// Nodes, `1..=6`.
    pub nodes: u8,
    /// Columns and rows of tiles, `1..=6` each.
    pub columns: u8,
    /// See `columns`.
    pub rows: u8,
    /// Render threads of each node, `1..=3`.
    pub threads: u8,
    /// Two render threads share a core, as far as nodes are told.
    pub shares_cores: bool,
    /// How tiles come to nodes.
    pub balancer: Balancer,
    /// Tiles that were sent to the display may be lost, and it confirms those that come.
    pub confirms: bool,
    /// Tiles use no pages, which leaves fewer states. For the model checker.
    pub is_pageless: bool,
}

/// First time after which something is sent again.
pub(crate) const RESEND_US: u64 = 1000;

/// The epoch of every world.
pub(crate) const EPOCH: u32 = 7;

impl Setup {
    /// Bytes that a set-up is made of.
    pub const BYTES: usize = 4;

    /// The set-up that these bytes stand for. All bytes stand for one.
    #[must_use]
    pub fn from_bytes([shape, nodes, balancer, rest]: [u8; Self::BYTES]) -> Self {
        let balancer = match balancer % 8 {
            0 => Balancer::Static,
            1 | 2 => Balancer::Demand { window: 1 + rest / 64 },
            3 | 4 => Balancer::Steal,
            _ => Balancer::StealNear,
        };
        Self {
            nodes: 1 + nodes % 6,
            columns: 1 + shape % 6,
            rows: 1 + shape / 16 % 6,
            threads: 1 + rest % 3,
            shares_cores: rest & 16 != 0,
            balancer,
            confirms: rest & 8 == 0,
            is_pageless: false,
        }
    }

    /// The picture.
    pub(crate) fn tiles(&self) -> Tiles {
        Tiles::of(u32::from(self.columns) * TILE_SIZE, u32::from(self.rows) * TILE_SIZE)
    }

    /// The display's number.
    pub(crate) fn display(&self) -> u16 {
        self.nodes.into()
    }

    fn threads_per_core(&self) -> u16 {
        1 + u16::from(self.shares_cores)
    }

    pub(crate) fn worker(&self, me: u16, life: u64) -> WorkerConfig {
        WorkerConfig {
            epoch: EPOCH,
            me,
            nodes: self.nodes.into(),
            threads: self.threads.into(),
            threads_per_core: self.threads_per_core(),
            tiles: self.tiles(),
            balancer: self.balancer,
            resend_us: RESEND_US,
            is_display_reliable: !self.confirms,
            seed: life,
        }
    }

    pub(crate) fn ledger(&self) -> LedgerConfig {
        LedgerConfig {
            epoch: EPOCH,
            nodes: self.nodes.into(),
            threads: self.threads.into(),
            threads_per_core: self.threads_per_core(),
            tiles: self.tiles(),
            balancer: self.balancer,
            resend_us: RESEND_US,
            confirms: self.confirms,
            seed: 1,
        }
    }
}
