//! The three triangle tests against each other and against exact arithmetic.

use crate::common::exact::side;
use crate::common::pass::{Pass, judge};
use crate::common::surface::{Side, Surface};
use crate::common::{Dice, image, shapes};
use glam::Vec3;
use proptest::prelude::*;
use rt_core::camera::OrbitPlace;
use rt_core::triangle_f64::F64Ray;
use rt_core::triangle_moller::MollerRay;
use rt_core::triangle_test::TriangleTest;
use rt_core::triangle_woop::{Crossing, WoopRay};
use rt_core::{
    Flat, Frame, Kernel, Lanes, Orbit, Ray, SceneView, TileId, Tiles, TriangleTestKind, WorkCounts,
    render_tile,
};
use scene::builtin;

/// The answers of Woop, Möller-Trumbore and `f64`: hit or miss.
fn answers(ray: &Ray, corners: [Vec3; 3]) -> [bool; 3] {
    fn hits<T: TriangleTest>(ray: &Ray, corners: [Vec3; 3]) -> bool {
        T::new(ray.origin, ray.direction).intersect(corners, ray.t_max).is_some()
    }
    [hits::<WoopRay>(ray, corners), hits::<MollerRay>(ray, corners), hits::<F64Ray>(ray, corners)]
}

/// Whether a ray meets a triangle with `0 < t`, edges and corners included; exact.
fn exact(ray: &Ray, [a, b, c]: [Vec3; 3]) -> bool {
    let (direction, origin) = (ray.direction.to_array(), ray.origin.to_array());
    let around = |p: Vec3, q: Vec3| side(direction, p.into(), q.into(), origin);
    let sides = [around(a, b), around(b, c), around(c, a)];
    let inside = !(sides.contains(&1) && sides.contains(&-1)) && sides != [0; 3];
    // The corner `a` as the origin of the plane: the ray meets it ahead when both determinants agree.
    let ahead = side((a - ray.origin).into(), b.into(), c.into(), ray.origin.into())
        * side(direction, b.into(), c.into(), a.into());
    inside && ahead > 0
}

fn small_integer() -> impl Strategy<Value = Vec3> {
    [-8..=8_i8, -8..=8, -8..=8].prop_map(|corner| Vec3::from(corner.map(f32::from)))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 20_000, ..ProptestConfig::default() })]

    #[test]
    fn where_nothing_rounds_all_three_are_exact_on_edges_and_corners_too(
        corners in [small_integer(), small_integer(), small_integer()],
        origin in small_integer(),
        // The largest component is a power of two, so the shear is exact.
        steps in [-4..=4_i8, -4..=4_i8],
        along in prop_oneof![Just(4.0_f32), Just(-4.0)],
        axis in 0..3_usize,
    ) {
        let mut direction = Vec3::splat(along);
        direction[(axis + 1) % 3] = f32::from(steps[0]);
        direction[(axis + 2) % 3] = f32::from(steps[1]);
        let ray = Ray { origin, direction, t_max: f32::INFINITY };
        let expected = exact(&ray, corners);
        prop_assert_eq!(answers(&ray, corners), [expected; 3], "Woop, Möller, f64 for {:?} {:?}", ray, corners);
    }

    #[test]
    fn woop_and_f64_differ_only_where_an_edge_is_within_the_rounding_of_its_corners(
        corners in [point(), point(), point()],
        size in prop_oneof![Just(1.0_f32), Just(1.0e-3), Just(1.0e-6)],
        aim in [0.0..1.0_f32, -1.0e-6..1.0e-6_f32],
        distance in prop_oneof![Just(1.0_f32), Just(100.0), Just(1.0e4)],
        direction in point(),
    ) {
        let corners = corners.map(|corner| corners[0] + (corner - corners[0]) * size);
        let [a, b, c] = corners;
        let aim = a + (b - a) * aim[0] + (c - a) * aim[1];
        let ray = Ray { origin: aim - direction * distance, direction, t_max: f32::INFINITY };
        let surface = Surface::new(&scene::Mesh {
            positions: corners.map(|corner| corner.to_array()).to_vec(),
            triangles: vec![[0, 1, 2]],
        });
        prop_assume!(direction.abs().max_element() > 1.0e-3 && !surface.mesh.triangles.is_empty());
        let [woop, _, reference] = answers(&ray, corners);
        if reference && !woop {
            let pass = judge(&surface, &ray, f32::INFINITY);
            prop_assert!(matches!(pass, Pass::AtSilhouette | Pass::MeetsNothing), "{:?}: {:?}", ray, pass);
        }
    }

    #[test]
    fn single_precision_rejects_nothing_that_double_precision_accepts(
        corners in [sheared(), sheared(), sheared()],
    ) {
        // Corners that are already sheared: a ray down the z axis through 0 shears them by nothing, so `f64`
        // decides about the same numbers.
        let ray = Ray { origin: Vec3::ZERO, direction: Vec3::Z, t_max: f32::INFINITY };
        let corners = corners.map(|[x, y]| Vec3::new(x, y, 1.0));
        let [woop, _, reference] = answers(&ray, corners);
        prop_assert_eq!(woop, reference);
    }
}

fn point() -> impl Strategy<Value = Vec3> + Clone {
    [-1.0..1.0_f32, -1.0..1.0_f32, -1.0..1.0_f32].prop_map(Vec3::from)
}

/// Numbers that differ in the last bits, or by many powers of two.
fn sheared() -> impl Strategy<Value = [f32; 2]> {
    let ulps = |base: f32| (0..4_u32).prop_map(move |ulps| f32::from_bits(base.to_bits() + ulps));
    let number =
        prop_oneof![ulps(1.0), ulps(-1.0), ulps(0.1), ulps(-0.3), ulps(1.0e-20), -1.0..1.0_f32, Just(0.0)];
    [number.clone(), number]
}

#[test]
fn over_a_whole_scene_woop_finds_what_f64_finds_but_for_rays_at_edges() {
    let mesh = builtin::knot(4000);
    let image = image(&mesh, 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    let mut dice = Dice(31);
    let mut differ = [0; 2];
    for _ in 0..20_000 {
        let origin = dice.point() * 6.0;
        let ray = Ray { origin, direction: dice.point() * 3.0 - origin, t_max: f32::INFINITY };
        let hit = |hit: Option<rt_core::Hit>| hit.and_then(|hit| scene.original_id(hit.primitive));
        let woop = hit(scene.nearest(&ray, &mut ()).expect("sound"));
        let reference = hit(scene.nearest_by::<F64Ray, _>(&ray, &mut ()).expect("sound"));
        let moller = hit(scene.nearest_by::<MollerRay, _>(&ray, &mut ()).expect("sound"));
        assert_eq!(scene.any_by::<F64Ray, _>(&ray, &mut ()), Ok(reference.is_some()));
        differ[0] += u32::from(woop != reference);
        differ[1] += u32::from(moller != reference);
    }
    println!("of 20,000 rays Woop differs from f64 in {}, Möller-Trumbore in {}", differ[0], differ[1]);
    assert!(differ[0] <= 4 && differ[1] <= 20, "{differ:?}");
}

/// The test of Möller and Trumbore, one triangle after the other.
#[derive(Clone, Copy, Debug)]
struct OneByOne(MollerRay);

impl TriangleTest for OneByOne {
    fn new(origin: Vec3, direction: Vec3) -> Self {
        Self(MollerRay::new(origin, direction))
    }

    fn intersect(&self, corners: [Vec3; 3], t_max: f32) -> Option<Crossing> {
        self.0.intersect(corners, t_max)
    }
}

#[test]
fn moller_finds_sixteen_at_a_time_what_it_finds_one_by_one() {
    let image = image(&builtin::knot(4000), 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    let mut dice = Dice(33);
    let mut hits = 0;
    for _ in 0..5000 {
        let origin = dice.point() * 6.0;
        let ray = Ray { origin, direction: dice.point() * 3.0 - origin, t_max: f32::INFINITY };
        let expected = scene.nearest_by::<OneByOne, _>(&ray, &mut ());
        hits += u32::from(matches!(expected, Ok(Some(_))));
        for lanes in Lanes::available() {
            let scene = scene.with_lanes(lanes);
            assert_eq!(scene.nearest_by::<MollerRay, _>(&ray, &mut ()), expected, "{ray:?} with {lanes}");
            assert_eq!(
                scene.any_by::<MollerRay, _>(&ray, &mut ()).ok(),
                expected.map(|hit| hit.is_some()).ok()
            );
        }
    }
    assert!(hits > 500, "{hits} of 5000 rays hit the knot");
}

#[test]
fn a_frame_of_moller_is_the_same_with_every_kernel_and_shows_what_its_rays_hit() {
    let image = image(&builtin::knot(4000), 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    let orbit = Orbit::around(&scene.header().view);
    let place = OrbitPlace { radius: 0.75, elevation: 20.0, frame: 0, frames: 1 };
    let frame = Frame::on_orbit(&orbit, &place, 32, 32).expect("a valid frame");
    let frame = frame.with_triangle_test(TriangleTestKind::Moller);
    let tile = Tiles::of(32, 32).get(TileId(0)).expect("the only one");
    let mut hits = 0;
    for pixel in 0..1024 {
        let direction = frame.camera.direction(frame.camera.row(pixel / 32), pixel % 32);
        let ray = Ray { origin: frame.camera.eye, direction, t_max: f32::INFINITY };
        hits += u64::from(scene.nearest_by::<MollerRay, _>(&ray, &mut ()).expect("sound").is_some());
    }
    let draw = |kernel| {
        let (mut pixels, mut work) = ([0; 1024], WorkCounts::default());
        let counts = render_tile(&scene, &frame, tile, kernel, &mut pixels, &mut work);
        (pixels, counts, work)
    };
    let first = draw(Kernel::rays());
    assert!(first.1.hits == hits && hits > 200, "{:?}, {hits} rays hit", first.1);
    for kernel in Kernel::available() {
        assert_eq!(draw(kernel), first, "{kernel}");
    }
}

#[test]
fn aimed_at_edges_moller_leaks_and_the_others_do_not() {
    let surface = Surface::new(&shapes::turned(&builtin::knot(4000), 1.0));
    let image = image(&surface.mesh, 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    for (distance, moller_leaks_max) in [(2.0, 0.06), (100.0, 0.06)] {
        let mut dice = Dice(32);
        let (mut rays, mut leaks) = (0, [0; 3]);
        for _ in 0..20_000 {
            let triangle = u32::try_from(dice.below(surface.mesh.triangles.len())).expect("a mesh");
            let side = Side { triangle, corner: dice.below(3) };
            let [a, b] = surface.ends(side);
            let aim = a + (b - a) * dice.unit();
            let origin = aim + dice.direction() * surface.size() * distance;
            let ray = Ray { origin, direction: aim - origin, t_max: f32::INFINITY };
            let across = surface.across(side).expect("a closed mesh");
            if surface.all_turned_alike(&[triangle, across], &ray) {
                rays += 1;
                let hits = [
                    scene.nearest(&ray, &mut ()),
                    scene.nearest_by::<MollerRay, _>(&ray, &mut ()),
                    scene.nearest_by::<F64Ray, _>(&ray, &mut ()),
                ];
                for (leaks, hit) in leaks.iter_mut().zip(hits) {
                    let t = hit.expect("sound").map_or(f32::INFINITY, |hit| hit.t);
                    let near = t <= (distance + 1.0e-3) / distance;
                    *leaks += u32::from(!near && matches!(judge(&surface, &ray, t), Pass::Leak { .. }));
                }
            }
        }
        let share = f64::from(leaks[1]) / f64::from(rays);
        println!("{distance} sizes away, of {rays} rays leak: Woop, Möller-Trumbore, f64: {leaks:?}");
        assert_eq!((leaks[0], leaks[2]), (0, 0), "{distance} sizes away, seed 32");
        assert!(leaks[1] > 0 && share < moller_leaks_max, "{share} of the rays leak");
    }
}
