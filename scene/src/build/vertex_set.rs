//! Tells the points of a cluster apart.

use rt_core::grid::VERTICES_MAX;

/// Different points, up to the number a cluster may have, each with a number in the order of arrival.
///
/// Points are told apart by their bits, so a mesh whose triangles do not share vertices by index still shares
/// them here.
#[derive(Clone, Debug)]
pub(crate) struct VertexSet {
    points: [[u32; 3]; VERTICES_MAX as usize],
    count: u8,
    /// Open addressing; 0 is free, else a point's number plus 1.
    table: [u8; 128],
}

impl VertexSet {
    pub(crate) const fn new() -> Self {
        Self { points: [[0; 3]; VERTICES_MAX as usize], count: 0, table: [0; 128] }
    }

    /// Forgets all points.
    pub(crate) fn clear(&mut self) {
        self.count = 0;
        self.table = [0; 128];
    }

    /// The number of a point, new or not; `None` when it is new and there is no room.
    pub(crate) fn insert(&mut self, point: [f32; 3]) -> Option<u8> {
        let point = point.map(f32::to_bits);
        let mut slot = slot_of(point);
        loop {
            match self.table[slot] {
                0 if self.count == VERTICES_MAX => return None,
                0 => {
                    self.points[usize::from(self.count)] = point;
                    self.count += 1;
                    self.table[slot] = self.count;
                    return Some(self.count - 1);
                }
                number if self.points[usize::from(number - 1)] == point => return Some(number - 1),
                _ => slot = (slot + 1) % 128,
            }
        }
    }

    /// The points, in the order of their numbers.
    pub(crate) fn points(&self) -> impl Iterator<Item = [f32; 3]> {
        self.points[..usize::from(self.count)].iter().map(|point| point.map(f32::from_bits))
    }

    pub(crate) const fn count(&self) -> u8 {
        self.count
    }
}

fn slot_of([x, y, z]: [u32; 3]) -> usize {
    let mixed = x.wrapping_mul(0x9e37_79b1)
        ^ y.wrapping_mul(0x85eb_ca77).rotate_left(11)
        ^ z.wrapping_mul(0xc2b2_ae3d);
    (mixed.wrapping_mul(0x27d4_eb2f) >> 25) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vertex_set_knows_points_by_their_bits_and_is_full_at_32() {
        let mut set = VertexSet::new();
        for i in 0..32_u8 {
            assert_eq!(set.insert([f32::from(i), 0.0, 1.0]), Some(i));
        }
        assert_eq!(set.insert([7.0, 0.0, 1.0]), Some(7));
        assert_eq!(set.insert([99.0, 0.0, 1.0]), None);
        assert_eq!((set.count(), set.points().nth(31)), (32, Some([31.0, 0.0, 1.0])));
        set.clear();
        assert_eq!(set.insert([99.0, 0.0, 1.0]), Some(0));
    }
}
