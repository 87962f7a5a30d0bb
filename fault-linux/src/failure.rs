//! A page that could not be had.

use core::fmt;

use dsm_core::failure::Failure;
use dsm_core::id::PageId;

use crate::sys::Errno;

/// A page that could not be had. It reads as zeros; nothing made from it is to be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PageFailure {
    /// The page.
    pub page: PageId,
    /// Why not.
    pub reason: Reason,
}

/// Why a page could not be had.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Reason {
    /// The cluster did not give it.
    Cluster(Failure),
    /// This system could not put it in place, or take another away for it.
    System(Errno),
}

impl fmt::Display for PageFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.reason {
            Reason::Cluster(failure) => write!(f, "{} cannot be had: {failure}", self.page),
            Reason::System(Errno(libc::EDEADLK)) => {
                write!(f, "{} cannot leave: a thread holds a record and waits for another", self.page)
            }
            Reason::System(errno) => write!(f, "{} cannot be put in place: {errno}", self.page),
        }
    }
}

impl core::error::Error for PageFailure {}
