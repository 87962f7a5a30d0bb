//! Meshes, and rays aimed at them.

use std::collections::HashMap;

use anyhow::Result;
use glam::Vec3;
use rt_core::Ray;
use scene::{Mesh, builtin, read_mesh};

use super::dice::Dice;
use crate::data::mesh_file;
use crate::experiment::Effort;

/// A mesh, and where it is looked at from.
#[derive(Debug)]
pub(super) struct Subject {
    pub(super) name: String,
    pub(super) mesh: Mesh,
    /// From how far, in sizes of the mesh.
    distance: f32,
    /// How far off 0 the mesh lies, in sizes.
    off: f32,
}

/// Rays and the triangles at which they are aimed, and triangles that lie near these.
#[derive(Debug)]
pub(super) struct Shots {
    pub(super) aimed: Vec<(Ray, [Vec3; 3])>,
    pub(super) near: Vec<[[Vec3; 3]; NEAR]>,
}

/// Rays at edges between two triangles that both face them; all must have a hit up to `t_max`.
#[derive(Debug)]
pub(super) struct EdgeShots {
    pub(super) rays: Vec<Ray>,
    pub(super) t_max: f32,
}

/// Triangles that each ray is timed with.
const NEAR: usize = 16;

/// The subjects of the experiment; the bunny if it is there.
pub(super) fn all(effort: Effort) -> Result<Vec<Subject>> {
    let knot = || builtin::knot(effort.pick(100_000, 2000));
    let subject = |name: &str, mesh, distance, off| Subject { name: name.to_owned(), mesh, distance, off };
    let mut subjects = Vec::new();
    if let Some(path) = mesh_file("bunny", effort).filter(|_| !effort.is_quick()) {
        subjects.push(subject("bunny", read_mesh(&path)?, 2.0, 0.0));
    }
    subjects.push(subject("knot", knot(), 2.0, 0.0));
    subjects.push(subject("needles", changed(knot(), |point| point * Vec3::new(1000.0, 1.0, 1.0)), 2.0, 0.0));
    subjects.push(subject("from far away", knot(), 1000.0, 0.0));
    let size = Subject::size_of(&knot());
    subjects.push(subject("far off 0", changed(knot(), |point| point + size * 1000.0), 2.0, 1000.0));
    Ok(subjects)
}

fn changed(mut mesh: Mesh, change: impl Fn(Vec3) -> Vec3) -> Mesh {
    for position in &mut mesh.positions {
        *position = change(Vec3::from(*position)).to_array();
    }
    mesh
}

impl Subject {
    /// Length of the longest side of the mesh's box.
    fn size_of(mesh: &Mesh) -> f32 {
        let points = || mesh.positions.iter().map(|&point| Vec3::from(point));
        let low = points().fold(Vec3::INFINITY, Vec3::min);
        (points().fold(Vec3::NEG_INFINITY, Vec3::max) - low).max_element()
    }

    fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.mesh.triangles[triangle].map(|vertex| Vec3::from(self.mesh.positions[vertex as usize]))
    }

    /// Rays aimed at random points of random triangles, from all sides but not along them.
    pub(super) fn shots(&self, count: usize) -> Shots {
        let (mut dice, reach) = (Dice(7), Self::size_of(&self.mesh) * self.distance);
        let triangles = self.mesh.triangles.len();
        let mut shots = Shots { aimed: Vec::new(), near: Vec::new() };
        while shots.aimed.len() < count {
            let triangle = dice.below(triangles);
            let corners = self.corners(triangle);
            let (u, v) = (dice.unit(), dice.unit());
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let towards = dice.in_ball().normalize();
            let [a, b, c] = corners;
            if normal(corners).dot(towards).abs() < 0.2 {
                continue;
            }
            let aim = a + (b - a) * u + (c - a) * v;
            shots.aimed.push((ray_to(aim, towards * reach), corners));
            shots.near.push(core::array::from_fn(|next| self.corners((triangle + next) % triangles)));
        }
        shots
    }

    /// Rays aimed at the middle parts of edges, so that rounding does not take them past the two triangles.
    pub(super) fn edge_shots(&self, count: usize) -> EdgeShots {
        let (mut dice, reach) = (Dice(8), Self::size_of(&self.mesh) * self.distance);
        let edges = self.shared_edges();
        let mut rays = Vec::new();
        for _ in 0..count * 100 {
            if rays.len() == count {
                break;
            }
            let ([from, to], neighbours) = edges[dice.below(edges.len())];
            let normals = neighbours.map(|triangle| normal(self.corners(triangle)));
            let towards = (normals[0] + normals[1] + dice.in_ball() * 0.5).normalize_or_zero();
            if normals.iter().any(|normal| normal.dot(towards).is_nan() || normal.dot(towards) < 0.4) {
                continue;
            }
            let [from, to] = [from, to].map(|vertex| Vec3::from(self.mesh.positions[vertex as usize]));
            rays.push(ray_to(from + (to - from) * (0.2 + 0.6 * dice.unit()), towards * reach));
        }
        // What a slanted surface and rounding add to 1.
        EdgeShots { rays, t_max: 1.0 + 4.0e-6 * (1.0 + self.off) }
    }

    /// Edges of exactly two triangles, sorted.
    fn shared_edges(&self) -> Vec<([u32; 2], [usize; 2])> {
        let mut sides: HashMap<[u32; 2], Vec<usize>> = HashMap::new();
        for (index, &[a, b, c]) in self.mesh.triangles.iter().enumerate() {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                sides.entry([from.min(to), from.max(to)]).or_default().push(index);
            }
        }
        let shared =
            sides.into_iter().filter_map(|(edge, sides)| Some((edge, <[usize; 2]>::try_from(sides).ok()?)));
        let mut shared: Vec<_> = shared.collect();
        shared.sort_unstable();
        shared
    }
}

/// A ray from `away` off to `aim`, which lies at `t` 1.
fn ray_to(aim: Vec3, away: Vec3) -> Ray {
    let origin = aim + away;
    Ray { origin, direction: aim - origin, t_max: f32::INFINITY }
}

fn normal([a, b, c]: [Vec3; 3]) -> Vec3 {
    (b - a).cross(c - a).normalize_or_zero()
}
