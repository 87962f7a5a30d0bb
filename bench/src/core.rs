//! The state machine alone: what a fault costs it, whatever the number of pages, and what it keeps of each.

use std::hint::black_box;
use std::time::Instant as Stopwatch;

use anyhow::{Result, ensure};
use dsm_core::id::{NodeId, PageId, PortId};
use dsm_core::node::{Config, Fault, Node, Output};
use dsm_core::placement::Stripes;
use dsm_core::replacement::{Policy, PolicyKind};
use dsm_core::storage::{PageEntry, PeerEntry, RequestEntry, SlotEntry, Storage};
use dsm_core::time::Instant;
use dsm_core::wire::{HEADER_BYTES, Message};

use crate::experiment::{Effort, Experiment};
use crate::findings::{Aim, Findings};
use crate::plot::{Line, Plot};
use crate::space::Numbers;
use crate::spread::Spread;
use crate::table::{Cell, Table};
