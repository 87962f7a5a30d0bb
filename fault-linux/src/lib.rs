//! The thin adapter between the memory hardware and `dsm-core`: reserve, catch the fault, map, evict.
//!
//! A [`Region`] is an address range in which a scene lies. A thread that has [attached](Region::attach) to it reads
//! it by plain loads. A load from an absent page ends up here, in that very thread: the page is fetched from its home
//! over the thread's own transport, made visible whole, and the load goes on. How is the [backend](BackendKind)'s
//! choice; this crate is the only place in the project that knows signals.
//!
//! # The safety contract
//!
//! Region memory is handed out as plain shared slices. That is sound although pages come and go, because *a byte that
//! can be read never changes while anyone may look*:
//!
//! - the scene is immutable within an epoch: whatever grants a page grants the same bytes each time, and nobody
//!   writes a home's page file after it was filled (the caller of [`Region::new`] promises both);
//! - absent-then-present is invisible to the program: a load either waits or returns those bytes;
//! - a page that cannot be had reads as zeros, once and for all, and [`Attached::check`] says so: results made
//!   from it are not to be used;
//! - the slices are readable only. A write is a bug, and dies as one.
//!
//! What is *not* promised: that a pointer into the region may be given to the kernel. A system call that meets an
//! absent page returns `EFAULT`; see [`Attached::touch`].
//!
//! # The signal handler
//!
//! Installed once per process for SIGBUS and SIGSEGV, with the handlers it found kept and called for whatever is not
//! ours: a fault outside every region, a write, a signal that somebody sent. A null pointer and a stack overflow die
//! as they always did. It runs on a stack of its own, keeps the error number, and makes only these calls, none of
//! which allocates or locks: `futex`, `clock_gettime`, `getpid`, `ioctl`, `mmap`, `mprotect`, `madvise`,
//! `process_madvise`, `pwrite`, `write` (to complain), and what the thread's [`Transport`](dsm_core::transport::Transport) makes.
//!
//! Under `--cfg loom` the crate shrinks to the lock and the words that threads wait on, which the model checker then
//! drives.

#![cfg_attr(
    all(loom, not(test)),
    expect(dead_code, reason = "most of what the lock and the words are for is not there")
)]

mod lock;
mod sync;
#[cfg(all(test, loom))]
mod waiting_model;
mod words;

#[cfg(not(loom))]
mod area;
#[cfg(not(loom))]
mod backend;
#[cfg(not(loom))]
mod failure;
#[cfg(not(loom))]
mod foresight;
#[cfg(not(loom))]
mod lent;
#[cfg(not(loom))]
mod paging;
#[cfg(not(loom))]
mod probe;
#[cfg(not(loom))]
mod region;
#[cfg(not(loom))]
mod signal;
#[cfg(not(loom))]
mod sys;
#[cfg(not(loom))]
mod thread;

#[cfg(not(loom))]
pub use {
    backend::{BackendKind, Record, UnknownBackend},
    failure::{PageFailure, Reason},
    probe::{Choice, Declined},
    region::{Region, RegionError, Setup},
    sys::Errno,
    thread::{AttachError, Attached, ThreadStats},
};
