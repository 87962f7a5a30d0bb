//! Beams against rays: the same bytes and counts for every tile, with all lanes.

use crate::common::drawing::agree_on_pictures as agree;
use crate::common::models::{image_of, models};
use crate::common::watched::{Watched, watched};
use crate::common::{Dice, image, meshes};
use glam::Vec3;
use proptest::prelude::*;
use rt_core::camera::OrbitPlace;
use rt_core::sphere::Sphere;
use rt_core::{Bounds, Frame, Kernel, Lanes, Orbit, SceneView, Tile, Tiles, WorkCounts, render_tile};
use scene::{Model, builtin};

fn on_orbit(bounds: &Bounds, place: &OrbitPlace, width: u32, height: u32) -> Frame {
    Frame::on_orbit(&Orbit::around(bounds), place, width, height).expect("a frame")
}

#[test]
fn a_knot_is_drawn_the_same_from_everywhere() {
    for (triangles, slack) in [(2000, 0.5), (40_000, 0.5), (40_000, 0.0), (300_000, 0.5)] {
        let image = image(&builtin::knot(triangles), slack, 16 << 10);
        let scene = watched(&image);
        let mut hits = 0;
        for (frame, radius) in [(0, 1.5), (1, 0.75), (2, 0.3), (3, 0.1), (4, 0.02), (5, 40.0), (6, 1.0)] {
            let place = OrbitPlace { radius, elevation: f64::from(frame) * 15.0 - 40.0, frame, frames: 7 };
            let frame = on_orbit(&scene.header().bounds, &place, 150, 121);
            hits += agree(&scene, &frame, &format!("{triangles} triangles, {place:?}")).hits;
        }
        assert!(hits > 20_000, "{hits}");
    }
}

#[test]
fn sphereflakes_are_drawn_the_same() {
    // The last has 597,871 spheres.
    for depth in [2, 4, 6] {
        let model = builtin::sphereflake(depth);
        let image = image_of(&model, 0.5, 16 << 10);
        let scene = watched(&image);
        let mut hits = 0;
        for (frame, radius) in [(0, 1.5), (1, 0.75), (2, 0.3), (3, 0.1), (4, 0.02), (5, 40.0), (6, 1.0)] {
            let place = OrbitPlace { radius, elevation: f64::from(frame) * 15.0 - 40.0, frame, frames: 7 };
            let frame = on_orbit(&scene.header().view, &place, 150, 121);
            hits += agree(&scene, &frame, &format!("sphereflake {depth}, {place:?}")).hits;
        }
        assert!(hits > 20_000, "{hits}");
    }
}

#[test]
fn real_meshes_are_drawn_the_same() {
    for name in ["bunny", "dragon"] {
        let Some(path) = crate::common::data(&format!("meshes/{name}.ply")) else { return };
        let mesh = scene::read_mesh(&path).expect("a sound mesh");
        let image = image(&mesh, 0.5, 16 << 10);
        let scene = watched(&image);
        for (frame, radius) in [(0, 1.5), (3, 0.75)] {
            let place = OrbitPlace { radius, elevation: 0.0, frame, frames: 8 };
            let frame = on_orbit(&scene.header().bounds, &place, 512, 512);
            let counts = agree(&scene, &frame, &format!("{name}, {place:?}"));
            assert!(counts.hits > 10_000 && counts.shadow > counts.lit, "{counts:?}");
        }
    }
}

/// A camera somewhere around or in the scene, looking anywhere, with a light anywhere.
fn any_frame(scene: &SceneView<Watched<'_>>, dice: &mut Dice, size: u32) -> Option<Frame> {
    let bounds = scene.header().bounds;
    let place = OrbitPlace {
        radius: [0.02, 0.2, 0.6, 1.5, 30.0, 3000.0][dice.below(6)],
        elevation: f64::from(dice.unit()) * 180.0 - 90.0,
        frame: u32::try_from(dice.below(360)).expect("small"),
        frames: 360,
    };
    // `None` when the scene is so small, for where it lies, that the eye cannot be told from its middle.
    let mut frame = Frame::on_orbit(&Orbit::around(&bounds), &place, size, size).ok()?;
    let (centre, extent) = ((bounds.low + bounds.high) * 0.5, bounds.high - bounds.low);
    if dice.below(2) == 0 {
        frame.light = centre + extent * dice.point() * [0.1, 0.6, 3.0, 100.0][dice.below(4)];
    }
    if dice.below(4) == 0 {
        frame.camera.eye = centre + extent * dice.point() * 0.6;
    }
    if dice.below(8) == 0 {
        frame.camera.x_step *= [0.01, 3.0, -1.0][dice.below(3)];
    }
    Some(frame)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn any_scene_is_drawn_the_same(
        mesh in meshes(),
        slack in prop_oneof![Just(0.0_f32), Just(0.5), Just(3.0)],
        seed: u64,
    ) {
        let image = image(&mesh, slack, 4096);
        let scene = watched(&image);
        let mut dice = Dice(seed);
        for _ in 0..4 {
            if let Some(frame) = any_frame(&scene, &mut dice, 40) {
                agree(&scene, &frame, &format!("{frame:?}"));
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, ..ProptestConfig::default() })]

    #[test]
    fn any_scene_with_spheres_is_drawn_the_same(
        model in models(),
        slack in prop_oneof![Just(0.0_f32), Just(0.5), Just(3.0)],
        seed: u64,
    ) {
        let image = image_of(&model, slack, 4096);
        let scene = watched(&image);
        let mut dice = Dice(seed);
        for _ in 0..4 {
            if let Some(frame) = any_frame(&scene, &mut dice, 40) {
                agree(&scene, &frame, &format!("{frame:?}"));
            }
        }
    }
}

#[test]
fn many_spheres_in_one_place_are_drawn_the_same() {
    let mut dice = Dice(7);
    let mut spheres = vec![Sphere { centre: Vec3::ZERO, radius: 1.0 }; 100];
    // Almost the same ones, shells within shells, one around everything, and specks.
    let radii = [1.0, 1.000_000_1, 0.999_999_9, 0.5, 1.0e-4, 1.0e-6, 40.0];
    spheres.extend((0..600).map(|number| {
        let centre = dice.point() * [0.0, 1.0e-7, 1.0e-3, 1.0][number / 7 % 4];
        Sphere { centre, radius: radii[number % 7] }
    }));
    let image = image_of(&Model::from(spheres), 0.5, 4096);
    let scene = watched(&image);
    let bounds = scene.header().bounds;
    let mut hits = 0;
    for (frame, radius) in [(0, 1.5), (1, 0.1), (2, 0.02), (3, 0.025), (4, 0.012), (5, 0.001), (6, 20.0)] {
        let place = OrbitPlace { radius, elevation: 20.0, frame, frames: 7 };
        let mut frame = on_orbit(&bounds, &place, 70, 65);
        hits += agree(&scene, &frame, &format!("{place:?}")).hits;
        frame.light = Vec3::new(1.5, 0.2, -0.3);
        agree(&scene, &frame, &format!("light within, {place:?}"));
    }
    assert!(hits > 10_000, "{hits}");
}

#[test]
fn frames_that_no_camera_makes_are_drawn_the_same() {
    let image = image(&builtin::knot(3000), 0.5, 4096);
    let scene = watched(&image);
    let sound = on_orbit(
        &scene.header().bounds,
        &OrbitPlace { radius: 1.0, elevation: 5.0, frame: 0, frames: 1 },
        33,
        18,
    );
    let mut frames = vec![sound; 8];
    frames[0].camera.right = Vec3::ZERO;
    frames[1].camera.forward = Vec3::ZERO;
    frames[2].camera.x_step = 0.0;
    frames[3].camera.eye = Vec3::splat(1.0e30);
    frames[4].light = sound.camera.eye;
    frames[5].camera.up = sound.camera.right;
    frames[6].camera.forward = sound.camera.forward * 1.0e-20;
    frames[7].shadow_offset = -1.0;
    for (number, frame) in frames.iter().enumerate() {
        agree(&scene, frame, &format!("frame {number}"));
    }
    let all: u64 = frames
        .iter()
        .map(|frame| agree(&scene, &Frame { flags: Frame::NO_SHADOWS, ..*frame }, "no shadows").shadow)
        .sum();
    assert_eq!(all, 0);
}

#[test]
fn beams_read_hardly_more_pages_than_rays() {
    let image = image(&builtin::knot(300_000), 0.5, 4096);
    let scene = watched(&image);
    for (frame, radius) in [(0, 1.5), (1, 0.75), (2, 0.4)] {
        let place = OrbitPlace { radius, elevation: 20.0, frame, frames: 7 };
        let frame = on_orbit(&scene.header().bounds, &place, 256, 256);
        // Each tile by itself, as nodes draw them whose memory is short.
        let tiles = Tiles::of(frame.width, frame.height);
        let pages = |kernel: Kernel, is_far: bool| {
            let of_tile = |tile: Tile| {
                scene.memory().forget(is_far);
                let mut work = WorkCounts::default();
                render_tile(&scene, &frame, tile, kernel, &mut vec![0; tile.pixels()], &mut work);
                scene.memory().read()
            };
            tiles.ids().filter_map(|id| tiles.get(id)).map(of_tile).sum::<usize>()
        };
        let by_rays = pages(Kernel::Rays(Lanes::PORTABLE), true);
        let [far, at_hand] = [true, false].map(|is_far| pages(Kernel::fastest(), is_far));
        println!("from {radius}: {by_rays} pages by rays, {far} by beams, {at_hand} with all at hand");
        assert!(by_rays > 500 && far * 100 <= 103 * by_rays && far < at_hand, "{by_rays} {far} {at_hand}");
    }
}
