//! A cluster in virtual time: state machines over lossy links, with crashes, all from one seed.
//!
//! The state machines are those of `dsm-core`, byte for byte: what runs here runs in the field. Around them are up to
//! 4096 nodes with threads that touch pages, links with latency, bandwidth, loss, duplication and reordering, and a
//! world in which nodes crash and come back, stall, slow down, are cut off, and have clocks that jump. Nothing asks
//! what time it is, nothing allocates on the way, and a run is repeated, event for event, by its seed.
//!
//! # The map
//!
//! | module | what it holds |
//! |---|---|
//! | [`paging`] | a paging cluster: configuration, workloads, nodes, the oracle, the report |
//! | [`balance`] | a cluster that balances its tiles: configuration, nodes, display, report |
//! | [`verify`] | trying many seeds, and telling which one failed |
//! | [`cluster`] | the event core: any state machine that is an [`Actor`](cluster::Actor), one for each node |
//! | [`network`] | cards, links and queues |
//! | [`fault`] | what goes wrong, by a schedule or by chance |
//! | [`time`], [`chance`] | nanoseconds of virtual time; streams of random numbers |
//!
//! # A cluster
//!
//! ```
//! use dsm_core::replacement::PolicyKind;
//! use dsm_sim::paging::{Config, Memory, World};
//!
//! // Eight nodes, 64 pages; a tenth of all messages is lost.
//! let mut config = Config::new(8, 64)?;
//! config.network = config.network.with_links(|link| link.loss_ppm = 100_000);
//!
//! let mut memory = Memory::new(config)?;
//! let report = World::new(&mut memory, PolicyKind::Clock, 7).run();
//! assert_eq!(report.total().failed_touches, 0);
//! assert!(report.total().resends > 0);
//! println!("{report}");
//! # Ok::<(), dsm_sim::paging::ConfigError>(())
//! ```
//!
//! # A variation of the protocol
//!
//! A policy of your own is a [`Replacement`](dsm_core::replacement::Replacement); `examples/own_policy.rs` tries one with
//! every invariant checked after every step, and shows what is said when it is wrong. A protocol of your own is an
//! [`Actor`](cluster::Actor):
//!
//! ```
//! use dsm_core::id::NodeId;
//! use dsm_sim::cluster::{Actor, Checks, Cluster, Ended, Io, Setup};
//! use dsm_sim::fault::Faults;
//! use dsm_sim::network::{Link, Links, Network};
//! use dsm_sim::time::{Moment, us};
//!
//! /// Node 0 says something to node 1 until that has answered.
//! #[derive(Default)]
//! struct Caller { is_answered: bool }
//!
//! impl Actor for Caller {
//!     type Message = &'static str;
//!     type Task = ();
//!
//!     fn handle_start(&mut self, io: &mut Io<'_, &'static str, ()>) {
//!         self.handle_task(io, ());
//!     }
//!
//!     fn handle_task(&mut self, io: &mut Io<'_, &'static str, ()>, (): ()) {
//!         if io.me() == NodeId(0) && !self.is_answered {
//!             io.send(NodeId(1), 100, "are you there?");
//!             io.work(us(50), ());
//!         }
//!     }
//!
//!     fn handle_message(&mut self, io: &mut Io<'_, &'static str, ()>, from: NodeId, _: &'static str) {
//!         self.is_answered = true;
//!         if io.me() == NodeId(1) {
//!             io.send(from, 100, "yes");
//!         }
//!     }
//!
//!     fn handle_crash(&mut self) {}
//!
//!     fn is_done(&self) -> bool {
//!         self.is_answered
//!     }
//! }
//!
//! // Nine of ten messages are lost; the others take 10 us.
//! let network = Network { links: Links::Same(Link { loss_ppm: 900_000, ..Link::new(us(10)) }), ..Network::PERFECT };
//! let setup = Setup { network, faults: Faults::default(), checks: Checks::AtEnd, seed: 7 };
//! let mut cluster = Cluster::new(setup, vec![Caller::default(), Caller::default()]);
//! assert_eq!(cluster.run(Moment::NEVER), Ended::Done);
//! assert!(cluster.now() > Moment::from_ns(us(20)));
//! ```
#![forbid(unsafe_code)]

pub mod balance;
pub mod chance;
pub mod cluster;
pub mod fault;
pub mod network;
pub mod paging;
mod queue;
pub mod time;
mod trace;
pub mod verify;
mod wires;
