//! No ray passes through a closed mesh at an edge or a vertex.

mod common;

use std::collections::HashMap;

use common::{Dice, agree, image, on_circle, single};
use glam::Vec3;
use rt_core::{Flat, Ray, SceneView, brute};
use scene::{Mesh, builtin};

/// A closed mesh with what is known about each edge: its ends and the third corners of its two triangles.
struct Closed {
    mesh: Mesh,
    edges: Vec<[u32; 4]>,
}

impl Closed {
    fn new(mesh: Mesh) -> Self {
        let mut third: HashMap<(u32, u32), u32> = HashMap::new();
        for &[a, b, c] in &mesh.triangles {
            third.extend([((a, b), c), ((b, c), a), ((c, a), b)]);
        }
        let mut edges: Vec<[u32; 4]> =
            third.iter().filter(|((a, b), _)| a < b).map(|(&(a, b), &c)| [a, b, c, third[&(b, a)]]).collect();
        edges.sort_unstable();
        Self { mesh, edges }
    }

    /// The same mesh, stretched along the axes.
    fn stretched(&self, factors: Vec3) -> Self {
        let stretch = |p: &[f32; 3]| (Vec3::from(*p) * factors).to_array();
        let mesh = Mesh {
            positions: self.mesh.positions.iter().map(stretch).collect(),
            triangles: self.mesh.triangles.clone(),
        };
        Self { mesh, edges: self.edges.clone() }
    }

    fn at(&self, vertex: u32) -> Vec3 {
        self.mesh.positions[vertex as usize].into()
    }

    /// Whether both triangles of an edge face the eye, by at least half a degree: rounding moves a ray by
    /// some 2^-18 of its length, which along so steep a surface is 2^-11.
    fn faces(&self, [a, b, c, d]: [u32; 4], towards_eye: Vec3) -> bool {
        let facing = |corners: [u32; 3]| {
            let [a, b, c] = corners.map(|v| self.at(v).to_array().map(f64::from));
            let sub = |p: [f64; 3], q: [f64; 3]| [p[0] - q[0], p[1] - q[1], p[2] - q[2]];
            let (e, f) = (sub(b, a), sub(c, a));
            let normal = [e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]];
            let eye = towards_eye.to_array().map(f64::from);
            let dot = |p: [f64; 3], q: [f64; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
            dot(normal, eye) > 1.0e-2 * (dot(normal, normal) * dot(eye, eye)).sqrt()
        };
        facing([a, b, c]) && facing([b, a, d])
    }
}

#[test]
fn from_outside_no_ray_passes_an_edge_that_faces_it() {
    let knot = Closed::new(builtin::knot(4000));
    for exponent in [0, -60, -30, 30, 58] {
        for stretch in [Vec3::ONE, Vec3::new(1.0e-6, 1.0, 1.0), Vec3::new(1.0, 1.0e3, 1.0)] {
            let knot = knot.stretched(stretch * 2.0_f32.powi(exponent));
            let image = image(&knot.mesh, 0.5, 4096);
            let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
            let size = (scene.header().bounds.high - scene.header().bounds.low).max_element();
            let mut dice = Dice(exponent.unsigned_abs().into());
            let mut tried = 0;
            for _ in 0..4000 {
                let edge = knot.edges[dice.below(knot.edges.len())];
                let eye = (scene.header().bounds.low + scene.header().bounds.high) * 0.5
                    + dice.direction() * size * 2.0;
                let [a, b] = [knot.at(edge[0]), knot.at(edge[1])];
                let aim = a + (b - a) * dice.unit();
                if knot.faces(edge, eye - aim) {
                    tried += 1;
                    let ray = Ray { origin: eye, direction: aim - eye, t_max: 1.001 };
                    assert!(
                        scene.any(&ray, &mut ()) == Ok(true),
                        "2^{exponent} {stretch}: {ray:?} passes edge {edge:?}"
                    );
                }
            }
            assert!(tried > 500, "only {tried} edges faced the eye");
        }
    }
}

#[test]
fn from_far_away_no_parallel_ray_passes_an_edge_that_faces_it() {
    let knot = Closed::new(builtin::knot(4000));
    let image = image(&knot.mesh, 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    let mut dice = Dice(1);
    for distance in [1.0e3, 1.0e5, 1.0e7] {
        for _ in 0..400 {
            let axis = dice.below(3);
            let mut outwards = Vec3::ZERO;
            outwards[axis] = if dice.unit() < 0.5 { 1.0 } else { -1.0 };
            let edge = knot.edges[dice.below(knot.edges.len())];
            if knot.faces(edge, outwards) {
                let [a, b] = [knot.at(edge[0]), knot.at(edge[1])];
                let origin = a + (b - a) * dice.unit() + outwards * distance * 6.0;
                let ray = Ray { origin, direction: -outwards, t_max: f32::INFINITY };
                assert!(agree(&scene, &ray).is_some(), "{ray:?} passes edge {edge:?}");
            }
        }
    }
}

#[test]
fn from_inside_no_ray_gets_out() {
    // The rope's middle line is inside the knot; from there every ray meets the surface, through whatever it
    // is aimed.
    let knot = Closed::new(builtin::knot(4000));
    let image = image(&knot.mesh, 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    let mut dice = Dice(5);
    for _ in 0..20_000 {
        let t = f64::from(dice.unit()) * core::f64::consts::TAU;
        let distance = 2.0 + (3.0 * t).cos();
        let inside = [distance * (2.0 * t).cos(), distance * (2.0 * t).sin(), (3.0 * t).sin()];
        let origin = Vec3::from(inside.map(single));
        let [a, b, ..] = knot.edges[dice.below(knot.edges.len())];
        let [a, b] = [knot.at(a), knot.at(b)];
        let aim = if dice.unit() < 0.3 { a } else { a + (b - a) * dice.unit() };
        let ray = Ray { origin, direction: aim - origin, t_max: f32::INFINITY };
        assert!(scene.any(&ray, &mut ()) == Ok(true), "{ray:?} gets out");
    }
}

#[test]
fn a_vertex_of_many_needles_has_no_hole() {
    let spokes = 999_u32;
    let rim = |i: u32| {
        let [x, y] = on_circle(f64::from(i) / f64::from(spokes));
        [x, y, 0.0]
    };
    // A double cone: two apexes over one rim.
    let mut positions = vec![[0.1, 0.2, 0.7], [0.0, 0.0, -0.9]];
    positions.extend((0..spokes).map(rim));
    let side = |i: u32| [i + 2, (i + 1) % spokes + 2];
    let upper = (0..spokes).map(|i| [0, side(i)[0], side(i)[1]]);
    let lower = (0..spokes).map(|i| [1, side(i)[1], side(i)[0]]);
    let cone = Closed::new(Mesh { positions, triangles: upper.chain(lower).collect() });
    let image = image(&cone.mesh, 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    let mut dice = Dice(9);
    for i in 0..4000_u32 {
        let origin = dice.point() * 0.05;
        let aim = match i % 3 {
            0 => cone.at(0),
            1 => cone.at(1),
            _ => cone.at(2 + i % spokes),
        };
        let ray = Ray { origin, direction: aim - origin, t_max: f32::INFINITY };
        assert!(brute::any(&scene, &ray) == Ok(true), "the test itself leaks: {ray:?}");
        assert!(scene.any(&ray, &mut ()) == Ok(true), "{ray:?} gets out");
    }
}
