//! A page cache and its protocol as state machines: no IO, no clock, no allocation, no unsafe.
//!
//! A scene lies in one address range that every node reserves. Each page of it has a *home node*; every other
//! node may hold a copy in one of its *slots*. This crate decides: which page is asked for, whom to ask, which
//! page has to leave, what a message means, when to ask again and when to give up. It moves no byte and waits
//! for nobody; that is the work of the driver around it (`fault-linux` on Linux, a simulator, a test).
//!
//! # The map
//!
//! | module | what it holds |
//! |---|---|
//! | [`id`], [`time`] | the numbers: pages, slots, nodes, ports; microseconds |
//! | [`placement`] | which nodes hold which page |
//! | [`page_state`] | the life of a page in a cache, as one table of state and event |
//! | [`page_table`], [`storage`] | where that state is kept, in memory lent by the caller |
//! | [`replacement`] | which page has to leave: `random`, `fifo`, `clock`, `sieve`, `s3-fifo`, `recall` |
//! | [`page_sets`] | what each tile touched in the last frame, which foretells the next |
//! | [`prefetch`], `neighbours` | whether it pays to bring pages before anybody touches them, and how many |
//! | `request`, `fragments` | what has been asked for and not yet answered, and which parts of it have come |
//! | [`membership`], `round_trip` | which owners are alive, and how long to wait for an answer of each |
//! | [`wire`] | the messages: parse and emit |
//! | [`node`] | the state machine of a node that reads pages |
//! | [`home`] | the state machine of a node that owns pages |
//! | [`transport`] | the trait that carries messages, and the wrapper that loses them on purpose |
//! | [`failure`] | why a page cannot be had |
//! | [`stats`] | counters and a histogram of times |
//!
//! # How to drive a [`Node`](node::Node)
//!
//! Facts go in with the time, work comes out. One input, then poll until [`Output::Idle`](node::Output::Idle):
//!
//! ```
//! use dsm_core::node::{Config, Fault, Node, Output};
//! use dsm_core::placement::Stripes;
//! use dsm_core::replacement::{Policy, PolicyKind};
//! use dsm_core::storage::{PageEntry, PeerEntry, RequestEntry, SlotEntry, Storage};
//! use dsm_core::id::{Epoch, NodeId, PageId, PortId};
//! use dsm_core::time::Instant;
//! use dsm_core::wire::{Body, Message, HEADER_BYTES};
//!
//! // Two nodes, eight pages in stripes of one. This is node 0, with room for two pages of node 1.
//! let placement = Stripes::new(8, 1, NodeId(0), 2).unwrap();
//! let config = Config::new(NodeId(0), placement, 16384);
//! let mut pages = [PageEntry::EMPTY; 8];
//! let mut slots = [SlotEntry::EMPTY; 2];
//! let (mut peers, mut requests) = ([PeerEntry::EMPTY; 2], [RequestEntry::EMPTY; 4]);
//! let storage =
//!     Storage { pages: &mut pages, slots: &mut slots, peers: &mut peers, requests: &mut requests };
//! let mut node = Node::new(config, storage, Policy::new(PolicyKind::Fifo, 1)).unwrap();
//!
//! // A thread touches page 3. The node wants a message sent to its home.
//! let now = Instant::from_micros(10);
//! assert_eq!(node.handle_fault(now, PageId(3), PortId(0)), Fault::Fetch);
//! let mut buffer = [0; HEADER_BYTES];
//! let Output::Transmit { to: NodeId(1), len, .. } = node.poll(&mut buffer) else { panic!() };
//! let request = Message::parse(&buffer[..len]).unwrap();
//! assert!(matches!(node.poll(&mut buffer), Output::Idle(Some(_))));
//!
//! // The answer arrives: fill the slot, then say so.
//! let grant = request.grant(NodeId(1), 16384);
//! let len = grant.emit(&mut buffer);
//! node.handle_message(now, &buffer[..len]).unwrap();
//! assert!(matches!(node.poll(&mut buffer), Output::Map { page: PageId(3), .. }));
//! assert!(matches!(node.poll(&mut buffer), Output::Idle(_)));
//! node.handle_filled(now, PageId(3));
//! assert!(matches!(node.poll(&mut buffer), Output::Idle(None)));
//! assert_eq!(node.handle_fault(now, PageId(3), PortId(0)), Fault::Ready);
//! ```
#![no_std]
#![forbid(unsafe_code)]

pub mod failure;
mod fragments;
#[cfg(any(test, fuzzing))]
pub mod fuzzing;
pub mod home;
pub mod id;
pub mod membership;
#[cfg(mutants)]
pub mod mutants;
#[cfg(not(mutants))]
mod mutants;
mod neighbours;
pub mod node;
pub mod page_sets;
pub mod page_state;
pub mod page_table;
pub mod placement;
pub mod prefetch;
pub mod replacement;
mod request;
mod round_trip;
pub mod stats;
pub mod storage;
pub mod time;
pub mod transport;
pub mod wire;
