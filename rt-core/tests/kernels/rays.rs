//! The ray kernel against brute force: the same bits for every ray.

use crate::common::{Dice, agree, image, meshes, on_circle, ray_plans, single};
use glam::Vec3;
use proptest::prelude::*;
use rt_core::{Flat, Ray, SceneView, WorkCounts};
use scene::{Mesh, builtin};

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, max_shrink_iters: 2000, ..ProptestConfig::default() })]

    #[test]
    fn the_grid_finds_what_testing_every_triangle_finds(
        mesh in meshes(),
        plans in prop::collection::vec(ray_plans(), 60),
        slack in prop_oneof![Just(0.0_f32), Just(0.5), Just(1.0), Just(3.0)],
        page_bytes in prop_oneof![Just(4096_u32), Just(16_384), Just(65_536)],
    ) {
        let image = image(&mesh, slack, page_bytes);
        let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
        for plan in &plans {
            agree(&scene, &plan.ray(&mesh, &scene));
        }
    }
}

#[test]
fn many_rays_through_a_knot_agree() {
    for (triangles, slack) in [(3000, 0.5), (3000, 0.0), (20_000, 0.5)] {
        let mesh = builtin::knot(triangles);
        let image = image(&mesh, slack, 4096);
        let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
        let mut dice = Dice(7);
        let mut hits = 0;
        for _ in 0..2000 {
            let origin = dice.point() * 6.0;
            let ray = Ray { origin, direction: dice.point() * 3.0 - origin, t_max: f32::INFINITY };
            hits += u32::from(agree(&scene, &ray).is_some());
        }
        assert!(hits > 300, "only {hits} rays of 2000 hit the knot");
    }
}

#[test]
fn rays_that_are_no_rays_miss() {
    let image = image(&builtin::knot(1000), 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    let towards = Ray { origin: Vec3::new(3.0, 0.0, 9.0), direction: Vec3::NEG_Z, t_max: f32::INFINITY };
    assert!(agree(&scene, &towards).is_some());
    let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    for axis in 0..3 {
        for value in bad {
            let mut ray = towards;
            ray.origin[axis] = value;
            assert_eq!(agree(&scene, &ray), None);
            let mut ray = towards;
            ray.direction[axis] = value;
            assert_eq!(agree(&scene, &ray), None);
        }
    }
    for t_max in [f32::NAN, 0.0, -0.0, -1.0, f32::NEG_INFINITY, 1.0e-44] {
        assert_eq!(agree(&scene, &Ray { t_max, ..towards }), None);
    }
    assert_eq!(agree(&scene, &Ray { direction: Vec3::ZERO, ..towards }), None);
    assert_eq!(agree(&scene, &Ray { origin: Vec3::splat(f32::MAX), ..towards }), None);
}

#[test]
fn denormal_directions_are_directions() {
    let image = image(&builtin::knot(1000), 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    let direction = Vec3::new(0.0, 0.0, -f32::from_bits(100));
    let ray = Ray { origin: Vec3::new(3.0, 0.0, 9.0), direction, t_max: f32::INFINITY };
    let hit = agree(&scene, &ray);
    assert!(
        hit.is_none_or(|hit| hit.t.is_infinite()),
        "the depth does not fit f32 in lengths of {direction}"
    );
}

#[test]
fn of_a_million_equal_triangles_the_first_is_kept() {
    let positions = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let mesh = Mesh { positions, triangles: vec![[0, 1, 2]; 1_000_000] };
    let image = image(&mesh, 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    assert_eq!((scene.header().triangles, scene.header().repeated), (1_000_000, 999_999));
    let ray = Ray { origin: Vec3::new(0.2, 0.3, 4.0), direction: Vec3::NEG_Z, t_max: f32::INFINITY };
    let hit = agree(&scene, &ray).expect("in the middle of them");
    assert_eq!((hit.t, scene.original_id(hit.primitive)), (4.0, Some(0)));
}

#[test]
fn triangles_that_no_cell_can_separate_are_a_list() {
    // All in one plane, one over the other, each a hair larger than the one before.
    let count = 20_000_u32;
    let corner = |i: u32, axis: usize| {
        let mut corner = [0.0; 3];
        corner[axis] = single(1.0 + f64::from(i) * 1.0e-7);
        corner
    };
    let positions = (0..count).flat_map(|i| [[0.0; 3], corner(i, 0), corner(i, 1)]).collect();
    let triangles: Vec<[u32; 3]> = (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    let image = image(&Mesh { positions, triangles }, 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    assert!(scene.header().primitives < 5 * count, "{} stored", scene.header().primitives);
    let ray = Ray { origin: Vec3::new(0.2, 0.3, 4.0), direction: Vec3::NEG_Z, t_max: f32::INFINITY };
    let mut work = WorkCounts::default();
    assert_eq!(agree(&scene, &ray).map(|hit| hit.t), Some(4.0));
    scene.nearest(&ray, &mut work).expect("a sound image").expect("a hit");
    let past = Ray { origin: Vec3::new(0.8, 0.8, 4.0), ..ray };
    assert_eq!(agree(&scene, &past), None);
    assert!(work.triangles <= 2 * u64::from(count), "{work:?}");
}

#[test]
fn a_fan_of_needles_around_one_vertex_stays_small() {
    let spokes = 50_000_u32;
    let rim = (0..spokes).map(|i| {
        let [x, y] = on_circle(f64::from(i) / f64::from(spokes));
        [x, y, 0.0]
    });
    let positions = core::iter::once([0.0; 3]).chain(rim).collect();
    let triangles = (0..spokes).map(|i| [0, i + 1, (i + 1) % spokes + 1]).collect();
    let mesh = Mesh { positions, triangles };
    let image = image(&mesh, 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    assert!(scene.header().primitives < 5 * spokes, "{} stored", scene.header().primitives);
    let mut dice = Dice(3);
    for _ in 0..200 {
        let at = dice.point() * Vec3::new(0.7, 0.7, 0.0);
        let origin = at + Vec3::new(0.1, 0.2, 3.0);
        let ray = Ray { origin, direction: at - origin, t_max: f32::INFINITY };
        assert!(agree(&scene, &ray).is_some(), "the disc has no hole at {at}");
    }
}
