//! Builds the multi-level grid over triangles and spheres.
//!
//! # How it goes
//! 1. [`prepare`]: checks the model, scales it exactly to unit size, lays the grid's cube around it, and
//!    chooses the slack ([`crowd`]).
//! 2. [`keys`]: gives every primitive (triangle or sphere) the Morton code of the finest cell that holds its
//!    middle, and sorts by it. A primitive is *resident* in the cells above that one, down to the last whose
//!    padded box holds all of it. After the sort the residents of a cell are a range, so going down the grid
//!    moves no data. Primitives that repeat an earlier one are dropped here.
//! 3. [`grow`]: goes down from the root. A primitive too large for its cell on some level becomes a *visitor*:
//!    it is handed to every cell that its surface overlaps by more than the slack ([`overlap`]). Cells are
//!    merged into runs with one cluster each, or one of each kind ([`runs`]).
//!
//! The result is the same for any number of threads. Memory is about the model, 16 bytes a primitive for the
//! sort, and 5 for the result; the clusters themselves are made while an image is written.

mod crowd;
mod error;
mod grow;
mod keys;
mod local_box;
mod overlap;
mod prepare;
mod runs;
mod surfaces;
#[cfg(test)]
mod tests;
mod vertex_set;

use core::sync::atomic::{AtomicU64, Ordering};

use rt_core::grid::{Branch, GridShape, Leaf};
use rt_core::{Bounds, SceneNeeds};

pub use error::BuildError;
pub(crate) use vertex_set::VertexSet;

use crate::model::Model;

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
        Self { slack: 0.625 }
    }
}

/// How far a build or a write has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// What is being done.
    pub stage: Stage,
    /// Triangles and spheres done.
    pub done: u64,
    /// Triangles and spheres in all.
    pub total: u64,
}

/// A stage of preparing a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Checking the model and sorting what it is made of.
    Sort,
    /// Growing the grid.
    Grow,
    /// Writing the image.
    Write,
}

/// A model with its grid: everything of a scene image but the page size.
///
/// Made by [`build`]; written by [`write`](Self::write) or [`to_bytes`](Self::to_bytes).
#[derive(Clone, Debug)]
pub struct Scene {
    /// The model in grid units, but for its view.
    pub(crate) model: Model,
    /// Bounds of the model in world units.
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
    /// Primitives in address order, cluster by cluster.
    pub(crate) ids: Vec<u32>,
    /// Levels of branches.
    pub(crate) levels: u32,
}

/// Builds the grid over a mesh or model, on all threads of the current rayon pool.
///
/// # Errors
/// When the model cannot be traced; says why, and where in the model.
pub fn build(
    model: impl Into<Model>,
    options: &BuildOptions,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Scene, BuildError> {
    let model = model.into();
    let total = model.count() as u64;
    progress(Progress { stage: Stage::Sort, done: 0, total });
    let mut prepared = prepare::prepare(model, options)?;
    let mut entries = keys::sorted(&prepared.model, &prepared.grid);
    let collapsed = total - entries.len() as u64;
    let repeated = keys::drop_repeated(&prepared.model, &mut entries);
    let ticker = Ticker { progress, done: AtomicU64::new(0), total };
    let tree = grow::grow(&prepared.model, &prepared.grid, &entries, &ticker);
    if u32::try_from(tree.ids.len()).is_err() {
        return Err(BuildError::TooManyTriangles { count: tree.ids.len() as u64 });
    }
    prepared.grid.levels = tree.levels;
    let prepare::Prepared { model, bounds, grid, typical_edge, scale_exponent } = prepared;
    Ok(Scene {
        needs: needs_of(&model),
        model,
        bounds,
        collapsed,
        repeated,
        grid,
        typical_edge,
        scale_exponent,
        tree,
    })
}

/// What kernels must know to trace the model.
fn needs_of(model: &Model) -> SceneNeeds {
    let of = |needed: bool, needs| if needed { needs } else { SceneNeeds::NONE };
    of(!model.mesh.triangles.is_empty(), SceneNeeds::TRIANGLES)
        .with(of(!model.spheres.is_empty(), SceneNeeds::SPHERES))
}

/// Tells the caller's progress function now and then how many primitives have found their cluster.
struct Ticker<'a> {
    progress: &'a (dyn Fn(Progress) + Sync),
    done: AtomicU64,
    total: u64,
}

impl Ticker<'_> {
    fn add(&self, primitives: u64) {
        // Relaxed: a counter for people; it orders nothing.
        let done = self.done.fetch_add(primitives, Ordering::Relaxed) + primitives;
        (self.progress)(Progress { stage: Stage::Grow, done: done.min(self.total), total: self.total });
    }
}
