//! Models of spheres and triangles for tests.

use glam::Vec3;
use proptest::prelude::*;
use rt_core::sphere::Sphere;
use scene::{BuildOptions, Mesh, Model, build};

use super::meshes;

/// The image of a model.
pub fn image_of(model: &Model, slack: f32, page_bytes: u32) -> Vec<u8> {
    let scene = build(model.clone(), &BuildOptions { slack }, &|_| {}).expect("a model that builds");
    scene.to_bytes(page_bytes).expect("an image that fits")
}

/// Spheres of all sizes; some are equal, some concentric, some lie on a lattice so that they touch cells.
pub fn spheres() -> impl Strategy<Value = Vec<Sphere>> {
    let point = [-1.0..1.0_f32, -1.0..1.0_f32, -1.0..1.0_f32].prop_map(Vec3::from);
    let lattice = [-4..5_i8, -4..5_i8, -4..5_i8].prop_map(|at| Vec3::from(at.map(f32::from)) * 0.25);
    let radius = prop_oneof![Just(0.0_f32), Just(0.25), Just(1.0e-7), Just(1.0), 0.0..0.01_f32, 0.0..0.5_f32];
    let sphere = (prop_oneof![3 => point, 1 => lattice], radius)
        .prop_map(|(centre, radius)| Sphere { centre, radius });
    let cluster = (sphere, 0..8_u8).prop_map(|(sphere, kind)| match kind {
        0 => vec![sphere; 3],
        1 => (1..40_u8).map(|i| Sphere { radius: sphere.radius * f32::from(i) / 40.0, ..sphere }).collect(),
        _ => vec![sphere],
    });
    prop::collection::vec(cluster, 1..100).prop_map(|clusters| clusters.concat())
}

/// Spheres, with triangles or without, anywhere and of any scale.
pub fn models() -> impl Strategy<Value = Model> {
    let triangles = prop_oneof![2 => Just(Mesh::default()), 1 => meshes()];
    let offset = prop_oneof![3 => Just(Vec3::ZERO), 1 => Just(Vec3::new(50.0, -3.0, 0.0)), 1 => Just(Vec3::splat(1.0e5))];
    let scale = prop_oneof![3 => Just(1.0_f32), 1 => Just(1.0e-18), 1 => Just(1.0e18), 1 => Just(0.37)];
    (triangles, spheres(), offset, scale)
        .prop_map(|(mesh, spheres, offset, scale)| {
            // Those of `meshes` are placed already; spheres go where the mesh is.
            let at = mesh.bounds().map_or(Placed { offset, scale }, |bounds| Placed {
                offset: (bounds.low + bounds.high) * 0.5 / (bounds.high - bounds.low).max_element(),
                scale: (bounds.high - bounds.low).max_element(),
            });
            Model { mesh, spheres: spheres.iter().map(|sphere| at.sphere(sphere)).collect(), view: None }
        })
        .prop_filter("something to hit", |model| {
            build(model.clone(), &BuildOptions::default(), &|_| {}).is_ok()
        })
}

struct Placed {
    offset: Vec3,
    scale: f32,
}

impl Placed {
    fn sphere(&self, sphere: &Sphere) -> Sphere {
        let Self { offset, scale } = self;
        Sphere { centre: (sphere.centre + *offset) * *scale, radius: sphere.radius * *scale }
    }
}
