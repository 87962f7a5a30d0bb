//! The numbers that name things. Newtypes, so that `slots[page]` does not compile.

use core::fmt;

/// Names a page of the shared address space, counted from its start.
///
/// Byte `b` of the scene image lies in page `b / page_bytes`. At most `2^32 - 1` pages: at 16 KB, 64 TB.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PageId(pub u32);

/// Names a place in this node's cache that holds one page. In `0..Storage::slots.len()`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SlotId(pub u32);

/// Names one process of the cluster. In `0..`[`MAX_NODES`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(pub u16);

/// Names one of a node's ways out: the endpoint of a transport that a single thread owns.
///
/// A request leaves through the port of the thread that faulted, so its answer comes back to that thread and no
/// other has to be woken. A driver with one thread uses port 0 for everything.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PortId(pub u8);

/// Numbers a time during which the scene and the members of the cluster do not change.
///
/// Stands in every message; a message of another epoch is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Epoch(pub u32);

/// Names one run of one cluster, so that a message that strayed from another one is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ClusterId(pub u64);

/// Counts how often a node has come back under its number; a node that comes back is a new node.
///
/// Stands in every message, for its sender and for its receiver. A node must never come back with an incarnation it has
/// had before in the same run: whoever starts it counts. After 65,535 returns a number is used up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Incarnation(pub u16);

/// Nodes that a cluster can have at most.
pub const MAX_NODES: u16 = 4096;

impl PageId {
    /// The page as a place in an array.
    #[inline]
    #[must_use]
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

impl SlotId {
    /// The slot as a place in an array.
    #[inline]
    #[must_use]
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

impl NodeId {
    /// The node as a place in an array.
    #[inline]
    #[must_use]
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

impl fmt::Display for PageId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "page {}", self.0)
    }
}

impl fmt::Display for NodeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "node {}", self.0)
    }
}
