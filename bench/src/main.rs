//! The experiments: tables and figures of the paper and of ours, printed, written as JSON and plotted.
//!
//! # The map
//!
//! | module | what it holds |
//! |---|---|
//! | [`experiment`] | the list of experiments; a new one adds its file and a line there |
//! | [`command_line`] | names and flags |
//! | [`table1`] | hits and misses, as in the paper's Table 1 |
//! | [`scaling`] | frame rate over nodes and memory |
//! | [`paging_core`] | what one fault costs the state machine alone |
//! | [`fig7`] | misses and frame rate by balancer, as in the paper's Figure 7 |
//! | [`table3`] | communication at the display and frame rate from 2 to 1024 nodes, as in the paper's Table 3 |
//! | [`balance`] | stiff cases of balancing in virtual time |
//! | [`replacement`] | misses of the replacement policies, and what prefetch spares |
//! | [`step_aside`] | what threads do about pages that are absent |
//! | [`gather`] | bytes from the nodes to the display, and its time for a tile |
//! | [`embree`] | our kernels against Embree 3 and 4 |
//! | [`peers`] | other programs that draw what we draw, and our kernels beside them |
//! | [`fig5`] | a session on a volume, as in the paper's Figure 5 |
//! | [`iso`] | isosurfaces against flying edges and Embree |
//! | [`iso_error`] | isosurfaces: error against run time |
//! | [`left_out`] | what a scene does not need |
//! | [`triangle_tests`] | error against run time of the triangle tests |
//! | [`sim`] | the simulator: events a second |
//! | [`findings`], [`table`], [`plot`], [`spread`] | what an experiment gives back, and how it is shown |
//! | [`quiet`] | telling quiet rounds from those in which other programs wanted the machine |
//! | [`distance`] | how far apart the cores are at the moment |
//! | [`data`], [`volumes`] | the folder with real meshes and scans; volumes to look at |
//! | [`machine`] | what stands beside every figure: processor, kernel, commit |
//! | [`space`], [`owner`], [`memory`] | a shared space to read, the process that owns it, memory to compare with |
//!
//! Every experiment first asserts that its subject is right, and then times it, in turns with what it is compared
//! with: absolute times of a shared machine mean little, ratios of neighbouring moments mean much.

mod balance;
mod command_line;
mod data;
mod distance;
mod embree;
mod experiment;
mod fig5;
mod fig7;
mod findings;
mod gather;
mod images;
mod iso;
mod iso_error;
mod left_out;
mod machine;
mod memory;
mod owner;
mod paging_core;
mod peers;
mod plot;
mod prefetch;
mod quiet;
mod replacement;
mod scaling;
mod sim;
mod space;
mod spread;
mod step_aside;
mod table;
mod table1;
mod table3;
mod triangle_tests;
mod volumes;

use std::process::ExitCode;

fn main() -> ExitCode {
    memsavvy::run_as_node_if_asked().or_else(owner::run_as_owner_if_asked).unwrap_or_else(command_line::main)
}
