//! Boxes that count from the lowest corner of a branch.

use glam::Vec3;
use rt_core::grid::cell_coordinates;
use rt_core::surface::Surface;

use super::overlap::Cube;
use super::surfaces::{extent, surface_inside};

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
    pub(super) fn clip(self, other: &Self) -> Self {
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
    corner: [f64; 3],
    bounds: LocalBox,
}

impl PaddedCell {
    pub(super) fn new(cube: &Cube, cell: u32, slack: f32) -> Self {
        let (edge, slack) = (f64::from(cube.cell), f64::from(slack));
        let low = cell_coordinates(cell).map(|i| f64::from(i) * edge - slack);
        let bounds = LocalBox { low, high: low.map(|x| x + edge + slack * 2.0) };
        Self { cell, corner: cube.corner.to_array().map(f64::from), bounds }
    }

    /// The box of the part of `surface` inside the padded cell; for a triangle, the part of its box.
    pub(super) fn clip(&self, surface: &Surface) -> LocalBox {
        if let Surface::Sphere(sphere) = surface {
            let centre = self.local(sphere.centre);
            let part = surface_inside(centre, f64::from(sphere.radius), self.bounds.low, self.bounds.high);
            if let Some((low, high)) = part {
                return LocalBox { low, high };
            }
        }
        let (low, high) = extent(surface);
        let local = |point: [f64; 3]| [0, 1, 2].map(|axis| point[axis] - self.corner[axis]);
        LocalBox { low: local(low), high: local(high) }.clip(&self.bounds)
    }

    fn local(&self, point: Vec3) -> [f64; 3] {
        [0, 1, 2].map(|axis| f64::from(point[axis]) - self.corner[axis])
    }
}
