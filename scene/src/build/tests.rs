use rt_core::sphere::Sphere;
use rt_core::{Flat, Ray, SceneView, WorkCounts};

use super::*;
use crate::builtin::knot;
use crate::mesh::Mesh;

fn built(mesh: Mesh) -> Result<Vec<u8>, BuildError> {
    build(mesh, &BuildOptions::default(), &|_| {}).map(|scene| scene.to_bytes(4096).expect("fits"))
}

fn moved(mesh: Mesh, scale: f32, offset: f32) -> Mesh {
    let positions = mesh.positions.into_iter().map(|p| p.map(|x| x * scale + offset)).collect();
    Mesh { positions, ..mesh }
}

fn triangle(positions: [[f32; 3]; 3]) -> Mesh {
    Mesh { positions: positions.to_vec(), triangles: vec![[0, 1, 2]] }
}

/// Whether a ray through the middle of each triangle hits something where the triangle is.
fn assert_hit_everywhere(mesh: &Mesh, bytes: &[u8]) {
    let scene = SceneView::new(Flat::new(bytes)).expect("a valid image");
    for corners in mesh.triangles.iter().step_by(1 + mesh.triangles.len() / 50) {
        let [a, b, c] = corners.map(|v| glam::Vec3::from(mesh.positions[v as usize]));
        let normal = rt_core::shade::normal([a, b, c], glam::Vec3::X);
        let size = (b - a).abs().max_element().max((c - a).abs().max_element());
        let middle = a * 0.25 + b * 0.25 + c * 0.5;
        let origin = middle + normal * size;
        let hit = scene.nearest(&Ray { origin, direction: middle - origin, t_max: 2.0 }, &mut ());
        assert!(hit.expect("sound").is_some(), "nothing at {middle}");
    }
}

#[test]
fn meshes_that_cannot_be_traced_are_refused_by_name() {
    let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    assert_eq!(built(Mesh::default()), Err(BuildError::NoTriangles));
    assert_eq!(built(Mesh { positions: corners.to_vec(), triangles: vec![] }), Err(BuildError::NoTriangles));
    let missing = Mesh { triangles: vec![[0, 1, 2], [0, 9, 1]], ..triangle(corners) };
    assert_eq!(built(missing), Err(BuildError::NoSuchVertex { triangle: 1, vertex: 9, vertices: 3 }));
    let nan = triangle([corners[0], [0.0, f32::NAN, 0.0], corners[2]]);
    assert_eq!(built(nan), Err(BuildError::NotFinite { vertex: 1 }));
    let points = triangle([[3.0; 3]; 3]);
    assert_eq!(built(points), Err(BuildError::AllCollapsed { triangles: 1, spheres: 0 }));
    assert_eq!(built(triangle([[0.0; 3]; 3])), Err(BuildError::AllCollapsed { triangles: 1, spheres: 0 }));
    for scale in [1.0e35, 1.0e-38] {
        let result = built(moved(triangle(corners), scale, 0.0));
        assert_eq!(result, Err(BuildError::OutOfRange { largest: scale }));
    }
}

#[test]
fn the_largest_and_smallest_coordinates_are_traced_alike() {
    let mut mesh = knot(500);
    // What is tiny beside the rest would become denormal.
    mesh.positions.iter_mut().flatten().filter(|x| x.abs() < 1.0e-6).for_each(|x| *x = 0.0);
    let at_unit_size = built(mesh.clone()).expect("builds");
    let records = |bytes: &[u8]| bytes[4096..].to_vec();
    for exponent in [-100, -60, 1, 98] {
        let scaled = moved(mesh.clone(), 2.0_f32.powi(exponent), 0.0);
        let bytes = built(scaled.clone()).expect("builds");
        assert!(records(&bytes) == records(&at_unit_size), "2^{exponent} gives other records");
        if exponent > -60 && exponent < 60 {
            assert_hit_everywhere(&scaled, &bytes);
        }
    }
}

#[test]
fn flat_single_and_far_off_meshes_build() {
    let square = |z: f32| Mesh {
        positions: vec![[0.0, 0.0, z], [1.0, 0.0, z], [1.0, 1.0, z], [0.0, 1.0, z]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    };
    let meshes = [
        triangle([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
        triangle([[-4.0e5, 0.0, 0.0], [4.0e5, 1.0e-3, 0.0], [0.0, 5.0e-3, 0.0]]),
        square(0.0),
        square(1.0e6),
        square(-3.0e-7),
        moved(knot(2000), 1.0, 1.0e4),
        moved(knot(2000), 1.0e-3, -20.0),
        moved(triangle([[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), 2.0_f32.powi(-20), 1.0),
    ];
    for mesh in meshes {
        let bytes = built(mesh.clone()).expect("builds");
        assert_hit_everywhere(&mesh, &bytes);
    }
}

#[test]
fn a_tiny_object_in_a_huge_scene_builds_in_bounds() {
    let mut mesh = moved(knot(3000), 1.0e-6, 0.2);
    let first = u32::try_from(mesh.positions.len()).expect("a small mesh");
    mesh.positions.extend([[-1000.0, -1000.0, -1.0], [1000.0, -1000.0, -1.0], [0.0, 1000.0, -1.0]]);
    mesh.triangles.push([first, first + 1, first + 2]);
    let bytes = built(mesh).expect("builds");
    let scene = SceneView::new(Flat::new(&bytes)).expect("a valid image");
    let towards =
        |t: f32| Ray { origin: [0.2, 0.2, t].into(), direction: [0.0, 0.0, -1.0].into(), t_max: 1.0e9 };
    assert_eq!(scene.nearest(&towards(10.0), &mut ()).expect("sound").map(|hit| hit.t.round()), Some(11.0));
}

#[test]
fn a_statue_in_a_landscape_is_not_a_crowd() {
    // A metre of small triangles on a kilometre of squares of 10 m.
    let mut mesh = moved(knot(30_000), 1.0 / 6.6, 0.5);
    let first = u32::try_from(mesh.positions.len()).expect("a small mesh");
    for i in 0..=100_u8 {
        for j in 0..=100_u8 {
            mesh.positions.push([f32::from(i) * 10.0 - 500.0, f32::from(j) * 10.0 - 500.0, -1.0]);
        }
    }
    for i in (0..100).flat_map(|row| (0..100).map(move |column| first + row * 101 + column)) {
        mesh.triangles.extend([[i, i + 1, i + 102], [i, i + 102, i + 101]]);
    }
    let bytes = built(mesh).expect("builds");
    let scene = SceneView::new(Flat::new(&bytes)).expect("a valid image");
    let (mut work, mut hits) = (WorkCounts::default(), 0);
    for i in 0..40_u8 {
        for j in 0..40_u8 {
            let origin = [f32::from(i) / 40.0, f32::from(j) / 40.0, 3.0].into();
            let ray = Ray { origin, direction: [0.01, 0.02, -1.0].into(), t_max: 3.5 };
            hits += u32::from(scene.nearest(&ray, &mut work).expect("sound").is_some());
        }
    }
    assert!(hits > 400, "{hits}");
    // With a slack of half a typical edge it would be 59 leaves a ray.
    assert!(work.leaves < 15 * 1600, "{work:?}");
}

#[test]
fn a_scene_of_one_scale_has_the_slack_that_was_asked_for() {
    for mesh in [knot(500), knot(40_000)] {
        let scene = build(mesh, &BuildOptions { slack: 0.7 }, &|_| {}).expect("builds");
        assert_eq!(scene.grid.slack, 0.7 * scene.typical_edge);
    }
}

#[test]
fn progress_ends_at_the_total() {
    let last = std::sync::Mutex::new(None);
    let scene = build(knot(20_000), &BuildOptions::default(), &|progress| {
        assert!(progress.done <= progress.total);
        *last.lock().expect("unpoisoned") = Some(progress);
    });
    let last = last.into_inner().expect("unpoisoned").expect("some progress");
    assert_eq!((last.stage, last.done), (Stage::Grow, last.total));
    assert!(scene.is_ok());
}

#[test]
fn the_slack_trades_copies_for_padding() {
    let primitives = |slack| {
        let scene = build(knot(20_000), &BuildOptions { slack }, &|_| {}).expect("builds");
        scene.header(4096).expect("fits").primitives
    };
    let (none, half, two) = (primitives(0.0), primitives(0.5), primitives(2.0));
    assert!(none > half && half > two, "{none} {half} {two}");
    assert!(f64::from(two) < 1.01 * 20_000.0, "{two}");
}

#[test]
fn spheres_that_cannot_be_traced_are_refused_by_name() {
    let ball = Sphere { centre: glam::Vec3::ONE, radius: 0.5 };
    let refused = |sphere: Sphere| build(vec![ball, sphere], &BuildOptions::default(), &|_| {}).err();
    for radius in [f32::NAN, f32::INFINITY, f32::MAX] {
        assert_eq!(refused(Sphere { radius, ..ball }), Some(BuildError::SphereNotFinite { sphere: 1 }));
    }
    let centre = glam::Vec3::new(0.0, f32::NEG_INFINITY, 0.0);
    assert_eq!(refused(Sphere { centre, ..ball }), Some(BuildError::SphereNotFinite { sphere: 1 }));
    let negative = Some(BuildError::NegativeRadius { sphere: 1, radius: -0.25 });
    assert_eq!(refused(Sphere { radius: -0.25, ..ball }), negative);
    assert_eq!(refused(Sphere { radius: 1.0e35, ..ball }), Some(BuildError::OutOfRange { largest: 1.0e35 }));
    assert_eq!(refused(Sphere { radius: 0.0, ..ball }), None);

    let points = vec![Sphere { radius: 0.0, ..ball }; 3];
    let all_collapsed = BuildError::AllCollapsed { triangles: 0, spheres: 3 };
    assert_eq!(build(points, &BuildOptions::default(), &|_| {}).err(), Some(all_collapsed));
    let upside_down = Bounds { low: glam::Vec3::ONE, high: glam::Vec3::ZERO };
    let model = Model { view: Some(upside_down), ..Model::from(vec![ball]) };
    assert_eq!(build(model, &BuildOptions::default(), &|_| {}).err(), Some(BuildError::View));
    let errors = [
        BuildError::SphereNotFinite { sphere: 1 },
        BuildError::NegativeRadius { sphere: 1, radius: -0.25 },
        BuildError::AllCollapsed { triangles: 0, spheres: 3 },
        BuildError::View,
    ];
    assert!(errors.iter().all(|error| !error.to_string().contains('\n')));
}

#[test]
fn the_view_is_what_the_model_says_or_its_bounds() {
    let header = |model: Model| {
        build(model, &BuildOptions::default(), &|_| {}).expect("builds").header(4096).expect("fits")
    };
    let flake = header(crate::builtin::sphereflake(1));
    assert_eq!((flake.view.low, flake.view.high), (glam::Vec3::splat(-2.0), glam::Vec3::splat(2.0)));
    assert_eq!((flake.bounds.low.x, flake.bounds.high.z), (-8.0, 8.0));
    let knot = header(knot(100).into());
    assert_eq!(knot.view, knot.bounds);
}
