//! Which cells of a branch a triangle, or the surface of a sphere, overlaps by more than the slack.

use glam::Vec3;
use rt_core::grid::cell_index;
use rt_core::sphere::Sphere;
use rt_core::surface::Surface;

use super::surfaces::{extent, surface_touches};

/// A branch's cube.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cube {
    /// Lowest corner.
    pub(super) corner: Vec3,
    /// Edge of one of its cells.
    pub(super) cell: f32,
    /// Level of its cells: 1 for the root's.
    pub(super) level: u32,
}

impl Cube {
    /// Lowest corner of a cell.
    pub(super) fn cell_corner(&self, cell: u32) -> Vec3 {
        let [x, y, z] = rt_core::grid::cell_coordinates(cell).map(|i| i as f32);
        self.corner + Vec3::new(x, y, z) * self.cell
    }

    /// A point, from the cube's corner: exact in f64.
    pub(super) fn local(&self, point: Vec3) -> [f64; 3] {
        [0, 1, 2].map(|axis| f64::from(point[axis]) - f64::from(self.corner[axis]))
    }

    /// The cube that a cell is to its own cells.
    pub(super) fn inside(&self, cell: u32) -> Self {
        Self { corner: self.cell_corner(cell), cell: self.cell * 0.25, level: self.level + 1 }
    }
}

/// The cells of `cube` that hold `surface`, one bit each: together, padded by `slack`, they contain the part of
/// it that lies in the padded cube.
///
/// Along each axis these are the cells overlapped by more than the slack, or, when there is none, the one
/// nearest to the middle. Of the cells in that box, those whose padded cube the surface itself does not touch
/// are left out: for a sphere, those inside it too.
pub(super) fn cells_of(surface: &Surface, cube: &Cube, slack: f32) -> u64 {
    match surface {
        Surface::Triangle(corners) => {
            let corners = corners.map(|corner| cube.local(corner));
            cells_touched(surface, cube, slack, |middle, half| touches(&corners, middle, half))
        }
        Surface::Sphere(Sphere { centre, radius }) => {
            let (centre, radius) = (cube.local(*centre), f64::from(*radius));
            cells_touched(surface, cube, slack, |middle, half| {
                let low = middle.map(|x| x - half);
                let high = middle.map(|x| x + half);
                surface_touches(centre, radius, low, high)
            })
        }
    }
}

/// The cells along the axes whose padded cube, given by its middle and half its edge, `touches`.
fn cells_touched(surface: &Surface, cube: &Cube, slack: f32, touches: impl Fn([f64; 3], f64) -> bool) -> u64 {
    let (slack, edge) = (f64::from(slack), f64::from(cube.cell));
    let (low, high) = extent(surface);
    let corner = cube.corner.to_array().map(f64::from);
    let [xs, ys, zs] =
        [0, 1, 2].map(|axis| cells_along(low[axis] - corner[axis], high[axis] - corner[axis], edge, slack));
    let single = xs.0 == xs.1 && ys.0 == ys.1 && zs.0 == zs.1;
    let mut cells = 0;
    for z in zs.0..=zs.1 {
        for y in ys.0..=ys.1 {
            for x in xs.0..=xs.1 {
                let middle = [x, y, z].map(|i| (f64::from(i) + 0.5) * edge);
                if single || touches(middle, edge * 0.5 + slack) {
                    cells |= 1 << cell_index([x, y, z]);
                }
            }
        }
    }
    cells
}

/// First and last cell, in `0..4`, that hold `low..=high` on one axis.
fn cells_along(low: f64, high: f64, edge: f64, slack: f64) -> (u32, u32) {
    let mut first = ((low + slack) / edge).floor();
    let mut last = ((high - slack) / edge).floor();
    if first > last {
        // Overlaps no cell by more than the slack: any cell between the two holds all of it.
        let middle = ((low + high) * 0.5 / edge).floor().clamp(last, first);
        (first, last) = (middle, middle);
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 0..=3")]
    let cell = |position: f64| position.clamp(0.0, 3.0) as u32;
    (cell(first), cell(last))
}

/// Whether a triangle touches the cube around `middle`; errs only towards yes.
///
/// # Source
/// Akenine-Möller, "Fast 3D Triangle-Box Overlap Testing", Journal of Graphics Tools 6(1), 2001: no axis
/// among the triangle's normal and the nine products of edges separates the two. The cube's own axes were
/// tested by the caller's ranges.
fn touches(triangle: &[[f64; 3]; 3], middle: [f64; 3], half: f64) -> bool {
    let [a, b, c] = triangle.map(|corner| subtract(corner, middle));
    let edges = [subtract(b, a), subtract(c, b), subtract(a, c)];
    if separates(cross(edges[0], edges[1]), [a, b, c], half) {
        return false;
    }
    let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    edges.iter().all(|&edge| axes.iter().all(|&axis| !separates(cross(axis, edge), [a, b, c], half)))
}

/// Whether the shadows of a triangle and of a cube around 0 on `axis` are clearly apart.
fn separates(axis: [f64; 3], triangle: [[f64; 3]; 3], half: f64) -> bool {
    let [a, b, c] = triangle.map(|corner| dot(axis, corner));
    let reach = half * (axis[0].abs() + axis[1].abs() + axis[2].abs()) * (1.0 + 1.0e-9);
    a.min(b).min(c) > reach || a.max(b).max(c) < -reach
}

fn subtract(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    const CUBE: Cube = Cube { corner: Vec3::ZERO, cell: 1.0, level: 1 };

    #[test]
    fn a_small_triangle_over_a_boundary_goes_to_one_cell() {
        let triangle = [Vec3::new(0.9, 0.5, 0.5), Vec3::new(1.15, 0.5, 0.5), Vec3::new(1.0, 0.6, 0.5)];
        assert_eq!(cells_of(&triangle.into(), &CUBE, 0.2), 1 << cell_index([1, 0, 0]));
        assert_eq!(cells_of(&triangle.into(), &CUBE, 0.01).count_ones(), 2);
    }

    #[test]
    fn a_diagonal_triangle_leaves_out_the_cells_beside_it() {
        let triangle = [Vec3::new(0.0, 0.0, 0.1), Vec3::new(4.0, 4.0, 0.1), Vec3::new(4.0, 4.0, 0.2)];
        let diagonal = (0..4).fold(0, |cells, i| cells | 1 << cell_index([i, i, 0]));
        assert_eq!(cells_of(&triangle.into(), &CUBE, 0.01) & diagonal, diagonal);
        assert_eq!(cells_of(&triangle.into(), &CUBE, 0.01) & (1 << cell_index([3, 0, 0])), 0);
    }

    #[test]
    fn every_point_of_a_triangle_lies_in_a_padded_cell_that_holds_it() {
        let corner = |seed: u32| Vec3::from([0, 1, 2].map(|axis| hash(seed * 3 + axis) * 6.0 - 1.0));
        for seed in 0..500 {
            let triangle = [corner(seed * 3), corner(seed * 3 + 1), corner(seed * 3 + 2)];
            for slack in [0.0_f32, 0.1, 0.7] {
                let cells = cells_of(&triangle.into(), &CUBE, slack);
                for sample in 0..50 {
                    let (u, v) = (hash(sample * 2), hash(sample * 2 + 1));
                    let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                    let point =
                        triangle[0] + (triangle[1] - triangle[0]) * u + (triangle[2] - triangle[0]) * v;
                    let inside = |low: Vec3, edge: f32| {
                        let pad = slack + 1.0e-5;
                        point.cmpge(low - pad).all() && point.cmple(low + edge + pad).all()
                    };
                    if inside(Vec3::splat(1.0e-4), 3.999) {
                        let held =
                            (0..64).any(|cell| cells >> cell & 1 == 1 && inside(CUBE.cell_corner(cell), 1.0));
                        assert!(held, "triangle {triangle:?}, point {point}, slack {slack}");
                    }
                }
            }
        }
    }

    /// A fixed pseudo-random number in `0..1`.
    fn hash(seed: u32) -> f32 {
        let mixed = (seed.wrapping_add(1)).wrapping_mul(0x9e37_79b9) ^ 0x85eb_ca6b;
        let mixed = (mixed ^ mixed >> 15).wrapping_mul(0x2c1b_3c6d);
        ((mixed ^ mixed >> 12) >> 8) as f32 / 16_777_216.0
    }
}
