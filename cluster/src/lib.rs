//! A cluster that renders one scene: a supervisor, nodes that render, stores that hold pages.
//!
//! # The map
//!
//! | module | what it holds |
//! |---|---|
//! | [`command_line`] | `memsavvy render`, `prepare`, `info`, `session`, `trace`: flags, help, errors |
//! | [`size`] | `16K`, `40%`, `640x480`: how people write sizes |
//! | [`plan`] | from what was asked for to what each process may hold; pure arithmetic |
//! | [`run`] | a whole run: plan, start, frames, report |
//! | `supervisor` | starts processes, watches them, ends them |
//! | `balance` | a node's part of the balance: which tile is drawn next, and by whom |
//! | [`gather`] | tiles on their way from the threads that draw them to the displays |
//! | `loss` | processes that die while the others go on |
//! | `control`, `link` | what supervisor and nodes say to each other, and the socket it goes over |
//! | `node`, `painter`, `noted`, `ports` | a process of the cluster: its pages, its render threads and what they use, its ways to the others |
//! | `scene_source` | where the scene comes from: a mesh, a volume, an image, a built-in scene |
//! | [`session`] | what is looked at, moment by moment: made, read, written, replayed |
//! | `isovalue` | which isosurfaces of a volume are shown |
//! | [`trace`] | the pages that a session touches, recorded to compare replacement policies |
//! | [`report`] | what a run prints and writes |
//! | [`diagnostic`] | pictures of who draws what, who owns what, where misses and time go |
//! | `describe` | a volume in words and bars |
//! | `picture`, `output` | pixels to PNG, and their hash; files that are whole or not there |
//! | `varint` | numbers in as few bytes as they need |
//!
//! # Life of a run
//!
//! 1. The supervisor builds or opens the scene image and [plans](plan::Plan): pages, stripes, slots.
//! 2. It starts a process for each node and store, each with a socket as its standard input, and sends each the plan
//!    and the files: the image to read its own stripes from, its peers' pages to read the others'.
//! 3. Each process fills its home pages; when all have, the supervisor lets the image go. Nobody holds it whole.
//! 4. Frame by frame: camera, light and isovalues go out and tiles are dealt, every node draws its tiles and takes some from
//!    others when it has none left, finished tiles come back.
//! 5. The nodes report and end.
//!
//! Nothing of this has a name outside the processes: memory files and sockets vanish with the last of them, however
//! they end.

mod balance;
pub mod command_line;
mod control;
mod describe;
pub mod diagnostic;
pub mod gather;
mod isovalue;
mod link;
mod loss;
mod node;
mod output;
mod painter;
mod picture;
pub mod plan;
mod ports;
mod progress;
pub mod report;
pub mod run;
mod scene_source;
pub mod session;
pub mod size;
mod supervisor;
pub mod trace;
mod varint;

pub use node::run_as_node_if_asked;
