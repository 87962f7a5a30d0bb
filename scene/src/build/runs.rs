//! Merges neighbouring cells into runs whose primitives fit one cluster, or one of each kind.

use core::iter;
use core::ops::Range;

use rt_core::grid::{SPHERES_MAX, TRIANGLES_MAX};
use rt_core::surface::Surface;

use super::local_box::{LocalBox, PaddedCell};
use super::vertex_set::VertexSet;
use crate::model::Model;

/// The runs of one branch under construction.
///
/// Cells come in Morton order; each joins the last run if that holds the same kinds of primitives and those of
/// both fit one cluster of each kind, else it starts a run of its own.
#[derive(Debug)]
pub(super) struct Runs {
    pub(super) chunks: Vec<Chunk>,
    pub(super) list: Vec<Run>,
    /// Whether the last run may still grow.
    open: bool,
    /// Vertices of the last chunk of triangles.
    vertices: VertexSet,
}

/// What becomes a leaf of a branch.
#[derive(Clone, Debug)]
pub(super) struct Run {
    /// Its cells, one bit each.
    pub(super) cells: u64,
    /// Its chunks: one, unless the run is a list.
    pub(super) chunks: Range<usize>,
    pub(super) is_list: bool,
}

/// What becomes a cluster.
#[derive(Clone, Debug)]
pub(super) struct Chunk {
    pub(super) kind: Kind,
    pub(super) ids: Vec<u32>,
    /// Different corners of the triangles.
    pub(super) vertices: u8,
    /// Box of the primitives' parts inside the padded cells of the run.
    pub(super) bounds: LocalBox,
}

/// What a cluster is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Triangles,
    Spheres,
}

impl Runs {
    pub(super) const fn new() -> Self {
        Self { chunks: Vec::new(), list: Vec::new(), open: false, vertices: VertexSet::new() }
    }

    /// Adds a cell to the last run or as a new one; `false` when its primitives alone are too many for a cluster
    /// of each kind.
    pub(super) fn add(
        &mut self,
        model: &Model,
        cell: &PaddedCell,
        ids: impl Iterator<Item = u32> + Clone,
    ) -> bool {
        let kinds = [Kind::Triangles, Kind::Spheres].map(|kind| ids.clone().any(|id| kind.is_of(model, id)));
        if self.open && self.kinds_of_last() == kinds && self.extend_last(model, cell, ids.clone()) {
            if let Some(run) = self.list.last_mut() {
                run.cells |= 1 << cell.cell;
            }
            return true;
        }
        self.begin_run(cell, kinds);
        self.open = self.extend_last(model, cell, ids);
        if !self.open
            && let Some(run) = self.list.pop()
        {
            self.chunks.truncate(run.chunks.start);
        }
        self.open
    }

    /// Adds a cell that cannot be split as a run of its own, in as many chunks as it takes.
    pub(super) fn add_list(
        &mut self,
        model: &Model,
        cell: &PaddedCell,
        ids: impl Iterator<Item = u32> + Clone,
    ) {
        let first = self.chunks.len();
        for kind in [Kind::Triangles, Kind::Spheres] {
            let mut fits = false;
            for id in ids.clone().filter(|&id| kind.is_of(model, id)) {
                fits = fits && self.extend(self.chunks.len() - 1, model, cell, iter::once(id));
                if !fits {
                    self.begin_chunk(kind);
                    fits = self.extend(self.chunks.len() - 1, model, cell, iter::once(id));
                }
            }
        }
        self.open = false;
        self.list.push(Run { cells: 1 << cell.cell, chunks: first..self.chunks.len(), is_list: true });
    }

    /// Begins a run of one cell with an empty chunk for each of the kinds.
    fn begin_run(&mut self, cell: &PaddedCell, [triangles, spheres]: [bool; 2]) {
        let first = self.chunks.len();
        if triangles {
            self.begin_chunk(Kind::Triangles);
        }
        if spheres {
            self.begin_chunk(Kind::Spheres);
        }
        let chunks = first..self.chunks.len();
        self.list.push(Run { cells: 1 << cell.cell, is_list: chunks.len() > 1, chunks });
    }

    fn begin_chunk(&mut self, kind: Kind) {
        if kind == Kind::Triangles {
            self.vertices.clear();
        }
        self.chunks.push(Chunk { kind, ids: Vec::new(), vertices: 0, bounds: LocalBox::EMPTY });
    }

    fn kinds_of_last(&self) -> [bool; 2] {
        let chunks = self.list.last().map_or(0..0, |run| run.chunks.clone());
        let has = |kind| self.chunks[chunks.clone()].iter().any(|chunk| chunk.kind == kind);
        [has(Kind::Triangles), has(Kind::Spheres)]
    }

    /// Adds the primitives of a cell to the chunks of the last run; `false`, and nothing added, when they do not
    /// fit.
    fn extend_last(
        &mut self,
        model: &Model,
        cell: &PaddedCell,
        ids: impl Iterator<Item = u32> + Clone,
    ) -> bool {
        let chunks = self.list.last().map_or(0..0, |run| run.chunks.clone());
        // A run has one chunk or two; a state to come back to is needed for the first of two only.
        let state = |chunk: &Chunk| (chunk.ids.len(), chunk.vertices, chunk.bounds);
        let before = self.chunks[chunks.clone()].first().map(state);
        for index in chunks.clone() {
            let kind = self.chunks[index].kind;
            if !self.extend(index, model, cell, ids.clone().filter(|&id| kind.is_of(model, id))) {
                if let Some((length, vertices, bounds)) = before {
                    let first = &mut self.chunks[chunks.start];
                    first.ids.truncate(length);
                    (first.vertices, first.bounds) = (vertices, bounds);
                }
                return false;
            }
        }
        true
    }

    /// Adds the primitives of a cell to a chunk of their kind, each once; `false`, and no primitive added, when
    /// they do not fit.
    fn extend(
        &mut self,
        index: usize,
        model: &Model,
        cell: &PaddedCell,
        ids: impl Iterator<Item = u32>,
    ) -> bool {
        let chunk = &mut self.chunks[index];
        let before = chunk.ids.len();
        let mut bounds = LocalBox::EMPTY;
        for id in ids {
            let surface = model.surface(id);
            bounds = bounds.union(cell.clip(&surface));
            if chunk.ids.contains(&id) {
                continue;
            }
            let fits = chunk.ids.len() < chunk.kind.count_max()
                && match surface {
                    Surface::Triangle(corners) => {
                        corners.iter().all(|corner| self.vertices.insert(corner.to_array()).is_some())
                    }
                    Surface::Sphere(_) => true,
                };
            if !fits {
                chunk.ids.truncate(before);
                return false;
            }
            chunk.ids.push(id);
        }
        if chunk.kind == Kind::Triangles {
            chunk.vertices = self.vertices.count();
        }
        chunk.bounds = chunk.bounds.union(bounds);
        true
    }
}

impl Kind {
    fn is_of(self, model: &Model, id: u32) -> bool {
        model.is_sphere(id) == (self == Self::Spheres)
    }

    /// Most primitives of a cluster.
    fn count_max(self) -> usize {
        usize::from(match self {
            Self::Triangles => TRIANGLES_MAX,
            Self::Spheres => SPHERES_MAX,
        })
    }
}
