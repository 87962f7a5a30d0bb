//! The calls beside `nearest` and `any`: packets and filters say what single rays say.

mod common;

use common::{agree, image, meshes, ray_plans};
use proptest::prelude::*;
use rt_core::{Flat, GeometryId, Hits16, Packet16, Primitive, Ray, SceneView};
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
                let other = |other: &rt_core::Hit| scene.original_id(other.primitive) != id;
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
            prop_assert_eq!(hits.hit(lane), alone);
        }
    }
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
