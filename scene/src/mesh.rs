//! A triangle mesh as readers deliver it.

use rt_core::Bounds;

/// Vertices, and triangles that index them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Where the vertices are, in world units.
    pub positions: Vec<[f32; 3]>,
    /// Corners of the triangles, as indices of `positions`.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Bounds of all vertices, unused ones included; `None` without vertices or when a coordinate is not
    /// finite.
    pub fn bounds(&self) -> Option<Bounds> {
        let mut positions = self.positions.iter();
        let first = positions.next()?;
        let mut low = *first;
        let mut high = *first;
        for position in positions {
            for axis in 0..3 {
                low[axis] = low[axis].min(position[axis]);
                high[axis] = high[axis].max(position[axis]);
            }
        }
        let finite = self.positions.iter().flatten().all(|coordinate| coordinate.is_finite());
        finite.then_some(Bounds { low: low.into(), high: high.into() })
    }

    /// Memory of vertices and indices, in bytes.
    pub fn bytes(&self) -> u64 {
        (size_of_val(self.positions.as_slice()) + size_of_val(self.triangles.as_slice())) as u64
    }
}
