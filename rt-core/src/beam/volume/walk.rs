//! The walk of a beam through the tree of ranges, front to back, and through the bricks that any of its rays enters.

use super::brick_cells::BrickCells;
use super::cross::{Cross, Look, Targets};
use super::packet::{CellBox, PACKETS, Packet, Packets};
use crate::beam::boxes::Boxes;
use crate::beam::frustum::CELLS;
use crate::beam::projection::Projection;
use crate::beam::triangles::Bounds;
use crate::brick::Brick;
use crate::count::Count;
use crate::grid::{FLIP_AXIS, cell_coordinates, flip_cells};
use crate::isosurface::{Budget, Isosurfaces};
use crate::memory::SceneMemory;
use crate::simd::{LANES, Mask, Simd, each};
use crate::volume::{BRICK_CELLS, RANGE_LEVELS_MAX};
use crate::volume_memo::Children;
use crate::volume_ray::VolumePlace;

/// Leads every brick to the targets that one of them may see a surface in. `None` when the image lies, a page cannot be
/// had, or a ray is not for beams.
#[inline(always)]
pub(super) fn walk<S: Simd, M: SceneMemory, C: Count, T: Targets<S>>(
    s: S,
    surfaces: &Isosurfaces<'_, M>,
    projection: &Projection,
    targets: &mut T,
    count: &mut C,
) -> Option<()> {
    let middle = projection.middle();
    let negative = |axis: usize| if middle[axis] < 0.0 { FLIP_AXIS[axis] } else { 0 };
    let flip = negative(0) | negative(1) | negative(2);
    let budget = Budget { branches: surfaces.volume.branches, bricks: surfaces.volume.bricks };
    let (mut brick, mut packets) = (BrickCells::new(), [Packet::none(s); PACKETS]);
    let packets = Packets::new(&mut packets, surfaces.place);
    Walk { s, surfaces, projection, flip, targets, count, budget, brick: &mut brick, packets }.run()
}

/// A walk under way.
struct Walk<'a, S: Simd, M, C, T> {
    s: S,
    surfaces: &'a Isosurfaces<'a, M>,
    projection: &'a Projection,
    /// Axes along which the beam runs backwards, as bits of a child's number.
    flip: u32,
    targets: &'a mut T,
    count: &'a mut C,
    budget: Budget,
    brick: &'a mut BrickCells,
    packets: Packets<'a, S>,
}

/// A branch that the beam is in.
#[derive(Clone, Copy)]
struct Visit {
    children: Children,
    corner: [i32; 3],
    /// Children still to visit, flipped so that the lowest bit is about the nearest.
    left: u64,
}

impl<S: Simd, M: SceneMemory, C: Count, T: Targets<S>> Walk<'_, S, M, C, T> {
    #[inline(always)]
    fn run(&mut self) -> Option<()> {
        let levels = self.surfaces.volume.levels as usize;
        let mut visit = self.enter(0, [0; 3], levels - 1)?;
        let mut above = [visit; RANGE_LEVELS_MAX as usize];
        // Branches above this one.
        let mut depth = 0;
        loop {
            if visit.left == 0 {
                if depth == 0 {
                    return Some(());
                }
                depth -= 1;
                visit = above[depth];
                continue;
            }
            let child = visit.left.trailing_zeros() ^ self.flip;
            visit.left &= visit.left - 1;
            let (edge, below) = (edge_of(levels - 1 - depth), levels - 2 - depth);
            let corner = child_corner(visit.corner, child, edge);
            let bounds =
                self.bounds(&CellBox { low: corner, high: corner.map(|low| low.wrapping_add(edge)) });
            if self.targets.interest(self.s, &bounds) != 0 {
                above[depth] = visit;
                depth += 1;
                visit = self.enter(visit.children.child_of(child)?, corner, below)?;
            }
        }
    }

    /// Reads a branch with `below` levels of branches under it, and culls its children. If they are bricks they are
    /// visited at once, and nothing is left.
    #[inline(always)]
    fn enter(&mut self, index: u64, corner: [i32; 3], below: usize) -> Option<Visit> {
        Budget::spend(&mut self.budget.branches).ok()?;
        self.count.branch();
        let children = self.surfaces.children(index).ok()?;
        let mut shown = 0;
        let mut bounds = [[[0.0; LANES]; 5]; 4];
        let least = self.targets.least(self.s);
        for (quarter, bounds) in bounds.iter_mut().enumerate() {
            let active = (children.active >> (LANES * quarter)) as Mask;
            if active != 0 {
                let boxes = self.boxes_of_children(corner, edge_of(below), quarter);
                let shows = self.projection.shows(self.s, &boxes, least) & active;
                shown |= u64::from(shows) << (LANES * quarter);
                let numbers = [boxes.left, boxes.right, boxes.top, boxes.bottom, boxes.near];
                bounds.iter_mut().zip(numbers).for_each(|(to, from)| self.s.store(from, to));
            }
        }
        let mut visit = Visit { children, corner, left: flip_cells(shown, self.flip) };
        while below == 0 && visit.left != 0 {
            let child = visit.left.trailing_zeros() ^ self.flip;
            visit.left &= visit.left - 1;
            let [left, right, top, bottom, near] =
                bounds[child as usize / LANES].map(|lanes| lanes[child as usize % LANES]);
            let bounds = Bounds { left, right, top, bottom, near };
            let wanted = self.targets.interest(self.s, &bounds);
            if wanted != 0 {
                self.visit(&children, child, child_corner(corner, child, BRICK_CELLS), wanted)?;
            }
        }
        Some(visit)
    }

    /// Reads a brick that a ray of one of these packets enters, and has them look for surfaces in it.
    #[inline(always)]
    fn visit(&mut self, children: &Children, child: u32, low: [i32; 3], wanted: u64) -> Option<()> {
        let volume = &self.surfaces.volume;
        let all = volume.cells();
        let high = [0, 1, 2].map(|axis| low[axis].wrapping_add(BRICK_CELLS).min(all[axis]));
        let cells = CellBox { low, high };
        if !self.is_entered(&cells, wanted)? {
            return Some(());
        }
        Budget::spend(&mut self.budget.bricks).ok()?;
        let record = self.surfaces.scene.brick(children.child_of(child)?).ok()?;
        self.count.brick();
        self.brick.fill(self.s, &Brick::new(volume.sample, &record)?, self.surfaces.sought(), &cells);
        drop(record);
        let around = self.bounds(&self.brick.around);
        let wanted = wanted & self.targets.interest(self.s, &around);
        let Self { s, surfaces, targets, count, brick, packets, .. } = self;
        s.apart(Cross {
            packets,
            wanted,
            look: Look { surfaces: *surfaces, targets: *targets, count: *count, brick },
        })
    }

    /// Whether any of the packets enters a box of cells.
    #[inline(always)]
    fn is_entered(&mut self, cells: &CellBox, mut packets: u64) -> Option<bool> {
        while packets != 0 {
            let number = packets.trailing_zeros() as usize;
            packets &= packets - 1;
            let limit = self.targets.limit(self.s, number);
            let packet = self.packets.get(self.s, &*self.targets, number)?;
            if packet.stretch(self.s, &packet.ends(self.s, cells), &limit).lanes != 0 {
                return Some(true);
            }
        }
        Some(false)
    }

    /// Where the sixteen children of a quarter of a branch show.
    #[inline(always)]
    fn boxes_of_children(&self, corner: [i32; 3], edge: i32, quarter: usize) -> Boxes<S::F> {
        let s = self.s;
        let first = CellBox { low: corner, high: corner.map(|low| low.wrapping_add(edge)) };
        let (first, half) = self.in_space(&first);
        let centre = each!(3: [0, 1, 2], axis => {
            s.add(s.splat(first[axis]), s.mul(s.load(&CELLS[axis][quarter]), s.splat(2.0 * half[axis])))
        });
        let half = each!(3: [0, 1, 2], axis => {
            s.splat(half[axis] + (first[axis].abs() + 8.0 * half[axis]) * ROUNDING)
        });
        self.projection.boxes(s, centre, half)
    }

    /// Where a box of cells shows.
    #[inline(always)]
    fn bounds(&self, cells: &CellBox) -> Bounds {
        box_of(self.s, self.surfaces, self.projection, cells).by_lane(self.s).of(0)
    }

    #[inline(always)]
    fn in_space(&self, cells: &CellBox) -> ([f32; 3], [f32; 3]) {
        in_space(&self.surfaces.place, self.projection, cells)
    }
}

/// Whether any of the volume may show.
#[inline(always)]
pub(super) fn shows<S: Simd, M>(s: S, surfaces: &Isosurfaces<'_, M>, projection: &Projection) -> bool {
    let all = CellBox { low: [0; 3], high: surfaces.volume.cells() };
    projection.shows(s, &box_of(s, surfaces, projection, &all), 0.0) != 0
}

/// Where a box of cells shows, the same in all lanes.
#[inline(always)]
fn box_of<S: Simd, M>(
    s: S,
    surfaces: &Isosurfaces<'_, M>,
    projection: &Projection,
    cells: &CellBox,
) -> Boxes<S::F> {
    let (centre, half) = in_space(&surfaces.place, projection, cells);
    projection.boxes(s, each!(3: centre, x => s.splat(x)), each!(3: half, x => s.splat(x)))
}

/// Middle of a box of cells, from the eye, and half its edges; in grid units.
#[inline(always)]
fn in_space(place: &VolumePlace, projection: &Projection, cells: &CellBox) -> ([f32; 3], [f32; 3]) {
    let (mut centre, mut half) = ([0.0; 3], [0.0; 3]);
    for axis in 0..3 {
        let half_cell = 0.5 / place.per_length[axis];
        let (low, high) = (f64::from(cells.low[axis]), f64::from(cells.high[axis]));
        let from_eye = place.origin[axis] - f64::from(projection.eye[axis]);
        centre[axis] = (from_eye + (low + high) * half_cell) as f32;
        half[axis] = ((high - low) * half_cell) as f32;
    }
    (centre, half)
}

/// Cells along an edge of the children of a branch with that many levels of branches under it.
const fn edge_of(below: usize) -> i32 {
    BRICK_CELLS << (2 * below)
}

/// Lowest corner of a child.
#[inline(always)]
fn child_corner(corner: [i32; 3], child: u32, edge: i32) -> [i32; 3] {
    let at = cell_coordinates(child);
    [0, 1, 2].map(|axis| corner[axis].wrapping_add(at[axis].cast_signed().wrapping_mul(edge)))
}

/// `2^-20`.
const ROUNDING: f32 = 1.0 / 1_048_576.0;
