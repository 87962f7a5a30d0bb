//! One thing that happened, and how a run ends.

use dsm_core::id::NodeId;

use crate::time::Moment;

/// Why a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// Every node is done.
    Done,
    /// The time given is over.
    TimeOver,
    /// Nothing more will ever happen, and yet somebody is not done.
    Stuck,
}

/// One thing that happened.
#[derive(Clone, Copy, Debug)]
pub struct Step<M, T> {
    /// The how manieth thing in this run, from 1.
    pub number: u64,
    /// When.
    pub at: Moment,
    /// To whom. Node 0 when it concerns all.
    pub node: NodeId,
    /// What.
    pub what: Happened<M, T>,
}

/// What can happen.
#[derive(Clone, Copy, Debug)]
pub enum Happened<M, T> {
    /// A message was taken in.
    Message {
        /// Its sender.
        from: NodeId,
        /// The message.
        message: M,
    },
    /// A task was done.
    Task(T),
    /// The node was told that another is dead.
    PeerDown(NodeId),
    /// A message or task waits for a busy card or for a stalled node.
    Held,
    /// A message or task came to nothing: cut off, no room, or the node is down or a new one.
    Lost,
    /// The node went down.
    Crashed,
    /// The node started again.
    Restarted,
    /// Another fault of the world, or its end.
    Fault,
}
