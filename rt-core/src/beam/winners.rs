//! The triangles that pixels of a tile have found nearest so far.

use glam::Vec3;

use crate::cluster::Cluster;
use crate::ray::Primitive;

/// A triangle that some pixel shows, or showed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Winner {
    pub(super) corners: [Vec3; 3],
    pub(super) primitive: Primitive,
}

/// A table of winners; pixels hold places in it.
pub(super) struct Winners {
    table: [Winner; CAPACITY],
    count: usize,
    /// How often places have moved.
    pub(super) moves: u32,
}

/// At most 256 are in use at once, so half of the table is free after each clearing out.
const CAPACITY: usize = 512;

impl Winner {
    /// A triangle of a cluster.
    #[inline(always)]
    pub(super) fn of(cluster: &Cluster<'_>, index: usize) -> Self {
        Self { corners: cluster.triangle(index), primitive: cluster.primitive(index) }
    }

    const NONE: Self = Self { corners: [Vec3::ZERO; 3], primitive: Primitive(0) };
}

impl Winners {
    pub(super) const fn new() -> Self {
        Self { table: [Winner::NONE; CAPACITY], count: 0, moves: 0 }
    }

    pub(super) fn get(&self, place: u32) -> &Winner {
        &self.table[place as usize % CAPACITY]
    }

    pub(super) const fn is_full(&self) -> bool {
        self.count == CAPACITY
    }

    /// Adds a winner to a table that is not full, and tells its place.
    pub(super) fn add(&mut self, winner: Winner) -> u32 {
        self.table[self.count] = winner;
        self.count += 1;
        (self.count - 1) as u32
    }

    /// Keeps only the winners in use, and corrects the places.
    pub(super) fn clear_out<'a>(&mut self, places: impl Iterator<Item = &'a mut u32>) {
        const UNUSED: u16 = u16::MAX;
        let (kept, mut count) = (self.table, 0);
        let mut moved = [UNUSED; CAPACITY];
        for place in places {
            let old = *place as usize % CAPACITY;
            if moved[old] == UNUSED {
                moved[old] = count as u16;
                self.table[count] = kept[old];
                count += 1;
            }
            *place = u32::from(moved[old]);
        }
        self.count = count;
        self.moves += 1;
    }
}
