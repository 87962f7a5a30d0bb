//! The calls beside `nearest` and `any`: packets and filters say what single rays say.

use crate::common::watched::{self, watched};
use crate::common::{agree, image, meshes, ray_plans};
use glam::Vec3;
use proptest::prelude::*;
use rt_core::camera::OrbitPlace;
use rt_core::{
    Flat, Frame, GeometryId, Hit, Hits16, Kernel, Lanes, Orbit, Packet16, Primitive, Ray, SceneMemory,
    SceneView, TileId, Tiles, WorkCounts, render_tile,
};
use scene::builtin;

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, ..ProptestConfig::default() })]

    #[test]
    fn a_filter_that_accepts_all_changes_nothing_and_one_that_refuses_all_leaves_nothing(
        mesh in meshes(),
        plans in prop::collection::vec(ray_plans(), 60),
    ) {
        let image = image(&mesh, 0.5, 4096);
        let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
        for plan in &plans {
            let ray = plan.ray(&mesh, &scene);
            let hit = agree(&scene, &ray);
            prop_assert_eq!(scene.nearest_filtered(&ray, |_| true, &mut ()), Ok(hit));
            prop_assert_eq!(scene.any_filtered(&ray, |_| true, &mut ()), Ok(hit.is_some()));
            prop_assert_eq!(scene.nearest_filtered(&ray, |_| false, &mut ()), Ok(None));
            prop_assert_eq!(scene.any_filtered(&ray, |_| false, &mut ()), Ok(false));
            if let Some(hit) = hit {
                let id = scene.original_id(hit.primitive);
                let other = |other: &Hit| scene.original_id(other.primitive) != id;
                let behind = scene.nearest_filtered(&ray, other, &mut ()).expect("sound");
                prop_assert!(behind.is_none_or(|behind| behind.t >= hit.t && other(&behind)));
                prop_assert_eq!(scene.any_filtered(&ray, other, &mut ()), Ok(behind.is_some()));
            }
        }
    }

    #[test]
    fn a_packet_finds_what_its_active_rays_find(
        mesh in meshes(),
        plans in prop::collection::vec(ray_plans(), 0..20),
        mask in any::<u16>(),
    ) {
        let image = image(&mesh, 0.5, 4096);
        let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
        let rays: Vec<Ray> = plans.iter().map(|plan| plan.ray(&mesh, &scene)).collect();
        let (packet, filled) = Packet16::pack(&rays);
        prop_assert_eq!(filled.count_ones() as usize, rays.len().min(16));
        let active = filled & mask;
        let hits = scene.nearest16(&packet, active, &mut ()).expect("sound");
        prop_assert_eq!(hits.mask & !active, 0);
        prop_assert_eq!(scene.any16(&packet, active, &mut ()), Ok(hits.mask));
        for (lane, ray) in rays.iter().enumerate().take(16) {
            prop_assert_eq!(packet.ray(lane), *ray);
            let alone = if active >> lane & 1 == 1 { scene.nearest(ray, &mut ()).expect("sound") } else { None };
            prop_assert_eq!(named(&scene, hits.hit(lane)), named(&scene, alone));
        }
    }
}

/// A hit, named by the number that what was hit had in the model: of what is stored in several cells, any place may be found.
fn named<M: SceneMemory>(scene: &SceneView<M>, hit: Option<Hit>) -> Option<(Hit, Option<u32>)> {
    hit.map(|hit| (Hit { primitive: Primitive(0), ..hit }, scene.original_id(hit.primitive)))
}

/// Sixteen rays about `ray`, apart by `spread` of its direction, from its origin or, `beside`, from around it.
fn rays_about(ray: &Ray, spread: f32, beside: bool) -> [Ray; 16] {
    let size = ray.direction.abs().max_element() * spread;
    core::array::from_fn(|lane| {
        let [x, y] = [lane % 4, lane / 4].map(|at| (at as f32 - 1.5) * size);
        let away = Vec3::new(x, y, x - y);
        let origin = if beside { ray.origin + away } else { ray.origin };
        Ray { origin, direction: ray.direction + away, ..*ray }
    })
}

/// Checks packets of all lanes against single rays, and tells how many rays hit.
fn check_packet(scene: &SceneView<Flat<'_>>, rays: &[Ray], active: u16) -> usize {
    let (packet, _) = Packet16::pack(rays);
    let alone: Vec<_> = rays.iter().map(|ray| scene.nearest(ray, &mut ()).expect("sound")).collect();
    for lanes in Lanes::available() {
        let scene = scene.with_lanes(lanes);
        let hits = scene.nearest16(&packet, active, &mut ()).expect("sound");
        for (lane, alone) in alone.iter().enumerate() {
            let expected = if active >> lane & 1 == 1 { *alone } else { None };
            assert_eq!(
                named(&scene, hits.hit(lane)),
                named(&scene, expected),
                "{lanes}, lane {lane}, {:?}",
                rays[lane]
            );
            let place = scene.nearest_place(&rays[lane], &mut ()).expect("sound");
            assert_eq!(place.map(|place| place.t), alone.map(|hit| hit.t));
        }
        assert_eq!(scene.any16(&packet, active, &mut ()), Ok(hits.mask), "{lanes}");
    }
    alone.iter().flatten().count()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn rays_that_go_the_same_way_find_together_what_each_finds_alone(
        mesh in meshes(),
        plans in prop::collection::vec(ray_plans(), 12),
        spread in prop::sample::select(vec![0.0, 1.0e-6, 1.0e-3, 0.03, 0.2, 1.0]),
        beside: bool,
        active in prop_oneof![Just(u16::MAX), any::<u16>()],
    ) {
        let image = image(&mesh, 0.5, 4096);
        let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
        for plan in &plans {
            check_packet(&scene, &rays_about(&plan.ray(&mesh, &scene), spread, beside), active);
        }
    }
}

#[test]
fn packets_see_triangles_and_spheres_as_rays_do() {
    for model in [builtin::sphereflake(2), builtin::knot(20_000).into()] {
        let image =
            scene::build(model, &Default::default(), &|_| {}).expect("builds").to_bytes(4096).expect("fits");
        let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
        let bounds = scene.header().view;
        let (middle, size) = ((bounds.low + bounds.high) * 0.5, bounds.high - bounds.low);
        let mut hits = 0;
        for step in 0..400_u16 {
            let angle = f32::from(step) * 0.1;
            let origin =
                middle + size * 1.3 * Vec3::new(angle.cos(), 0.4 - f32::from(step % 7) * 0.1, angle.sin());
            let towards = middle + size * 0.3 * Vec3::new((angle * 3.0).sin(), 0.0, (angle * 5.0).cos());
            let ray = Ray { origin, direction: towards - origin, t_max: f32::INFINITY };
            hits += check_packet(&scene, &rays_about(&ray, 0.002, step % 2 == 0), u16::MAX);
        }
        assert!(hits > 2000, "{hits} of 6400 rays hit anything");
    }
}

#[test]
fn rays_that_go_the_same_way_read_less_together() {
    let image = image(&builtin::knot(20_000), 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    let ray = Ray { origin: [3.0, 0.1, 9.0].into(), direction: [0.0, 0.0, -1.0].into(), t_max: 100.0 };
    let rays = rays_about(&ray, 0.001, false);
    let (mut together, mut alone) = (WorkCounts::default(), WorkCounts::default());
    scene.nearest16(&Packet16::pack(&rays).0, u16::MAX, &mut together).expect("sound");
    for ray in &rays {
        scene.nearest(ray, &mut alone).expect("sound").expect("the rope");
    }
    assert!(together.branches * 8 <= alone.branches, "{together:?} {alone:?}");
    assert!(together.clusters * 4 <= alone.clusters, "{together:?} {alone:?}");
}

#[test]
fn no_kernel_reads_ids() {
    let image = image(&builtin::knot(5000), 0.5, 4096);
    let scene = watched(&image);
    let ids = scene.header().segments.ids;
    assert!(ids.offset.is_multiple_of(watched::PAGE_BYTES as u64), "ids begin with a page");
    let mut work = WorkCounts::default();
    let ray = Ray { origin: [3.0, 0.1, 9.0].into(), direction: [0.0, 0.0, -1.0].into(), t_max: 100.0 };
    let hit = scene.nearest(&ray, &mut work).expect("sound").expect("the rope");
    let place = scene.nearest_place(&ray, &mut work).expect("sound").expect("the rope");
    assert_eq!((place.t, place.u, place.v, place.primitive), (hit.t, hit.u, hit.v, hit.primitive));
    assert_eq!(scene.any(&ray, &mut work), Ok(true));
    assert_eq!(scene.nearest16(&Packet16::pack(&[ray; 16]).0, 1, &mut work).expect("sound").mask, 1);
    let orbit = Orbit::around(&scene.header().view);
    let place = OrbitPlace { radius: 0.75, elevation: 20.0, frame: 0, frames: 1 };
    let frame = Frame::on_orbit(&orbit, &place, 32, 32).expect("a valid frame");
    let tile = Tiles::of(32, 32).get(TileId(0)).expect("the only one");
    for kernel in Kernel::available() {
        let counts = render_tile(&scene, &frame, tile, kernel, &mut [0; 1024], &mut work);
        assert!(counts.hits > 100 && counts.damaged == 0, "{kernel}: {counts:?}");
    }
    assert!(scene.memory().read() > 3);
    assert_eq!(scene.memory().read_in(ids.offset..ids.offset + ids.bytes), 0, "an id was read");
}

#[test]
fn an_idle_packet_and_one_of_no_rays_hit_nothing() {
    let image = image(&builtin::knot(1000), 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    let nan = [f32::NAN; 16];
    let packet = Packet16 { origin: [nan; 3], direction: [nan; 3], t_max: nan };
    for active in [0, u16::MAX] {
        assert_eq!(scene.nearest16(&packet, active, &mut ()), Ok(Hits16::NONE));
        assert_eq!(scene.any16(&packet, active, &mut ()), Ok(0));
    }
    assert_eq!(scene.geometry_id(Primitive(0)), Some(GeometryId::TRIANGLES));
    assert_eq!(scene.geometry_id(Primitive(u32::MAX)), None);
}
