//! Grows the tree of branches from the root down.

use rayon::prelude::*;
use rt_core::grid::{BoxFrame, Branch, GridShape, Leaf, SPHERES_MAX, TRIANGLES_MAX};

use super::keys::Entry;
use super::local_box::{LocalBox, PaddedCell};
use super::overlap::{Cube, cells_of};
use super::runs::{Chunk, Kind, Runs};
use super::{Ticker, Tree};
use crate::model::Model;

/// Grows the grid's tree over sorted entries.
pub(super) fn grow(model: &Model, grid: &GridShape, entries: &[Entry], ticker: &Ticker<'_>) -> Tree {
    let grower = Grower { model, grid, ticker };
    let cube = Cube { corner: grid.origin, cell: grid.size * 0.25, level: 1 };
    let copies = entries.len() as u64 * COPIES_PER_PRIMITIVE + COPIES_FREE;
    let root = grower.distribute(cube, &Content { residents: entries, visitors: &[] }, copies);
    let mut tree = Tree { branches: vec![Branch::default()], ..Tree::default() };
    tree.branches[0] = grower.branch(&root, &mut tree);
    tree
}

struct Grower<'a> {
    model: &'a Model,
    grid: &'a GridShape,
    ticker: &'a Ticker<'a>,
}

/// The primitives of a cell.
#[derive(Clone, Copy)]
struct Content<'a> {
    /// A range of the sorted entries; those that became visitors on a level above are skipped.
    residents: &'a [Entry],
    /// Primitives too large for the cell of their middle, handed to every cell that they overlap.
    visitors: &'a [u32],
}

impl Content<'_> {
    /// The primitives of a cell on `level`.
    fn ids(&self, level: u32) -> impl Iterator<Item = u32> + Clone {
        let residents =
            self.residents.iter().filter(move |entry| entry.depth() >= level).map(|entry| entry.id);
        residents.chain(self.visitors.iter().copied())
    }
}

/// The primitives of a branch, told apart by cell.
struct Split<'a> {
    cube: Cube,
    residents: &'a [Entry],
    /// Where each cell's residents end.
    resident_ends: [u32; 64],
    visitors: Vec<u32>,
    /// Where each cell's visitors end.
    visitor_ends: [u32; 64],
    /// Primitives of each cell, residents and visitors.
    counts: [u32; 64],
    /// Primitives of the branch before the split.
    before: u64,
    /// How many more copies the branch and all below it may hold than the branch has primitives.
    copies: u64,
}

impl Split<'_> {
    fn content(&self, cell: usize) -> Content<'_> {
        let range = |ends: &[u32; 64]| {
            (cell.checked_sub(1).map_or(0, |before| ends[before]) as usize)..ends[cell] as usize
        };
        Content {
            residents: &self.residents[range(&self.resident_ends)],
            visitors: &self.visitors[range(&self.visitor_ends)],
        }
    }

    fn after(&self) -> u64 {
        self.counts.iter().map(|&count| u64::from(count)).sum()
    }

    /// Whether the cells are worth their copies.
    ///
    /// A ray that meets the branch meets about a sixteenth of its cells. When every primitive is in half of
    /// those, nothing is won.
    fn is_worth_it(&self) -> bool {
        let after = self.after();
        after <= self.before * 8 && after - self.before.min(after) <= self.copies
    }

    /// Copies that `cell` may make: its share of what this split has left.
    fn copies_of(&self, cell: usize) -> u64 {
        let left = u128::from((self.copies + self.before).saturating_sub(self.after()));
        let share = left * u128::from(self.counts[cell]) / u128::from(self.after().max(1));
        u64::try_from(share).unwrap_or(u64::MAX)
    }
}

impl Grower<'_> {
    /// Tells the primitives of the branch at `cube` apart by cell.
    fn distribute<'a>(&self, cube: Cube, content: &Content<'a>, copies: u64) -> Split<'a> {
        let mut counts = [0; 64];
        let mut resident_ends = [0; 64];
        let mut before = content.visitors.len() as u64;
        let mut handed: Vec<(u8, u32)> = Vec::new();
        for (end, entry) in (1_u32..).zip(content.residents) {
            let cell = entry.cell(cube.level, self.grid.levels) as usize;
            resident_ends[cell] = end;
            before += u64::from(entry.depth() + 1 >= cube.level);
            if entry.depth() >= cube.level {
                counts[cell] += 1;
            } else if entry.depth() + 1 == cube.level {
                self.hand_over(entry.id, &cube, &mut handed);
            }
        }
        for &visitor in content.visitors {
            self.hand_over(visitor, &cube, &mut handed);
        }
        fill_gaps(&mut resident_ends);
        let (visitors, visitor_ends) = group(&handed, &mut counts);
        Split {
            cube,
            residents: content.residents,
            resident_ends,
            visitors,
            visitor_ends,
            counts,
            before,
            copies,
        }
    }

    fn hand_over(&self, id: u32, cube: &Cube, handed: &mut Vec<(u8, u32)>) {
        let mut cells = cells_of(&self.model.surface(id), cube, self.grid.slack);
        while cells != 0 {
            #[expect(clippy::cast_possible_truncation, reason = "a cell is below 64")]
            handed.push((cells.trailing_zeros() as u8, id));
            cells &= cells - 1;
        }
    }

    /// Adds all below the branch of `split` to `tree`, and returns the branch.
    fn branch(&self, split: &Split<'_>, tree: &mut Tree) -> Branch {
        let plan = self.plan(split);
        let mut branch = plan.branch();
        branch.child = index(tree.branches.len());
        branch.leaf = index(tree.leaves.len());
        tree.branches.resize(tree.branches.len() + plan.inner.len(), Branch::default());
        let chunk_leaves = self.add_leaves(&split.cube, &plan.runs, tree);
        let mut grown = self.grow_in_parallel(split, &plan);
        for item in &plan.order {
            match *item {
                Item::Run(run) => {
                    for chunk in plan.runs.list[run].chunks.clone() {
                        tree.add_cluster(chunk_leaves[chunk], &plan.runs.chunks[chunk].ids);
                    }
                }
                Item::Inner(inner) => {
                    let below = match grown.next() {
                        Some((root, below)) => tree.append(root, below),
                        None => self.branch(&plan.inner[inner].1, tree),
                    };
                    tree.branches[branch.child as usize + inner] = below;
                }
            }
        }
        tree.levels = tree.levels.max(split.cube.level);
        self.ticker.add(plan.runs.chunks.iter().map(|chunk| chunk.ids.len() as u64).sum());
        branch
    }

    /// Decides for every cell whether it joins a run, is split further, or becomes a list.
    fn plan<'s>(&self, split: &'s Split<'_>) -> Plan<'s> {
        let mut plan = Plan { runs: Runs::new(), inner: Vec::new(), order: Vec::new() };
        let cube = &split.cube;
        for cell in (0..64_u32).filter(|&cell| split.counts[cell as usize] > 0) {
            let content = split.content(cell as usize);
            let ids = content.ids(cube.level);
            let padded = PaddedCell::new(cube, cell, self.grid.slack);
            let runs = plan.runs.list.len();
            let small = split.counts[cell as usize] <= u32::from(TRIANGLES_MAX + SPHERES_MAX);
            if !(small && plan.runs.add(self.model, &padded, ids.clone())) {
                match self.split_further(split, cell, &content) {
                    Some(further) => {
                        plan.order.push(Item::Inner(plan.inner.len()));
                        plan.inner.push((cell, further));
                    }
                    None => plan.runs.add_list(self.model, &padded, ids),
                }
            }
            if plan.runs.list.len() > runs {
                plan.order.push(Item::Run(runs));
            }
        }
        plan
    }

    fn split_further<'s>(&self, split: &Split<'_>, cell: u32, content: &Content<'s>) -> Option<Split<'s>> {
        let cube = split.cube.inside(cell);
        if cube.level > self.grid.levels {
            return None;
        }
        let further = self.distribute(cube, content, split.copies_of(cell as usize));
        further.is_worth_it().then_some(further)
    }

    /// Adds the leaves of a branch, then those of its lists; returns the leaf of each chunk.
    fn add_leaves(&self, cube: &Cube, runs: &Runs, tree: &mut Tree) -> Vec<u32> {
        let frame = BoxFrame::new(cube.cell, self.grid.slack);
        let mut chunk_leaves = vec![0; runs.chunks.len()];
        let mut list_leaf = tree.leaves.len() + runs.list.len();
        for run in &runs.list {
            if run.is_list {
                let first = list_leaf;
                for chunk in run.chunks.clone() {
                    chunk_leaves[chunk] = index(list_leaf);
                    list_leaf += 1;
                }
                tree.leaves.push(list_leaf_of(&frame, &runs.chunks[run.chunks.clone()], first));
            } else {
                chunk_leaves[run.chunks.start] = index(tree.leaves.len());
                tree.leaves.push(cluster_leaf_of(&frame, &runs.chunks[run.chunks.start]));
            }
        }
        for run in runs.list.iter().filter(|run| run.is_list) {
            tree.leaves
                .extend(runs.chunks[run.chunks.clone()].iter().map(|chunk| cluster_leaf_of(&frame, chunk)));
        }
        chunk_leaves
    }

    /// What lies below the inner cells of a large branch, each part grown on its own; nothing for a small
    /// branch.
    fn grow_in_parallel(
        &self,
        split: &Split<'_>,
        plan: &Plan<'_>,
    ) -> impl Iterator<Item = (Branch, Tree)> + use<> {
        let inner = if split.before >= PARALLEL_MIN { plan.inner.as_slice() } else { &[] };
        let grow = |(_, split): &(u32, Split<'_>)| {
            let mut below = Tree::default();
            let root = self.branch(split, &mut below);
            (root, below)
        };
        inner.par_iter().map(grow).collect::<Vec<_>>().into_iter()
    }
}

/// What becomes of the cells of a branch.
struct Plan<'a> {
    runs: Runs,
    inner: Vec<(u32, Split<'a>)>,
    /// Runs and inner cells in Morton order of their first cells: the address order of what they hold.
    order: Vec<Item>,
}

/// Index of a run or of an inner cell in a [`Plan`].
enum Item {
    Run(usize),
    Inner(usize),
}

impl Plan<'_> {
    /// The masks of the branch.
    fn branch(&self) -> Branch {
        let mut branch = Branch::default();
        for run in &self.runs.list {
            branch.occupied |= run.cells;
            branch.run_start |= 1 << run.cells.trailing_zeros();
        }
        for (cell, _) in &self.inner {
            branch.occupied |= 1 << cell;
            branch.inner |= 1 << cell;
        }
        branch
    }
}

impl Tree {
    /// Adds the primitives of the cluster that `leaf` names.
    fn add_cluster(&mut self, leaf: u32, ids: &[u32]) {
        self.leaves[leaf as usize].first = index(self.ids.len());
        self.clusters.push(leaf);
        self.ids.extend_from_slice(ids);
    }

    /// Adds a part that was grown on its own, and returns its root, with indices that count from the start of
    /// this tree.
    fn append(&mut self, root: Branch, part: Self) -> Branch {
        let (branches, leaves) = (index(self.branches.len()), index(self.leaves.len()));
        let ids = index(self.ids.len());
        let moved = |branch: Branch| Branch {
            child: branch.child.saturating_add(branches),
            leaf: branch.leaf.saturating_add(leaves),
            ..branch
        };
        self.branches.extend(part.branches.into_iter().map(moved));
        self.leaves.extend(part.leaves.into_iter().map(|leaf| match leaf.cluster & Leaf::LIST {
            0 => Leaf { first: leaf.first.saturating_add(ids), ..leaf },
            _ => Leaf { cluster: leaf.cluster.saturating_add(leaves), ..leaf },
        }));
        self.clusters.extend(part.clusters.into_iter().map(|leaf| leaf.saturating_add(leaves)));
        self.ids.extend_from_slice(&part.ids);
        self.levels = self.levels.max(part.levels);
        moved(root)
    }
}

fn cluster_leaf_of(frame: &BoxFrame, chunk: &Chunk) -> Leaf {
    #[expect(clippy::cast_possible_truncation, reason = "a chunk has at most 64 primitives")]
    Leaf {
        cluster: 0,
        first: 0,
        bounds: frame.encode(chunk.bounds.low, chunk.bounds.high),
        vertices: if chunk.kind == Kind::Spheres { Leaf::SPHERES } else { chunk.vertices },
        count: chunk.ids.len() as u8,
    }
}

fn list_leaf_of(frame: &BoxFrame, chunks: &[Chunk], first: usize) -> Leaf {
    let bounds = chunks.iter().fold(LocalBox::EMPTY, |bounds, chunk| bounds.union(chunk.bounds));
    Leaf {
        cluster: Leaf::LIST | index(first),
        first: index(chunks.len()),
        bounds: frame.encode(bounds.low, bounds.high),
        vertices: 0,
        count: 0,
    }
}

/// Gives a cell without entries the end of the one before it.
fn fill_gaps(ends: &mut [u32; 64]) {
    for cell in 1..64 {
        ends[cell] = ends[cell].max(ends[cell - 1]);
    }
}

/// Groups primitives by cell, in the order in which they come, and adds them to the counts; returns them and
/// each cell's end.
fn group(handed: &[(u8, u32)], counts: &mut [u32; 64]) -> (Vec<u32>, [u32; 64]) {
    let mut ends = [0_u32; 64];
    for &(cell, _) in handed {
        ends[usize::from(cell)] += 1;
    }
    let mut end = 0;
    for (cell_end, count) in ends.iter_mut().zip(counts) {
        *count += *cell_end;
        end += *cell_end;
        *cell_end = end - *cell_end;
    }
    let mut grouped = vec![0; handed.len()];
    for &(cell, id) in handed {
        grouped[ends[usize::from(cell)] as usize] = id;
        ends[usize::from(cell)] += 1;
    }
    (grouped, ends)
}

/// An index of the image. Saturates: a tree that needs more than 32 bits is refused when it is complete.
fn index(value: usize) -> u32 {
    u32::try_from(value).unwrap_or(u32::MAX)
}

/// How many copies of a primitive there may be on average, itself not counted.
const COPIES_PER_PRIMITIVE: u64 = 3;

/// Copies that even the smallest model may make.
const COPIES_FREE: u64 = 1024;

/// A branch with this many primitives grows its inner cells in parallel.
const PARALLEL_MIN: u64 = 4096;
