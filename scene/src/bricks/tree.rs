//! The tree of ranges, in memory.

use rt_core::grid::{cell_coordinates, cell_index};
use rt_core::volume::RangeBranch;

use super::survey::Survey;

/// The branches of a volume's ranges, in the order of the image.
#[derive(Debug)]
pub(super) struct RangeTree {
    pub(super) branches: Vec<RangeBranch>,
    pub(super) levels: u32,
    /// Bricks that are present.
    pub(super) bricks: u64,
}

impl RangeTree {
    /// The tree over the bricks that show anything; their ranges are empty yet.
    pub(super) fn over(survey: &Survey, levels: u32) -> Self {
        let mut tree = Self { branches: Vec::new(), levels, bricks: 0 };
        if shows(survey, levels, [0; 3]) {
            tree.branches.push(EMPTY);
            tree.grow(survey, 0, levels - 1, [0; 3]);
        }
        tree
    }

    /// Number of a brick that is present.
    pub(super) fn brick(&self, at: [u32; 3]) -> Option<u64> {
        let (branch, cell) = self.lowest(at)?;
        let branch = self.branches.get(branch)?;
        (branch.present >> cell & 1 != 0).then(|| branch.child_of(cell)).flatten()
    }

    /// Sets the bytes of a brick's range.
    pub(super) fn set(&mut self, at: [u32; 3], low: u8, high: u8) {
        if let Some((branch, cell)) = self.lowest(at) {
            let branch = &mut self.branches[branch];
            (branch.low[cell as usize], branch.high[cell as usize]) = (low, high);
        }
    }

    /// Makes the ranges of branches from those of the bricks.
    pub(super) fn close(&mut self) {
        if !self.branches.is_empty() {
            self.close_branch(0, self.levels - 1);
        }
    }

    /// Fills a branch with `below` levels of branches under it; children together, then what is under each.
    fn grow(&mut self, survey: &Survey, index: usize, below: u32, first_brick: [u32; 3]) {
        let children: Vec<u32> =
            (0..64).filter(|&cell| shows(survey, below, child_of(first_brick, cell, below))).collect();
        let present = children.iter().fold(0, |present, cell| present | 1 << cell);
        let first = if below == 0 { self.bricks } else { self.branches.len() as u64 };
        self.branches[index] = RangeBranch { present, first, ..EMPTY };
        if below == 0 {
            self.bricks += children.len() as u64;
            return;
        }
        let start = self.branches.len();
        self.branches.resize(start + children.len(), EMPTY);
        for (child, cell) in children.into_iter().enumerate() {
            self.grow(survey, start + child, below - 1, child_of(first_brick, cell, below));
        }
    }

    fn close_branch(&mut self, index: usize, below: u32) -> (u8, u8) {
        let mut branch = self.branches[index];
        let (mut low, mut high) = (u8::MAX, 0);
        for cell in (0..64_u32).filter(|cell| branch.present >> cell & 1 != 0) {
            let at = cell as usize;
            if let Some(below) = below.checked_sub(1) {
                let child = branch.child_of(cell).and_then(|child| usize::try_from(child).ok()).unwrap_or(0);
                (branch.low[at], branch.high[at]) = self.close_branch(child, below);
            }
            (low, high) = (low.min(branch.low[at]), high.max(branch.high[at]));
        }
        self.branches[index] = branch;
        (low, high)
    }

    /// The lowest branch over a brick, and the brick's place in it.
    fn lowest(&self, at: [u32; 3]) -> Option<(usize, u32)> {
        let cell = |level: u32| cell_index(at.map(|x| x >> (2 * level) & 3));
        let mut index = 0;
        for level in (1..self.levels).rev() {
            let branch = self.branches.get(index)?;
            if branch.present >> cell(level) & 1 == 0 {
                return None;
            }
            index = usize::try_from(branch.child_of(cell(level))?).ok()?;
        }
        Some((index, cell(0)))
    }
}

/// Whether any brick shows anything in a cube of `4^level` bricks a side.
fn shows(survey: &Survey, level: u32, first: [u32; 3]) -> bool {
    let bricks = survey.bricks();
    if (0..3).any(|axis| first[axis] >= bricks[axis]) {
        return false;
    }
    if level == 0 {
        return survey.is_varied(first);
    }
    (0..64).any(|cell| shows(survey, level - 1, child_of(first, cell, level - 1)))
}

/// The first brick of a child with `below` levels of branches under it.
fn child_of(first: [u32; 3], cell: u32, below: u32) -> [u32; 3] {
    let at = cell_coordinates(cell);
    [0, 1, 2].map(|axis| first[axis] + (at[axis] << (2 * below)))
}

const EMPTY: RangeBranch = RangeBranch { low: [0; 64], high: [0; 64], present: 0, first: 0 };
