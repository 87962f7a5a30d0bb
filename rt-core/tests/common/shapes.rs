//! Closed meshes made by arithmetic.

use core::f64::consts::{PI, TAU};

use glam::Vec3;
use scene::Mesh;

use super::single;

/// A ball of radius 1 with poles on the z axis.
pub fn sphere(parallels: u32, meridians: u32) -> Mesh {
    let circle = |i: u32| {
        let (sin, cos) = (PI * f64::from(i + 1) / f64::from(parallels + 1)).sin_cos();
        (sin, cos)
    };
    capped(&(0..parallels).map(circle).collect::<Vec<_>>(), meridians)
}

/// Two needles of length 1 that share a thin rim: a double cone, `aspect` times as long as it is wide.
pub fn spindle(aspect: f64, meridians: u32) -> Mesh {
    capped(&[(0.5 / aspect, 0.0)], meridians)
}

/// Circles of (radius, height) around the z axis, closed by poles at heights 1 and -1.
fn capped(circles: &[(f64, f64)], meridians: u32) -> Mesh {
    let on_circle = |&(radius, height): &(f64, f64)| {
        (0..meridians).map(move |i| {
            let (sin, cos) = (TAU * f64::from(i) / f64::from(meridians)).sin_cos();
            [radius * cos, radius * sin, height].map(single)
        })
    };
    let mut positions = vec![[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];
    positions.extend(circles.iter().flat_map(on_circle));
    let rows = u32::try_from(circles.len()).expect("few circles");
    let at = |row: u32, i: u32| 2 + row * meridians + i % meridians;
    let top = (0..meridians).map(|i| [0, at(0, i), at(0, i + 1)]);
    let bottom = (0..meridians).map(|i| [1, at(rows - 1, i + 1), at(rows - 1, i)]);
    let mut triangles: Vec<[u32; 3]> = top.chain(bottom).collect();
    for row in 1..rows {
        for i in 0..meridians {
            let [a, b, c, d] = [at(row - 1, i), at(row, i), at(row, i + 1), at(row - 1, i + 1)];
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    Mesh { positions, triangles }
}

/// A ring of radius 1 and thickness 0.35 around the z axis.
pub fn torus(along: u32, around: u32) -> Mesh {
    let point = |i: u32, j: u32| {
        let (sin, cos) = (TAU * f64::from(i) / f64::from(along)).sin_cos();
        let (sin2, cos2) = (TAU * f64::from(j) / f64::from(around)).sin_cos();
        let radius = 1.0 + 0.35 * cos2;
        [radius * cos, radius * sin, 0.35 * sin2].map(single)
    };
    let at = |i: u32, j: u32| i % along * around + j % around;
    let quad = |i: u32, j: u32| [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
    let quads = (0..along).flat_map(|i| (0..around).map(move |j| quad(i, j)));
    Mesh {
        positions: (0..along).flat_map(|i| (0..around).map(move |j| point(i, j))).collect(),
        triangles: quads.flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect(),
    }
}

/// The cube `-1..1`, two triangles a face.
pub fn cube() -> Mesh {
    let corner = |i: u8| [i & 1, i >> 1 & 1, i >> 2].map(|bit| f32::from(bit) * 2.0 - 1.0);
    let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6_u32]];
    Mesh {
        positions: (0..8).map(corner).collect(),
        triangles: faces.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect(),
    }
}

/// The mesh turned about a slanted axis, so that no coordinate is a round number, and scaled.
pub fn turned(mesh: &Mesh, scale: f32) -> Mesh {
    let turn = glam::Quat::from_axis_angle(Vec3::new(0.48, -0.6, 0.64), 1.1);
    let place = |p: &[f32; 3]| (turn * Vec3::from(*p) * scale).to_array();
    Mesh { positions: mesh.positions.iter().map(place).collect(), triangles: mesh.triangles.clone() }
}
