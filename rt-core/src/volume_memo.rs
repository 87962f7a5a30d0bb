//! What the rays of a tile found out about branches and bricks, for the next ray of it.
//!
//! Neighbouring rays meet the same branches and bricks. Which children may hold a surface, and which voxel cells have
//! samples on both sides of an isovalue, depends on the isovalues alone; so it is kept for the time of a tile, in a few
//! kilobytes that the caller has on its stack. Nothing of it shows in a picture.

use crate::brick::Brick;
use crate::volume::BRICK_EDGE;

/// Somewhere to keep masks. That of `()` keeps nothing, for rays that come one by one.
pub(crate) trait Memo {
    /// The children of a branch to go into, and its numbers; `make` finds them out.
    fn branch<E>(&mut self, index: u64, make: impl FnOnce() -> Result<Children, E>) -> Result<Children, E>;

    /// Whether a voxel cell of a brick may hold a surface. `make` finds out about all cells of it.
    fn may_hold(&mut self, index: u64, cell: [i32; 3], make: impl FnOnce() -> CellMask) -> bool;
}

/// The children of a branch that a ray has to look at.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Children {
    /// Those that an isosurface may be in, one bit each.
    pub(crate) active: u64,
    /// Those that are stored.
    pub(crate) present: u64,
    /// Index of the first stored one.
    pub(crate) first: u64,
}

/// Voxel cells of a brick with samples on both sides of an isovalue, or with one that is absent: by z, then bit
/// `x + 8 y`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CellMask([u64; 7]);

impl Children {
    /// Index of a child that is stored, or `None` on overflow.
    #[inline]
    pub(crate) const fn child_of(&self, cell: u32) -> Option<u64> {
        self.first.checked_add((self.present & ((1 << cell) - 1)).count_ones() as u64)
    }
}

impl CellMask {
    /// The mask for some isovalues.
    pub(crate) fn new(brick: &Brick<'_>, isovalues: impl Iterator<Item = f32>) -> Self {
        let mut mask = [0; 7];
        for isovalue in isovalues {
            let Self(crossed) = Self::of(&brick.inside(isovalue));
            mask.iter_mut().zip(crossed).for_each(|(cells, crossed)| *cells |= crossed);
        }
        Self(mask)
    }

    /// The mask for samples that are inside: for each z a bit `x + 8 y` each.
    #[inline(always)]
    pub(crate) fn of(inside: &[u64; BRICK_EDGE]) -> Self {
        let mut mask = [0; 7];
        for (cells, slices) in mask.iter_mut().zip(inside.windows(2)) {
            let [a, b] = [slices[0], slices[1]];
            let (any, all) = (a | b, a & b);
            let (any, all) = (any | any >> 1, all & all >> 1);
            *cells = (any | any >> 8) & !(all & all >> 8) & CELLS;
        }
        Self(mask)
    }

    /// The cells by z, none in the last slice.
    #[inline(always)]
    pub(crate) const fn slices(&self) -> [u64; BRICK_EDGE] {
        let [a, b, c, d, e, f, g] = self.0;
        [a, b, c, d, e, f, g, 0]
    }

    #[inline]
    const fn holds(&self, [x, y, z]: [i32; 3]) -> bool {
        self.0[z.cast_unsigned() as usize % 7] >> ((x + 8 * y).cast_unsigned() % 64) & 1 != 0
    }
}

impl Memo for () {
    #[inline]
    fn branch<E>(&mut self, _index: u64, make: impl FnOnce() -> Result<Children, E>) -> Result<Children, E> {
        make()
    }

    #[inline]
    fn may_hold(&mut self, _index: u64, _cell: [i32; 3], _make: impl FnOnce() -> CellMask) -> bool {
        true
    }
}

/// Masks of a tile, each kept until another of the same place comes.
pub(crate) struct TileMemo {
    branches: [(u64, Children); BRANCHES],
    bricks: [(u64, CellMask); BRICKS],
}

impl TileMemo {
    pub(crate) const fn new() -> Self {
        let nothing = Children { active: 0, present: 0, first: 0 };
        Self { branches: [(u64::MAX, nothing); BRANCHES], bricks: [(u64::MAX, CellMask([0; 7])); BRICKS] }
    }
}

impl Memo for TileMemo {
    #[inline]
    fn branch<E>(&mut self, index: u64, make: impl FnOnce() -> Result<Children, E>) -> Result<Children, E> {
        let slot = &mut self.branches[place(index, BRANCHES)];
        if slot.0 != index {
            *slot = (index, make()?);
        }
        Ok(slot.1)
    }

    #[inline]
    fn may_hold(&mut self, index: u64, cell: [i32; 3], make: impl FnOnce() -> CellMask) -> bool {
        let slot = &mut self.bricks[place(index, BRICKS)];
        if slot.0 != index {
            *slot = (index, make());
        }
        slot.1.holds(cell)
    }
}

#[inline]
const fn place(index: u64, places: usize) -> usize {
    #[expect(clippy::cast_possible_truncation, reason = "only low bits are wanted")]
    let low = index as usize;
    low % places
}

const BRANCHES: usize = 64;

const BRICKS: usize = 128;

/// A slice's lowest samples of cells: the last of a row, and the last row, are of none.
const CELLS: u64 = 0x007f_7f7f_7f7f_7f7f;
