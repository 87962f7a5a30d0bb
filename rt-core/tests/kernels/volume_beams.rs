//! Beams through volumes against rays: the same bytes and counts for every tile, with all lanes.

use std::io::Cursor;

use crate::common::drawing::{agree_on_pictures as agree, draw};
use crate::common::volume::InMemory;
use crate::common::watched::{Watched, watched};
use crate::common::{Dice, single};
use glam::Vec3;
use proptest::prelude::*;
use rt_core::camera::OrbitPlace;
use rt_core::{Frame, Isosurface, Kernel, Lanes, Orbit, SceneView, Solver};
use scene::volume::{SampleType, StoredType, VolumeName};
use scene::{BuildOptions, build, builtin, write_volume};

type Scene<'a> = SceneView<Watched<'a>>;

fn showing(values: &[f32]) -> Vec<Isosurface> {
    (0_u8..)
        .zip(values)
        .map(|(number, &value)| Isosurface { value, albedo: 0.8 - 0.2 * f32::from(number) })
        .collect()
}

/// A frame on the orbit around a volume.
fn on_orbit(scene: &Scene<'_>, place: &OrbitPlace, size: (u32, u32), isovalues: &[f32]) -> Frame {
    let frame =
        Frame::on_orbit(&Orbit::around(&scene.header().view), place, size.0, size.1).expect("a frame");
    frame.with_isosurfaces(&showing(isovalues), Solver::default()).expect("a frame")
}

/// Draws a volume from far and near, from all around and from inside; gives the pixels that showed a surface.
fn agree_from_everywhere(image: &[u8], isovalues: &[f32], what: &str) -> u64 {
    let scene = watched(image);
    let mut hits = 0;
    for (frame, radius) in [(0, 1.5), (1, 0.75), (2, 0.3), (3, 0.1), (4, 0.02), (5, 40.0), (6, 0.6)] {
        let place = OrbitPlace { radius, elevation: f64::from(frame) * 15.0 - 40.0, frame, frames: 7 };
        let frame = on_orbit(&scene, &place, (100, 75), isovalues);
        hits += agree(&scene, &frame, &format!("{what}, {place:?}")).hits;
    }
    hits
}

/// The image of a volume by its name.
fn image_named(name: &str) -> Vec<u8> {
    let name = VolumeName::recognise(name.as_ref()).expect("a sound name").expect("a volume");
    let mut out = Cursor::new(Vec::new());
    let mut source = name.open().expect("a source");
    write_volume(source.as_mut(), None, None, 16 << 10, &mut out, &|_| {}).expect("written");
    out.into_inner()
}

#[test]
fn analytic_volumes_are_drawn_the_same_from_everywhere() {
    for (name, isovalues) in [("gyroid:64", &[0.0, -2.0][..]), ("ml:64", &[0.5]), ("gyroid:150", &[0.0])] {
        assert!(agree_from_everywhere(&image_named(name), isovalues, name) > 15_000, "{name}");
    }
}

#[test]
fn real_scans_are_drawn_the_same() {
    for (name, isovalues) in [("engine", [80.5, 180.0]), ("bonsai", [38.5, 150.0])] {
        let Some(path) = crate::common::data(&format!("volumes/{name}.json")) else { return };
        let image = image_named(path.to_str().expect("a path"));
        let scene = watched(&image);
        for isovalues in [&isovalues[..], &isovalues[..1]] {
            for (frame, radius) in [(0, 0.75), (2, 0.2)] {
                let place = OrbitPlace { radius, elevation: 15.0, frame, frames: 8 };
                let frame = on_orbit(&scene, &place, (160, 160), isovalues);
                let counts = agree(&scene, &frame, &format!("{name}, {place:?}"));
                assert!(counts.hits > 3000 && counts.shadow > counts.lit, "{counts:?}");
            }
        }
    }
}

/// Samples of up to five kinds of space: smooth, noise, steps with plateaus, holes, extremes side by side.
fn sample(kind: usize, seed: u64, [x, y, z]: [usize; 3]) -> f32 {
    let wave =
        single((x as f64 * 0.7).sin() * 4.0 + (y as f64 * 0.5).cos() * 3.0 + (z as f64 * 0.9).sin() * 5.0);
    let mut dice = Dice(seed ^ (x as u64) << 40 ^ (y as u64) << 20 ^ z as u64);
    let noise = 20.0 * dice.unit();
    match kind {
        0 => wave + 8.0,
        1 => noise,
        2 => ((x / 3 + y / 2 * 2 + z / 4) % 16) as f32,
        3 if (x * 131 + y * 31 + z * 17) % 23 == 0 => [f32::NAN, f32::INFINITY, -f32::MAX][(x + y) % 3],
        3 => wave + noise * 0.3 + 6.0,
        _ => [1.0e-30, 9.0, 1.0e30, -1.0e30, 7.5][dice.below(5)],
    }
}

/// A volume that proptest thinks of.
#[derive(Clone, Debug)]
struct AnyVolume {
    dims: [usize; 3],
    kind: usize,
    seed: u64,
    spacing: [f64; 3],
    origin: [f64; 3],
    stored: Option<StoredType>,
}

impl AnyVolume {
    fn image(&self) -> Vec<u8> {
        let mut volume = InMemory::new(self.dims, |at| sample(self.kind, self.seed, at));
        let placed = volume.shape.with_spacing(self.spacing).and_then(|shape| shape.with_origin(self.origin));
        volume.shape = placed.expect("a shape");
        let stored = self.stored.filter(|_| self.kind < 3);
        if stored.is_some() {
            volume.samples.iter_mut().for_each(|sample| *sample = sample.round().clamp(0.0, 255.0));
            volume.shape.sample = SampleType::U8;
        }
        volume.image(stored, 4096)
    }
}

fn any_volume() -> impl Strategy<Value = AnyVolume> {
    let dims = prop_oneof![
        prop::array::uniform3(2..34_usize),
        (2..6_usize, 2..200_usize, 2..6_usize).prop_map(|(x, y, z)| [x, y, z]),
        Just([2, 2, 90]),
        Just([1, 9, 40]),
    ];
    let spacing = prop_oneof![Just([1.0; 3]), Just([1000.0, 1.0, 1.0]), Just([0.3, 1.0, 0.001])];
    let origin = prop_oneof![Just([0.0; 3]), Just([-3.0, 512.0, 0.125])];
    let stored = prop_oneof![Just(None), Just(Some(StoredType::U8)), Just(Some(StoredType::U16))];
    (dims, 0..5_usize, any::<u64>(), spacing, origin, stored).prop_map(
        |(dims, kind, seed, spacing, origin, stored)| AnyVolume { dims, kind, seed, spacing, origin, stored },
    )
}

/// A camera somewhere around or in the volume, looking anywhere, with a light anywhere.
fn any_frame(scene: &Scene<'_>, dice: &mut Dice) -> Option<Frame> {
    let bounds = scene.header().view;
    let place = OrbitPlace {
        radius: [0.02, 0.2, 0.6, 1.5, 30.0, 3000.0][dice.below(6)],
        elevation: f64::from(dice.unit()) * 180.0 - 90.0,
        // Every fourth along an axis.
        frame: u32::try_from(dice.below(90)).expect("small") * [1, 90, 1, 1][dice.below(4)],
        frames: 360,
    };
    let mut frame = Frame::on_orbit(&Orbit::around(&bounds), &place, 40, 40).ok()?;
    let (centre, extent) = ((bounds.low + bounds.high) * 0.5, bounds.high - bounds.low);
    if dice.below(2) == 0 {
        frame.light = centre + extent * dice.point() * [0.1, 0.6, 3.0, 100.0][dice.below(4)];
    }
    if dice.below(3) == 0 {
        frame.camera.eye = centre + extent * dice.point() * 0.6;
    }
    if dice.below(8) == 0 {
        frame.camera.x_step *= [0.01, 3.0, -1.0][dice.below(3)];
    }
    let isovalues = [[7.5, 3.0, 12.25, 9.0], [8.0, 8.5, 9.0, 9.25], [6.0; 4]][dice.below(3)];
    let solver = Solver::ALL[dice.below(2 * Solver::ALL.len()) % Solver::ALL.len()];
    frame.with_isosurfaces(&showing(&isovalues[..1 + dice.below(4)]), solver).ok()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, ..ProptestConfig::default() })]

    #[test]
    fn any_volume_is_drawn_the_same(volume in any_volume(), seed: u64) {
        let image = volume.image();
        let scene = watched(&image);
        let mut dice = Dice(seed);
        for _ in 0..4 {
            if let Some(frame) = any_frame(&scene, &mut dice) {
                agree(&scene, &frame, &format!("{frame:?}"));
            }
        }
    }

    #[test]
    fn volumes_that_lie_are_drawn_the_same(
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..200),
        seed: u64,
    ) {
        let mut bytes = InMemory::new([30; 3], |at| sample(0, 0, at)).image(None, 4096);
        for (place, value) in flips {
            let place = 4096 + place.index(bytes.len() - 4096);
            bytes[place] = value;
        }
        let scene = watched(&bytes);
        if let Some(frame) = any_frame(&scene, &mut Dice(seed)) {
            agree(&scene, &frame, &format!("{frame:?}"));
        }
    }
}

#[test]
fn meshes_spheres_and_volumes_in_one_scene_are_drawn_the_same() {
    let mut ball = InMemory::new([41; 3], |at| {
        150.0 - at.map(|i| (i as f32 - 20.0).powi(2)).iter().sum::<f32>()
            + 20.0 * single((at[0] as f64).sin())
    });
    ball.shape = ball.shape.with_spacing([0.2; 3]).and_then(|s| s.with_origin([-4.0; 3])).expect("a shape");
    let flake = builtin::sphereflake(3);
    for model in [builtin::knot(3000).into(), flake] {
        let built = build(model, &BuildOptions::default(), &|_| {}).expect("builds");
        let mut out = Cursor::new(Vec::new());
        write_volume(&mut ball, Some(&built), None, 4096, &mut out, &|_| {}).expect("written");
        let image = out.into_inner();
        assert!(agree_from_everywhere(&image, &[0.0, 60.0], "both") > 5000);
        // No sample is on both sides of this value: the mesh is all there is.
        assert!(agree_from_everywhere(&image, &[1.0e6], "the mesh") > 2000);
    }
}

#[test]
fn beams_read_at_most_three_tenths_more_pages_than_rays() {
    let image = image_named("gyroid:150");
    for radius in [0.75, 0.4] {
        let pages = |kernel: Kernel| {
            let scene = watched(&image);
            let place = OrbitPlace { radius, elevation: 20.0, frame: 1, frames: 7 };
            draw(&scene, &on_orbit(&scene, &place, (200, 200), &[0.0]), kernel);
            scene.memory().read()
        };
        let (by_rays, by_beams) = (pages(Kernel::Rays(Lanes::PORTABLE)), pages(Kernel::fastest()));
        assert!(by_rays > 100 && by_beams * 10 <= 13 * by_rays, "{by_beams} by beams, {by_rays} by rays");
    }
}

#[test]
fn rays_that_meet_nothing_read_no_brick() {
    let mut ball =
        InMemory::new([80; 3], |at| 1600.0 - at.map(|i| (i as f32 - 39.5).powi(2)).iter().sum::<f32>());
    let image = ball.image(None, 4096);
    let scene = watched(&image);
    let place = OrbitPlace { radius: 1.0, elevation: 0.0, frame: 0, frames: 1 };
    let mut frame = on_orbit(&scene, &place, (64, 64), &[1000.0]);
    // To the side of the ball, through corners of the volume.
    frame.camera.eye += Vec3::new(38.0, 38.0, 0.0);
    frame.camera.x_step *= 0.05;
    frame.camera.y_step *= 0.05;
    frame.camera.x_first *= 0.05;
    frame.camera.y_first *= 0.05;
    let (tiles, work) = draw(&scene, &frame, Kernel::fastest());
    assert!(tiles.iter().all(|(_, counts)| counts.hits == 0));
    assert!(work.branches > 0 && work.bricks == 0, "{work:?}");
}
