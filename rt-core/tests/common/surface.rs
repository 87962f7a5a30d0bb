//! A mesh that knows what lies across each edge.

use core::iter;
use std::collections::HashMap;

use glam::Vec3;
use rt_core::Ray;
use scene::Mesh;

use super::exact::side;

/// A mesh whose vertices of equal position are one, without collapsed triangles.
#[derive(Clone)]
pub struct Surface {
    pub mesh: Mesh,
    /// For each triangle and each of its sides, from a corner to the next, the triangle on the other side.
    ///
    /// `None` unless the edge is *interior*: exactly two triangles have it, one in each direction.
    across: Vec<[Option<u32>; 3]>,
}

/// A side of a triangle: from its corner of that number to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Side {
    pub triangle: u32,
    pub corner: usize,
}

impl Surface {
    pub fn new(mesh: &Mesh) -> Self {
        let mesh = merged(mesh);
        let mut sides: Vec<([u32; 2], Side)> = Vec::with_capacity(mesh.triangles.len() * 3);
        for (triangle, corners) in (0_u32..).zip(&mesh.triangles) {
            for corner in 0..3 {
                let (a, b) = (corners[corner], corners[(corner + 1) % 3]);
                sides.push(([a.min(b), a.max(b)], Side { triangle, corner }));
            }
        }
        sides.sort_unstable_by_key(|(edge, side)| (*edge, side.triangle, side.corner));
        let mut across = vec![[None; 3]; mesh.triangles.len()];
        let starts_at = |side: Side| mesh.triangles[side.triangle as usize][side.corner];
        for group in sides.chunk_by(|a, b| a.0 == b.0) {
            if let [(_, a), (_, b)] = *group
                && starts_at(a) != starts_at(b)
            {
                across[a.triangle as usize][a.corner] = Some(b.triangle);
                across[b.triangle as usize][b.corner] = Some(a.triangle);
            }
        }
        Self { mesh, across }
    }

    /// The part whose triangles turn their front against `direction`: what a ray along it meets first, and
    /// with no back side that would stop a ray which slipped through.
    pub fn front(&self, direction: Vec3) -> Self {
        let faces = |corners: &&[u32; 3]| self.turn(corners, direction) > 0;
        let triangles = self.mesh.triangles.iter().filter(faces).copied().collect();
        Self::new(&Mesh { positions: self.mesh.positions.clone(), triangles })
    }

    /// Share of the sides that are interior; 0 for nothing at all.
    pub fn interior(&self) -> f64 {
        let interior = self.across.iter().flatten().flatten().count();
        interior as f64 / (self.across.len() * 3).max(1) as f64
    }

    pub fn size(&self) -> f32 {
        let bounds = self.mesh.bounds().expect("finite vertices");
        (bounds.high - bounds.low).max_element()
    }

    pub fn across(&self, side: Side) -> Option<u32> {
        self.across[side.triangle as usize][side.corner]
    }

    pub fn corners(&self, triangle: u32) -> [[f32; 3]; 3] {
        self.mesh.triangles[triangle as usize].map(|vertex| self.mesh.positions[vertex as usize])
    }

    /// Start and end of a side.
    pub fn ends(&self, side: Side) -> [Vec3; 2] {
        let corners = self.corners(side.triangle);
        [corners[side.corner].into(), corners[(side.corner + 1) % 3].into()]
    }

    /// How a triangle is turned to a ray: 1 with its front against it, -1 with its back, 0 edge-on; exact.
    pub fn turned(&self, triangle: u32, ray: &Ray) -> i32 {
        self.turn(&self.mesh.triangles[triangle as usize], ray.direction)
    }

    fn turn(&self, corners: &[u32; 3], direction: Vec3) -> i32 {
        let [a, b, c] = corners.map(|vertex| self.mesh.positions[vertex as usize]);
        -side(direction.into(), b, c, a)
    }

    /// Whether all these triangles are turned to the ray the same way, and not edge-on.
    pub fn all_turned_alike(&self, triangles: &[u32], ray: &Ray) -> bool {
        let mut turns = triangles.iter().map(|&triangle| self.turned(triangle, ray));
        let first = turns.next().unwrap_or(0);
        first != 0 && turns.all(|turn| turn == first)
    }

    /// The triangles around the start of a side, if its edges there are all interior and it has one fan only.
    pub fn fan(&self, start: Side) -> Option<Vec<u32>> {
        let vertex = self.mesh.triangles[start.triangle as usize][start.corner];
        let next = |triangle: &u32| {
            // The side that ends at the vertex starts at the corner before it.
            let corners = &self.mesh.triangles[*triangle as usize];
            let at = corners.iter().position(|&corner| corner == vertex)?;
            self.across(Side { triangle: *triangle, corner: (at + 2) % 3 })
        };
        let mut fan: Vec<u32> = vec![start.triangle];
        for triangle in iter::successors(next(&start.triangle), next).take(self.mesh.triangles.len()) {
            if triangle == start.triangle {
                return Some(fan);
            }
            fan.push(triangle);
        }
        None
    }
}

fn merged(mesh: &Mesh) -> Mesh {
    let mut numbers = HashMap::new();
    let mut positions = Vec::new();
    let mut number = |vertex: u32| {
        // Adding 0 makes -0 and 0 one number.
        let position = mesh.positions[vertex as usize].map(|x| x + 0.0);
        *numbers.entry(position.map(f32::to_bits)).or_insert_with(|| {
            positions.push(position);
            u32::try_from(positions.len() - 1).expect("fewer vertices than the mesh")
        })
    };
    let triangles: Vec<[u32; 3]> = mesh.triangles.iter().map(|corners| corners.map(&mut number)).collect();
    let differ = |[a, b, c]: &[u32; 3]| a != b && b != c && c != a;
    Mesh { positions, triangles: triangles.into_iter().filter(differ).collect() }
}
