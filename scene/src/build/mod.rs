//! Builds the multi-level grid over a mesh.
//!
//! # How it goes
//! 1. [`prepare`]: checks the mesh, scales it exactly to unit size, lays the grid's cube around it, and
//!    chooses the slack ([`crowd`]).
//! 2. [`keys`]: gives every triangle the Morton code of the finest cell that holds its middle, and sorts by
//!    it. A triangle is *resident* in the cells above that one, down to the last whose padded box holds all
//!    of it. After the sort the residents of a cell are a range, so going down the grid moves no data.
//!    Triangles that repeat an earlier one are dropped here.
//! 3. [`grow`]: goes down from the root. A triangle too large for its cell on some level becomes a *visitor*:
//!    it is handed to every cell that it overlaps by more than the slack ([`overlap`]). Cells are merged into
//!    runs with one cluster each ([`runs`]).
//!
//! The result is the same for any number of threads. Memory is about the mesh, 16 bytes a triangle for the
//! sort, and 5 for the result; the clusters themselves are made while an image is written.

mod crowd;
mod error;
mod grow;
mod keys;
mod overlap;
mod prepare;
mod runs;
#[cfg(test)]
mod tests;
mod vertex_set;

use core::sync::atomic::{AtomicU64, Ordering};

use rt_core::grid::{Branch, GridShape, Leaf};
use rt_core::{Bounds, SceneNeeds};

pub use error::BuildError;
pub(crate) use vertex_set::VertexSet;

use crate::mesh::Mesh;

/// How to build a grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BuildOptions {
    /// By how much cells are padded, in typical edges; less where that would crowd cells, as in a landscape
    /// with a statue of much smaller triangles. More means fewer copies of triangles that straddle
    /// cells, and more cells for a ray to look into. 0 is allowed.
    pub slack: f32,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self { slack: 0.5 }
    }
}

/// How far a build or a write has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// What is being done.
    pub stage: Stage,
    /// Triangles done.
    pub done: u64,
    /// Triangles in all.
    pub total: u64,
}

/// A stage of preparing a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Checking the mesh and sorting its triangles.
    Sort,
    /// Growing the grid.
    Grow,
    /// Writing the image.
    Write,
}

/// A mesh with its grid: everything of a scene image but the page size.
///
/// Made by [`build`]; written by [`write`](Self::write) or [`to_bytes`](Self::to_bytes).
#[derive(Clone, Debug)]
pub struct Scene {
    /// The mesh in grid units.
    pub(crate) mesh: Mesh,
    /// Bounds of the mesh in world units.
    pub(crate) bounds: Bounds,
    pub(crate) needs: SceneNeeds,
    pub(crate) collapsed: u64,
    pub(crate) repeated: u64,
    pub(crate) grid: GridShape,
    pub(crate) typical_edge: f32,
    pub(crate) scale_exponent: i32,
    pub(crate) tree: Tree,
}

/// The records of a grid, or of a part of it, with indices from the start of that part.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tree {
    /// Branches, the root first.
    pub(crate) branches: Vec<Branch>,
    /// Leaves; the place of a cluster is still open.
    pub(crate) leaves: Vec<Leaf>,
    /// Leaves that have clusters, in address order.
    pub(crate) clusters: Vec<u32>,
    /// Triangles in address order, cluster by cluster.
    pub(crate) ids: Vec<u32>,
    /// Levels of branches.
    pub(crate) levels: u32,
}

/// Builds the grid over `mesh`, on all threads of the current rayon pool.
///
/// # Errors
/// When the mesh cannot be traced; says why, and where in the mesh.
pub fn build(
    mesh: Mesh,
    options: &BuildOptions,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Scene, BuildError> {
    let total = mesh.triangles.len() as u64;
    progress(Progress { stage: Stage::Sort, done: 0, total });
    let mut prepared = prepare::prepare(mesh, options)?;
    let mut entries = keys::sorted(&prepared.mesh, &prepared.grid);
    let collapsed = total - entries.len() as u64;
    let repeated = keys::drop_repeated(&prepared.mesh, &mut entries);
    let ticker = Ticker { progress, done: AtomicU64::new(0), total };
    let tree = grow::grow(&prepared.mesh, &prepared.grid, &entries, &ticker);
    if u32::try_from(tree.ids.len()).is_err() {
        return Err(BuildError::TooManyTriangles { count: tree.ids.len() as u64 });
    }
    prepared.grid.levels = tree.levels;
    let prepare::Prepared { mesh, bounds, grid, typical_edge, scale_exponent } = prepared;
    Ok(Scene {
        mesh,
        bounds,
        needs: SceneNeeds::TRIANGLES,
        collapsed,
        repeated,
        grid,
        typical_edge,
        scale_exponent,
        tree,
    })
}

/// Tells the caller's progress function now and then how many triangles have found their cluster.
struct Ticker<'a> {
    progress: &'a (dyn Fn(Progress) + Sync),
    done: AtomicU64,
    total: u64,
}

impl Ticker<'_> {
    fn add(&self, triangles: u64) {
        // Relaxed: a counter for people; it orders nothing.
        let done = self.done.fetch_add(triangles, Ordering::Relaxed) + triangles;
        (self.progress)(Progress { stage: Stage::Grow, done: done.min(self.total), total: self.total });
    }
}
