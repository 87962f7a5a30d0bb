//! Merges neighbouring cells into runs whose triangles fit one cluster.

use core::iter;
use core::ops::Range;

use glam::Vec3;
use rt_core::Bounds;
use rt_core::grid::{TRIANGLES_MAX, cell_coordinates};

use super::overlap::Cube;
use super::prepare::corners;
use super::vertex_set::VertexSet;
use crate::mesh::Mesh;

/// The runs of one branch under construction.
///
/// Cells come in Morton order; each joins the last run if the triangles of both fit one cluster, else it
/// starts a run of its own.
#[derive(Debug)]
pub(super) struct Runs {
    /// Triangles of all chunks, one after the other.
    pub(super) ids: Vec<u32>,
    pub(super) chunks: Vec<Chunk>,
    pub(super) list: Vec<Run>,
    /// Whether the last run may still grow.
    open: bool,
    /// Vertices of the last chunk.
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
    pub(super) ids: Range<usize>,
    pub(super) vertices: u8,
    /// Box of the triangles' parts inside the padded cells of the run.
    pub(super) bounds: LocalBox,
}

/// A box that counts from the lowest corner of a branch; exact, wherever the branch lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LocalBox {
    pub(super) low: [f64; 3],
    pub(super) high: [f64; 3],
}

impl LocalBox {
    /// A box that holds nothing.
    pub(super) const EMPTY: Self = Self { low: [f64::INFINITY; 3], high: [f64::NEG_INFINITY; 3] };

    /// The smallest box that contains both.
    pub(super) fn union(self, other: Self) -> Self {
        let low = [0, 1, 2].map(|axis| self.low[axis].min(other.low[axis]));
        let high = [0, 1, 2].map(|axis| self.high[axis].max(other.high[axis]));
        Self { low, high }
    }

    /// The part inside the other box.
    fn clip(self, other: &Self) -> Self {
        let low = [0, 1, 2].map(|axis| self.low[axis].max(other.low[axis]));
        let high = [0, 1, 2].map(|axis| self.high[axis].min(other.high[axis]));
        Self { low, high }
    }
}

/// A cell with its padding.
#[derive(Clone, Copy, Debug)]
pub(super) struct PaddedCell {
    /// Index of the cell.
    pub(super) cell: u32,
    /// Lowest corner of its branch.
    pub(super) corner: Vec3,
    pub(super) bounds: LocalBox,
}

impl PaddedCell {
    pub(super) fn new(cube: &Cube, cell: u32, slack: f32) -> Self {
        let (edge, slack) = (f64::from(cube.cell), f64::from(slack));
        let low = cell_coordinates(cell).map(|i| f64::from(i) * edge - slack);
        Self {
            cell,
            corner: cube.corner,
            bounds: LocalBox { low, high: low.map(|x| x + edge + slack * 2.0) },
        }
    }

    /// The part of a box in grid units inside the padded cell.
    fn clip(&self, bounds: &Bounds) -> LocalBox {
        let local = |point: Vec3| [0, 1, 2].map(|axis| f64::from(point[axis]) - f64::from(self.corner[axis]));
        LocalBox { low: local(bounds.low), high: local(bounds.high) }.clip(&self.bounds)
    }
}

impl Runs {
    pub(super) const fn new() -> Self {
        Self {
            ids: Vec::new(),
            chunks: Vec::new(),
            list: Vec::new(),
            open: false,
            vertices: VertexSet::new(),
        }
    }

    /// Adds a cell to the last run or as a new one; `false` when its triangles alone are too many for a
    /// cluster.
    pub(super) fn add(
        &mut self,
        mesh: &Mesh,
        cell: &PaddedCell,
        ids: impl Iterator<Item = u32> + Clone,
    ) -> bool {
        if self.open && self.extend(mesh, cell, ids.clone()) {
            if let Some(run) = self.list.last_mut() {
                run.cells |= 1 << cell.cell;
            }
            return true;
        }
        self.begin_chunk();
        self.open = self.extend(mesh, cell, ids);
        if self.open {
            self.list.push(Run {
                cells: 1 << cell.cell,
                chunks: self.chunks.len() - 1..self.chunks.len(),
                is_list: false,
            });
        } else {
            self.chunks.pop();
        }
        self.open
    }

    /// Adds a cell that cannot be split as a run of its own, in as many chunks as it takes.
    pub(super) fn add_list(&mut self, mesh: &Mesh, cell: &PaddedCell, ids: impl Iterator<Item = u32>) {
        let first = self.chunks.len();
        self.begin_chunk();
        for id in ids {
            if !self.extend(mesh, cell, iter::once(id)) {
                self.begin_chunk();
                self.extend(mesh, cell, iter::once(id));
            }
        }
        self.open = false;
        self.list.push(Run { cells: 1 << cell.cell, chunks: first..self.chunks.len(), is_list: true });
    }

    fn begin_chunk(&mut self) {
        self.vertices.clear();
        self.chunks.push(Chunk { ids: self.ids.len()..self.ids.len(), vertices: 0, bounds: LocalBox::EMPTY });
    }

    /// Adds the triangles of a cell to the last chunk, each once; `false`, and no triangle added, when they
    /// do not fit.
    fn extend(&mut self, mesh: &Mesh, cell: &PaddedCell, ids: impl Iterator<Item = u32>) -> bool {
        let Some(chunk) = self.chunks.last_mut() else { return false };
        let mut bounds = Bounds { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY };
        for id in ids {
            let triangle = corners(mesh, mesh.triangles[id as usize]);
            for corner in triangle {
                bounds = Bounds { low: bounds.low.min(corner), high: bounds.high.max(corner) };
            }
            let held = &self.ids[chunk.ids.start..];
            if held.contains(&id) {
                continue;
            }
            let fits = held.len() < usize::from(TRIANGLES_MAX)
                && triangle.iter().all(|corner| self.vertices.insert(corner.to_array()).is_some());
            if !fits {
                self.ids.truncate(chunk.ids.end);
                return false;
            }
            self.ids.push(id);
        }
        chunk.ids.end = self.ids.len();
        chunk.vertices = self.vertices.count();
        chunk.bounds = chunk.bounds.union(cell.clip(&bounds));
        true
    }
}
