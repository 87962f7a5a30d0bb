//! Other programs that draw what we draw, and our kernels beside them.
//!
//! # The map
//!
//! | module | what it holds |
//! |---|---|
//! | [`child`] | a program that obeys lines |
//! | [`program`], [`embree`] | compiling `peers/embree.cpp`; a running one, and what it is told |
//! | [`ours`] | our kernels as competitors |
//! | [`drawn`], [`stopwatch`] | what a picture gave, and the processor time it took |
//! | [`level`], [`pinned`] | vector widths, and one core for everybody |
//! | [`folder`] | where files go that one program writes and another reads |

pub(crate) mod child;
pub(crate) mod drawn;
pub(crate) mod embree;
pub(crate) mod folder;
pub(crate) mod level;
pub(crate) mod ours;
pub(crate) mod pinned;
pub(crate) mod program;
pub(crate) mod stopwatch;
