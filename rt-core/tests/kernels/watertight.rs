//! No ray passes through a surface at an edge or a vertex.
//!
//! Rays are aimed at random points of interior edges whose two triangles are turned to the eye the same way,
//! and at vertices all of whose triangles are. A ray that has no hit there is judged by exact arithmetic
//! ([`crate::common::pass`]): it is a leak unless the exact ray meets nothing, or meets only what is closer to a
//! silhouette than the rounding of its corners.
//!
//! The meshes of other people need the folder that `MEMSAVVY_DATA` names; their test skips, and says so, when
//! it is not set.

use std::fs;
use std::path::{Path, PathBuf};

use crate::common::pass::{Pass, judge};
use crate::common::surface::Surface;
use crate::common::target::{Aim, Tally, Target};
use crate::common::{Dice, image, on_circle, shapes, single};
use glam::Vec3;
use rt_core::{Flat, Ray, SceneView, brute};
use scene::{Mesh, builtin, read_mesh};

/// Closed meshes with fat triangles, with needles, and with few large ones.
fn closed_shapes() -> Vec<(String, Mesh)> {
    let spindle = |exponent: i32| {
        let mesh = shapes::spindle(10.0_f64.powi(exponent), 24);
        (format!("spindle of aspect 1e{exponent}"), mesh)
    };
    let named = |name: &str, mesh: Mesh| (name.to_owned(), mesh);
    let mut shapes = vec![
        named("sphere", shapes::sphere(20, 30)),
        named("torus", shapes::torus(40, 16)),
        named("cube", shapes::cube()),
        named("knot", builtin::knot(2000)),
    ];
    shapes.extend([1, 3, 6].map(spindle));
    shapes
}

/// Whether the triangles of a shape are wider than the rounding of its corners, by far.
fn is_fat(name: &str) -> bool {
    !name.contains("spindle")
}

#[test]
fn closed_shapes_of_any_size_and_aspect_do_not_leak() {
    let mut all = Tally::default();
    for (name, mesh) in closed_shapes() {
        for scale in SCALES {
            for mesh in [shapes::turned(&mesh, scale), scaled(&mesh, scale)] {
                let surface = Surface::new(&mesh);
                assert_eq!(surface.interior(), 1.0, "{name} is closed");
                let mut target = Target::new(format!("{name} at scale {scale:e}"), surface, 1);
                // A needle is so thin that its back is hit where its front should be: every ray is judged.
                let behind = if is_fat(&name) { 1.0e-3 } else { -1.0 };
                for distance in [0.4, 2.0, 30.0, 1000.0] {
                    target.shoot_from(distance, behind, 300);
                }
                if is_fat(&name) {
                    target.tally.assert_few_excused(&target.name);
                }
                all += target.tally;
            }
        }
    }
    println!("{all:?}");
    assert!(all.rays > 60_000);
}

#[test]
fn the_front_of_a_closed_shape_does_not_leak_to_rays_from_far_away() {
    let mut all = Tally::default();
    for (name, mesh) in closed_shapes() {
        for scale in SCALES {
            let closed = Surface::new(&shapes::turned(&mesh, scale));
            for direction in DIRECTIONS {
                let full_name = format!("{name} at scale {scale:e} seen along {direction}");
                let mut target = Target::new(full_name, closed.front(direction), 2);
                for distance in [10.0, 1.0e3, 1.0e5, 1.0e7] {
                    target.shoot_along(direction, distance, 60);
                }
                if is_fat(&name) && direction.abs().element_sum() == 1.0 {
                    target.tally.assert_few_excused(&target.name);
                }
                all += target.tally;
            }
        }
    }
    println!("{all:?}");
    assert!(all.rays > 30_000);
}

#[test]
fn a_hole_would_be_called_a_leak() {
    let mut target = Target::new("torus".to_owned(), Surface::new(&shapes::torus(40, 16)), 5);
    let mut leaks = 0;
    for _ in 0..500 {
        let Aim { point, around } = target.aim();
        let origin = point + target.dice.direction() * 3.0;
        let ray = Ray { origin, direction: point - origin, t_max: f32::INFINITY };
        let around = around.expect("a closed shape");
        if target.surface.all_turned_alike(&around, &ray) {
            let pass = judge(&target.surface, &ray, f32::INFINITY);
            leaks += u32::from(matches!(pass, Pass::Leak { .. }));
            assert_ne!(pass, Pass::MeetsNothing);
            assert_ne!(pass, Pass::HitBehindAim);
        }
    }
    assert!(leaks > 200, "{leaks}");
}

#[test]
fn meshes_of_other_people_do_not_leak() {
    let Some(data) = std::env::var_os("MEMSAVVY_DATA").map(PathBuf::from) else {
        eprintln!("skipped: MEMSAVVY_DATA does not name the data folder");
        return;
    };
    let mut meshes = 0;
    for folder in ["meshes", "meshes-dialects"] {
        for path in meshes_in(&data.join(folder)) {
            let surface = Surface::new(&read_mesh(&path).expect("a mesh of the data folder"));
            if surface.interior() > 0.0 {
                meshes += 1;
                shoot_at_mesh(&path.file_name().expect("a file").to_string_lossy(), surface);
            }
        }
    }
    assert!(meshes >= 20, "only {meshes} meshes in the data folder");
}

fn meshes_in(folder: &Path) -> Vec<PathBuf> {
    let files = fs::read_dir(folder).expect("a folder of meshes").map(|file| file.expect("a file").path());
    let is_mesh =
        |path: &PathBuf| path.extension().is_some_and(|extension| extension == "ply" || extension == "obj");
    let mut meshes: Vec<PathBuf> = files.filter(is_mesh).collect();
    meshes.sort();
    meshes
}

fn shoot_at_mesh(name: &str, surface: Surface) {
    let interior = surface.interior();
    let rays = if surface.mesh.triangles.len() > 10_000 { 100_000 } else { 3000 };
    let front = surface.front(Vec3::NEG_Z);
    if front.interior() > 0.0 {
        let mut front = Target::new(format!("front of {name}"), front, 4);
        for distance in [2.0, 1.0e4, 1.0e7] {
            front.shoot_along(Vec3::NEG_Z, distance, rays / 10);
        }
        println!("{}: {:?}", front.name, front.tally);
        front.tally.assert_few_excused(&front.name);
    }
    let mut target = Target::new(name.to_owned(), surface, 3);
    for distance in [0.4, 2.0, 100.0] {
        target.shoot_from(distance, 1.0e-3, rays);
    }
    println!("{}: {interior} of its edges are interior, {:?}", target.name, target.tally);
    target.tally.assert_few_excused(&target.name);
}

#[test]
fn from_inside_no_ray_gets_out() {
    // The rope's middle line is inside the knot; from there every ray meets the surface, through whatever it
    // is aimed.
    let mesh = builtin::knot(4000);
    let image = image(&mesh, 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    let mut dice = Dice(5);
    for _ in 0..20_000 {
        let t = f64::from(dice.unit()) * core::f64::consts::TAU;
        let distance = 2.0 + (3.0 * t).cos();
        let inside = [distance * (2.0 * t).cos(), distance * (2.0 * t).sin(), (3.0 * t).sin()];
        let origin = Vec3::from(inside.map(single));
        let [a, b, _] = mesh.triangles[dice.below(mesh.triangles.len())];
        let [a, b] = [a, b].map(|vertex| Vec3::from(mesh.positions[vertex as usize]));
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
    let cone = Mesh { positions, triangles: upper.chain(lower).collect() };
    let image = image(&cone, 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    let mut dice = Dice(9);
    for i in 0..4000_u32 {
        let origin = dice.point() * 0.05;
        let aim = Vec3::from(cone.positions[if i % 3 < 2 { i % 3 } else { 2 + i % spokes } as usize]);
        let ray = Ray { origin, direction: aim - origin, t_max: f32::INFINITY };
        assert!(brute::any(&scene, &ray) == Ok(true), "the test itself leaks: {ray:?}");
        assert!(scene.any(&ray, &mut ()) == Ok(true), "{ray:?} gets out");
    }
}

/// Powers of ten, not of two, so that coordinates round differently at each.
const SCALES: [f32; 5] = [1.0e-18, 1.0e-9, 1.0, 1.0e9, 1.0e18];

/// Along the axes rays meet exactly the point they are aimed at, from any distance; the others have few bits.
const DIRECTIONS: [Vec3; 5] =
    [Vec3::X, Vec3::NEG_Y, Vec3::NEG_Z, Vec3::new(0.5, -1.0, 0.25), Vec3::new(1.0, 1.0, 1.0)];

fn scaled(mesh: &Mesh, scale: f32) -> Mesh {
    let positions = mesh.positions.iter().map(|p| p.map(|x| x * scale)).collect();
    Mesh { positions, triangles: mesh.triangles.clone() }
}
