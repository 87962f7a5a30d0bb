//! Isosurfaces in double precision, without tree and bricks: the reference that errors are measured against.
//!
//! Every cell on the way of a ray is looked at. The cubic of a cell is cut in two, again and again; a part whose
//! Bernstein coefficients are of one kind has no root, since they enclose all values of the part. So a root is isolated
//! to the last bits of double precision, and none is passed over but one that touches the isovalue and turns back
//! within `2^-50` of a cell.

use crate::volume::VALUE_MAX;

/// A volume in memory.
#[derive(Clone, Copy, Debug)]
pub struct Samples<'a> {
    /// Samples along x, y and z.
    pub dims: [usize; 3],
    /// The samples, x fastest, then y, then z.
    pub samples: &'a [f32],
}

/// Where a ray meets an isosurface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Distance from the origin, in lengths of the direction.
    pub t: f64,
    /// The voxel cell.
    pub cell: [usize; 3],
    /// Gradient of the trilinear interpolant, in samples a cell.
    pub gradient: [f64; 3],
}

impl Samples<'_> {
    /// The first place with `0 <= t <= t_max` where a ray changes between inside (at or above the isovalue) and
    /// outside. Origin and direction are in cells.
    pub fn first_crossing(
        &self,
        origin: [f64; 3],
        direction: [f64; 3],
        t_max: f64,
        isovalue: f32,
    ) -> Option<Crossing> {
        let cells = self.dims.map(|count| count as f64 - 1.0);
        let (mut t, mut end) = (0.0_f64, t_max);
        for axis in 0..3 {
            if direction[axis] == 0.0 {
                if !(0.0..cells[axis]).contains(&origin[axis]) {
                    return None;
                }
                continue;
            }
            let planes = [0.0, cells[axis]].map(|plane| (plane - origin[axis]) / direction[axis]);
            t = t.max(planes[0].min(planes[1]));
            end = end.min(planes[0].max(planes[1]));
        }
        while t < end {
            let next = self.next_plane(origin, direction, t).min(end);
            let middle = t + (next - t) * 0.5;
            let at = |t: f64| [0, 1, 2].map(|axis| origin[axis] + t * direction[axis]);
            let cell =
                [0, 1, 2].map(|axis| libm::floor(at(middle)[axis]).clamp(0.0, (cells[axis] - 1.0).max(0.0)));
            let local = |t: f64| [0, 1, 2].map(|axis| on_plane((at(t)[axis] - cell[axis]).clamp(0.0, 1.0)));
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "whole numbers within the volume"
            )]
            let cell = cell.map(|x| x as usize);
            let corners = self.corners(cell);
            if corners.iter().all(|corner| corner.abs() <= f64::from(VALUE_MAX)) {
                let values = corners.map(|corner| corner - f64::from(isovalue));
                let cubic = coefficients(&values, local(t), local(next));
                if let Some(s) = first_root(cubic, 0.0, 1.0, 0) {
                    let root = t + s * (next - t);
                    return Some(Crossing { t: root, cell, gradient: gradient(&values, local(root)) });
                }
            }
            t = next;
        }
        None
    }

    /// The samples of a cell.
    pub fn corners(&self, [x, y, z]: [usize; 3]) -> [f64; 8] {
        core::array::from_fn(|i| {
            let index = ((z + i / 4) * self.dims[1] + y + i / 2 % 2) * self.dims[0] + x + i % 2;
            self.samples.get(index).copied().map_or(f64::NAN, f64::from)
        })
    }

    fn next_plane(&self, origin: [f64; 3], direction: [f64; 3], t: f64) -> f64 {
        let mut next = f64::INFINITY;
        for axis in (0..3).filter(|&axis| direction[axis] != 0.0) {
            let at = origin[axis] + t * direction[axis];
            // A plane or two further on, where rounding says that this one is behind.
            let step = 1.0_f64.copysign(direction[axis]);
            let first = if step > 0.0 { libm::floor(at) } else { libm::ceil(at) };
            let plane = (0..3).map(|k| (first + step * f64::from(k) - origin[axis]) / direction[axis]);
            next = next.min(plane.filter(|&plane| plane > t).fold(f64::INFINITY, f64::min));
        }
        next
    }
}

/// Takes a place that rounding keeps off a plane as on it, so that neighbours see the same samples there.
fn on_plane(place: f64) -> f64 {
    let plane = libm::round(place);
    if (place - plane).abs() < 1.0e-12 { plane } else { place }
}

/// Bernstein coefficients along a line in a cell.
fn coefficients(values: &[f64; 8], from: [f64; 3], to: [f64; 3]) -> [f64; 4] {
    let at = |which: [bool; 3]| {
        trilinear(values, [0, 1, 2].map(|axis| if which[axis] { to[axis] } else { from[axis] }))
    };
    let one = at([true, false, false]) + at([false, true, false]) + at([false, false, true]);
    let two = at([true, true, false]) + at([true, false, true]) + at([false, true, true]);
    [at([false; 3]), one / 3.0, two / 3.0, at([true; 3])]
}

fn trilinear(values: &[f64; 8], [x, y, z]: [f64; 3]) -> f64 {
    let mix = |a: f64, b: f64, w: f64| a * (1.0 - w) + b * w;
    let face = |at: usize| mix(mix(values[at], values[at + 1], x), mix(values[at + 2], values[at + 3], x), y);
    mix(face(0), face(4), z)
}

fn gradient(values: &[f64; 8], [x, y, z]: [f64; 3]) -> [f64; 3] {
    let along = |axis: usize| {
        let end = |w: f64| {
            let mut place = [x, y, z];
            place[axis] = w;
            trilinear(values, place)
        };
        end(1.0) - end(0.0)
    };
    [along(0), along(1), along(2)]
}

fn first_root([a, b, c, d]: [f64; 4], low: f64, high: f64, depth: u32) -> Option<f64> {
    let inside = [a, b, c, d].map(|x| x >= 0.0);
    if inside == [inside[0]; 4] {
        return None;
    }
    let middle = (low + high) * 0.5;
    if depth == DEPTH_MAX {
        return (inside[0] != inside[3]).then_some(middle);
    }
    let half = |a: f64, b: f64| (a + b) * 0.5;
    let (ab, bc, cd) = (half(a, b), half(b, c), half(c, d));
    let (abc, bcd) = (half(ab, bc), half(bc, cd));
    let centre = half(abc, bcd);
    first_root([a, ab, abc, centre], low, middle, depth + 1)
        .or_else(|| first_root([centre, bcd, cd, d], middle, high, depth + 1))
}

const DEPTH_MAX: u32 = 50;
