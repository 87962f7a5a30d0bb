//! Rays and scenes at the ends of what a float can hold: each has a stated outcome, is answered as brute
//! force answers, and as double precision does, without a panic, an endless loop or an allocation.

mod common;

use common::allocations::{Counting, allocations};
use common::{Dice, agree, meshes, ray_plans, reference, shapes};
use glam::Vec3;
use proptest::prelude::*;
use rt_core::camera::OrbitPlace;
use rt_core::{
    Flat, Frame, Hit, Kernel, Orbit, Packet16, Primitive, Ray, SceneView, Tiles, WorkCounts, render_tile,
};
use scene::{BuildError, BuildOptions, Mesh, build, builtin};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A mesh with its image.
struct Scene {
    mesh: Mesh,
    image: Vec<u8>,
}

impl Scene {
    fn new(mesh: Mesh) -> Self {
        Self { image: common::image(&mesh, 0.5, 4096), mesh }
    }

    fn view(&self) -> SceneView<Flat<'_>> {
        SceneView::new(Flat::new(&self.image)).expect("a valid image")
    }

    /// Traces a ray in every way there is, and compares with brute force and with double precision.
    fn trace(&self, ray: &Ray) -> Option<Hit> {
        let view = self.view();
        // Sixteen of them go together; one would go alone.
        let packet = Packet16::pack(&[*ray; 16]).0;
        let (results, allocated) = allocations(|| {
            let (nearest, any) = (view.nearest(ray, &mut ()), view.any(ray, &mut ()));
            let filtered = view.nearest_filtered(ray, |_| true, &mut ());
            (
                nearest,
                any,
                filtered,
                view.nearest16(&packet, u16::MAX, &mut ()),
                view.any16(&packet, u16::MAX, &mut ()),
            )
        });
        assert_eq!(allocated, 0, "tracing {ray:?} allocates");
        let hit = agree(&view, ray);
        let (nearest, any, filtered, nearest16, any16) = results;
        assert_eq!((nearest, filtered), (Ok(hit), Ok(hit)), "{ray:?}");
        let all = if hit.is_some() { u16::MAX } else { 0 };
        assert_eq!((any, any16), (Ok(hit.is_some()), Ok(all)), "{ray:?}");
        let nearest16 = nearest16.expect("sound");
        let id = |hit: &Hit| view.original_id(hit.primitive).expect("a place in the image");
        // Of what is stored in several cells, another place may be found.
        let named = |hit: Option<Hit>| hit.map(|hit| (id(&hit), Hit { primitive: Primitive(0), ..hit }));
        assert!((0..16).all(|lane| named(nearest16.hit(lane)) == named(hit)), "{ray:?}");
        reference::assert_agrees(&self.mesh, ray, hit.as_ref().map(|hit| (hit, id(hit))));
        hit
    }
}

fn ray(origin: [f32; 3], direction: [f32; 3]) -> Ray {
    Ray { origin: origin.into(), direction: direction.into(), t_max: f32::INFINITY }
}

/// Triangles with vertices of their own.
fn soup(triangles: impl IntoIterator<Item = [[f32; 3]; 3]>) -> Mesh {
    let positions: Vec<_> = triangles.into_iter().flatten().collect();
    let count = u32::try_from(positions.len() / 3).expect("a small mesh");
    Mesh { positions, triangles: (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect() }
}

fn joined(mut mesh: Mesh, other: &Mesh) -> Mesh {
    let first = u32::try_from(mesh.positions.len()).expect("a small mesh");
    mesh.positions.extend(&other.positions);
    mesh.triangles.extend(other.triangles.iter().map(|corners| corners.map(|vertex| vertex + first)));
    mesh
}

fn moved(mesh: &Mesh, scale: f32, offset: [f32; 3]) -> Mesh {
    let place = |p: &[f32; 3]| (Vec3::from(*p) * scale + Vec3::from(offset)).to_array();
    Mesh { positions: mesh.positions.iter().map(place).collect(), triangles: mesh.triangles.clone() }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn any_ray_at_any_mesh_finds_what_double_precision_finds(
        mesh in meshes(),
        plans in prop::collection::vec(ray_plans(), 40),
    ) {
        let scene = Scene::new(mesh);
        for plan in &plans {
            scene.trace(&plan.ray(&scene.mesh, &scene.view()));
        }
    }
}

#[test]
fn rays_in_the_faces_of_cells_and_through_their_corners_hit_what_is_there() {
    // The grid of this cube is the cube, so its faces, edges and corners are those of cells on all levels.
    let scene = Scene::new(shapes::cube());
    let grid = scene.view().header().grid;
    let to_world = scene.view().header().scale().inverse();
    for level in [1, 2, 5] {
        let cell = grid.size / 4.0_f32.powi(level);
        for axis in 0..3 {
            for (i, j) in [(0.0, 0.0), (1.0, 0.0), (1.0, 2.0), (2.0, 2.0), (3.0, 1.0)] {
                let mut steps = Vec3::ZERO;
                (steps[(axis + 1) % 3], steps[(axis + 2) % 3]) = (i, j);
                let mut origin = to_world.apply_to(grid.origin + steps * cell);
                origin[axis] = -3.0;
                let direction = Vec3::AXES[axis];
                let hit = scene.trace(&Ray { origin, direction, t_max: f32::INFINITY });
                assert_eq!(hit.map(|hit| hit.t), Some(2.0), "level {level}, axis {axis}, cell {i} {j}");
            }
        }
    }
    for corner in 0..8_u8 {
        let corner = [corner & 1, corner >> 1 & 1, corner >> 2].map(|bit| f32::from(bit) * 2.0 - 1.0);
        let hit = scene.trace(&ray(corner.map(|x| x * 3.0), corner.map(|x| -x)));
        assert_eq!(hit.map(|hit| hit.t), Some(2.0), "the diagonal meets the corner first");
    }
}

#[test]
fn a_ray_in_the_plane_of_a_face_hits_the_face_across_it() {
    let scene = Scene::new(shapes::cube());
    for (y, t) in [(1.0, Some(2.0)), (-1.0, Some(2.0)), (1.000_000_1, None), (0.999_999_9, Some(2.0))] {
        assert_eq!(scene.trace(&ray([-3.0, y, 0.3], [1.0, 0.0, 0.0])).map(|hit| hit.t), t, "y = {y}");
    }
}

#[test]
fn components_of_every_kind_in_every_place() {
    let scene = Scene::new(builtin::knot(500));
    let (tiny, denormal) = (f32::MIN_POSITIVE, f32::from_bits(1));
    let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    let good = [0.0, -0.0, denormal, -denormal, tiny, 1.0, -1.0, 1.0e-20, f32::MAX, f32::MIN];
    let all = [&bad[..], &good[..]].concat();
    for x in &all {
        for y in &all {
            for z in &all {
                let numbers = [*x, *y, *z];
                let is_ray = numbers.iter().all(|number| number.is_finite());
                let along = scene.trace(&ray([3.0, 0.1, 9.0], numbers));
                let from = scene.trace(&ray(numbers, [0.1, 0.2, -1.0]));
                assert!(is_ray || (along, from) == (None, None), "{numbers:?}");
            }
        }
    }
    let downwards = ray([3.0, 0.1, 9.0], [0.0, 0.0, -1.0]);
    let t = scene.trace(&downwards).expect("a hit").t;
    for (t_max, hits) in [(f32::NAN, false), (0.0, false), (-1.0, false), (denormal, false), (f32::MAX, true)]
    {
        assert_eq!(scene.trace(&Ray { t_max, ..downwards }).is_some(), hits, "t_max {t_max}");
    }
    assert!(scene.trace(&Ray { t_max: t, ..downwards }).is_some(), "t_max is inclusive");
    assert!(scene.trace(&Ray { t_max: t.next_down(), ..downwards }).is_none_or(|hit| hit.t < t));
}

#[test]
fn an_eye_inside_sees_the_inside_and_one_on_the_surface_does_not_see_what_it_touches() {
    let scene = Scene::new(shapes::sphere(30, 40));
    let mut dice = Dice(41);
    for _ in 0..2000 {
        let inside = Ray { origin: dice.point() * 0.5, direction: dice.direction(), t_max: f32::INFINITY };
        assert!(scene.trace(&inside).is_some(), "seed 41: {inside:?}");
    }
    // On a face, an edge and a corner of the cube, where the coordinates are exact.
    let cube = Scene::new(shapes::cube());
    for touching in [[0.3, 0.2, 1.0], [0.0, 0.0, 1.0], [1.0, 0.5, 1.0], [1.0, 1.0, 1.0]] {
        assert_eq!(cube.trace(&ray(touching, [0.1, 0.2, 1.0])), None, "outwards from {touching:?}");
        let through = cube.trace(&ray(touching, [-0.1, -0.2, -1.0])).map(|hit| hit.t);
        assert_eq!(through, Some(2.0), "through the cube from {touching:?}");
    }
}

#[test]
fn triangles_without_area_do_no_harm() {
    let line = |i: f32| [[0.0, 0.0, 0.0], [1.0 + i, 1.0 + i, 0.5], [0.5 + 0.5 * i, 0.5 + 0.5 * i, 0.25]];
    let lines = soup((0..300_u16).map(|i| line(f32::from(i) / 100.0)));
    let alone = Scene::new(lines.clone());
    let among = Scene::new(joined(lines, &builtin::knot(500)));
    let mut dice = Dice(42);
    for i in 0..2000_u16 {
        // Half of the rays go to points of the lines.
        let share = f32::from(i) / 1000.0;
        let aim = if i % 2 == 0 { Vec3::new(share, share, share * 0.5) } else { dice.point() };
        let origin = dice.point() * 5.0;
        let towards = Ray { origin, direction: aim - origin, t_max: f32::INFINITY };
        alone.trace(&towards);
        among.trace(&towards);
    }
}

#[test]
fn all_triangles_in_one_point_are_refused_by_name_and_with_company_left_out() {
    let point = soup(vec![[[0.1, 0.2, 0.3]; 3]; 100_000]);
    let refused = build(point.clone(), &BuildOptions::default(), &|_| {}).map(|_| ());
    assert_eq!(refused, Err(BuildError::AllCollapsed { triangles: 100_000, spheres: 0 }));
    let scene = Scene::new(joined(point, &shapes::cube()));
    assert_eq!((scene.view().header().collapsed, scene.view().header().primitives), (100_000, 12));
    assert_eq!(scene.trace(&ray([0.1, 0.2, 5.0], [0.0, 0.0, -1.0])).map(|hit| hit.t), Some(4.0));
}

#[test]
fn a_million_coincident_triangles_are_as_many_as_there_are_ways_to_write_them() {
    let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let written = |i: usize| {
        let mut corners = corners;
        corners.rotate_left(i % 3);
        if i % 2 == 1 {
            corners.swap(0, 1);
        }
        corners
    };
    let mesh = soup((0..1_000_000).map(written));
    let image = common::image(&mesh, 0.5, 4096);
    let view = SceneView::new(Flat::new(&image)).expect("a valid image");
    assert_eq!((view.header().primitives, view.header().repeated), (6, 999_994));
    let hit = agree(&view, &ray([0.2, 0.3, 4.0], [0.0, 0.0, -1.0])).expect("in the middle of them");
    // Of equal depth that one wins whose corners come first as numbers: 0 0 0, 0 1 0, 1 0 0.
    assert_eq!(written(5), [corners[0], corners[2], corners[1]]);
    assert_eq!((hit.t, view.original_id(hit.primitive)), (4.0, Some(5)));
    assert_eq!((hit.u, hit.v), (0.3, 0.2));
    assert_eq!(agree(&view, &ray([0.8, 0.3, 4.0], [0.0, 0.0, -1.0])), None);
}

#[test]
fn a_hundred_thousand_nearly_coincident_triangles_are_a_list_that_a_ray_ends() {
    let mut dice = Dice(43);
    let mut corner = |x: f32, y: f32| (Vec3::new(x, y, 0.0) + dice.point() * 1.0e-6).to_array();
    let mesh = soup((0..100_000).map(|_| [corner(0.0, 0.0), corner(1.0, 0.0), corner(0.0, 1.0)]));
    let scene = Scene::new(mesh);
    assert_eq!(scene.view().header().primitives, 100_000, "no copies where cells cannot tell them apart");
    for (x, hits) in [(0.2, true), (0.49, true), (0.51, false), (1.2, false)] {
        assert_eq!(scene.trace(&ray([x, 0.5, 4.0], [0.0, 0.0, -1.0])).is_some(), hits, "x = {x}");
    }
}

#[test]
fn coordinates_of_1e30_are_traced_and_larger_ones_refused() {
    let scene = Scene::new(moved(&shapes::sphere(20, 30), 1.0e30, [0.0; 3]));
    let hit = scene.trace(&ray([1.0e29, 1.0e29, 3.0e30], [0.0, 0.0, -1.0e30])).expect("the ball");
    assert!((hit.t - 2.0).abs() < 0.02, "{hit:?}");
    let mut dice = Dice(44);
    for _ in 0..500 {
        let towards =
            Ray { origin: dice.direction() * 4.0e30, direction: dice.direction(), t_max: f32::INFINITY };
        scene.trace(&towards);
        scene.trace(&Ray { direction: -towards.origin, ..towards }).expect("through the middle");
    }
    let larger = moved(&shapes::cube(), 2.6e30, [0.0; 3]);
    let refused = build(larger, &BuildOptions::default(), &|_| {}).map(|_| ());
    assert_eq!(refused, Err(BuildError::OutOfRange { largest: 2.6e30 }));
}

#[test]
fn a_millimetre_in_a_kilometre_is_seen_from_near_and_from_far() {
    // Lengths in metres. The knot is 6.6 units wide; where it lies a float can tell 7.6 micrometres apart.
    let place = [123.0, 77.0, -3.0];
    let ground = soup([[[-500.0, -500.0, -5.0], [500.0, -500.0, -5.0], [0.0, 500.0, -5.0]]]);
    let tiny = moved(&builtin::knot(5000), 1.0e-3 / 6.6, place);
    let scene = Scene::new(joined(tiny, &ground));
    let mut dice = Dice(45);
    let mut hits = 0;
    for distance in [2.0e-3, 1.0, 600.0] {
        for _ in 0..300 {
            let aim = Vec3::from(place) + dice.point() * 4.0e-4;
            let origin = Vec3::from(place) + dice.direction() * distance;
            let towards = Ray { origin, direction: aim - origin, t_max: 1.5 };
            hits += u32::from(scene.trace(&towards).is_some());
        }
        let mut work = WorkCounts::default();
        let origin = Vec3::from(place) + Vec3::Z * distance;
        let down = Ray { origin, direction: Vec3::NEG_Z, t_max: f32::INFINITY };
        scene.view().nearest(&down, &mut work).expect("sound").expect("the ground at least");
        // The knot is smaller than what cells and their allowances tell apart in so large a scene: a ray that
        // comes near may test all of it, and no triangle twice.
        assert!(work.triangles <= u64::from(scene.view().header().primitives), "{work:?}");
    }
    assert!(hits > 200, "{hits}");
}

#[test]
fn a_whole_frame_is_drawn_without_an_allocation() {
    let scene = Scene::new(builtin::knot(20_000));
    let view = scene.view();
    let orbit = Orbit::around(&view.header().bounds);
    let place = OrbitPlace { radius: 0.75, elevation: 20.0, frame: 0, frames: 1 };
    let frame = Frame::on_orbit(&orbit, &place, 64, 64).expect("a valid frame");
    let tiles = Tiles::of(frame.width, frame.height);
    let mut pixels = vec![0; 64 * 64];
    for kernel in Kernel::available() {
        for tile in tiles.ids().filter_map(|id| tiles.get(id)) {
            let draw = || render_tile(&view, &frame, tile, kernel, &mut pixels[..tile.pixels()], &mut ());
            let (counts, allocated) = allocations(draw);
            assert_eq!((allocated, counts.damaged), (0, 0));
        }
    }
    let (ids, allocated) = allocations(|| (view.original_id(Primitive(0)), view.geometry_id(Primitive(0))));
    assert!(ids.0.is_some() && ids.1.is_some() && allocated == 0);
}

#[test]
fn the_allocator_of_this_test_counts() {
    assert_eq!(allocations(|| vec![1_u8; 100]).1, 1);
}
