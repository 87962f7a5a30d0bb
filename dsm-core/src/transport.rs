//! The trait that carries messages, and a wrapper that loses them on purpose.

use core::fmt;
use core::marker::PhantomData;

use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro128PlusPlus;

use crate::id::NodeId;
use crate::time::Instant;
use crate::wire::HEADER_BYTES;

/// One thread's way to the other nodes: what [`PortId`](crate::id::PortId) names.
///
/// Messages may be lost, doubled or overtaken; the state machines expect it. A transport must not allocate, lock or
/// block without a deadline: on Linux it is called from within a signal handler.
pub trait Transport {
    /// Sends a message to `to`. That it was sent does not mean that it arrives.
    ///
    /// # Errors
    /// It cannot have been sent. The caller may try again later.
    fn send(&mut self, to: NodeId, message: &[u8]) -> Result<(), SendError>;

    /// Waits for the next message, until `deadline` on the clock of the driver (on Linux `CLOCK_MONOTONIC` in
    /// microseconds). A deadline in the past only looks.
    ///
    /// What was received before may be overwritten from now on.
    fn receive(&mut self, deadline: Instant) -> Option<Received<'_>>;
}

/// A message that arrived: its header, copied out and not yet believed, and where the bytes behind it lie.
#[derive(Debug)]
pub struct Received<'a> {
    /// The first [`HEADER_BYTES`] bytes, for [`Message::parse`](crate::wire::Message::parse).
    pub header: [u8; HEADER_BYTES],
    /// The page bytes behind the header; empty unless it is a grant.
    pub body: Body<'a>,
}

/// Where the bytes behind a header lie, valid for `'a`.
///
/// A pointer and not a slice, because another process may have them mapped as well: they may only be copied, by a
/// means that does not mind if they change meanwhile.
#[derive(Clone, Copy)]
pub struct Body<'a> {
    start: *const u8,
    length: usize,
    lifetime: PhantomData<&'a [u8]>,
}

/// Why a message was not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SendError {
    /// This transport does not reach that node.
    NoRoute(NodeId),
    /// There is no room now.
    Full,
}

impl<'a> Body<'a> {
    /// Nothing.
    pub const EMPTY: Self = Self { start: core::ptr::null(), length: 0, lifetime: PhantomData };

    /// Bytes that belong to this process alone.
    #[must_use]
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self { start: bytes.as_ptr(), length: bytes.len(), lifetime: PhantomData }
    }

    /// Bytes that another process has mapped too. Whoever copies them relies on `start..start + length` being
    /// readable for `'a`; the transport that calls this says why they are.
    #[must_use]
    pub const fn shared(start: *const u8, length: usize) -> Self {
        Self { start, length, lifetime: PhantomData }
    }

    /// Where the bytes start.
    #[must_use]
    pub const fn as_ptr(&self) -> *const u8 {
        self.start
    }

    /// How many there are.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.length
    }

    /// Whether there are none.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.length == 0
    }
}

impl fmt::Debug for Body<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Body({} bytes)", self.length)
    }
}

/// A transport that loses messages, each way, with a chance of `per_mille` in a thousand.
///
/// The same seed loses the same messages. Wraps any other transport, in tests and in the field.
#[derive(Debug)]
pub struct Lossy<T> {
    inner: T,
    per_mille: u32,
    rng: Xoshiro128PlusPlus,
}

impl<T> Lossy<T> {
    /// Wraps `inner`. 0 loses nothing, 1000 everything.
    pub fn new(inner: T, per_mille: u32, seed: u64) -> Self {
        Self { inner, per_mille, rng: Xoshiro128PlusPlus::seed_from_u64(seed) }
    }

    fn loses(&mut self) -> bool {
        self.per_mille > 0 && self.rng.next_u32() % 1000 < self.per_mille
    }
}

impl<T: Transport> Transport for Lossy<T> {
    fn send(&mut self, to: NodeId, message: &[u8]) -> Result<(), SendError> {
        if self.loses() { Ok(()) } else { self.inner.send(to, message) }
    }

    fn receive(&mut self, deadline: Instant) -> Option<Received<'_>> {
        // A lost answer is received and dropped; the next look comes with the caller's next call.
        let lost = self.loses();
        self.inner.receive(deadline).filter(|_| !lost)
    }
}

impl fmt::Display for SendError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoRoute(to) => write!(f, "this transport does not reach {to}"),
            Self::Full => write!(f, "no room for another message"),
        }
    }
}

impl core::error::Error for SendError {}
