//! Images of volumes: addresses beyond 32 bits, bytes that lie, pages that cannot be had, meshes in the same scene.

use core::cell::Cell;
use std::io::Cursor;

use crate::common::volume::{InMemory, view};
use crate::common::{Dice, single};
use glam::Vec3;
use proptest::prelude::*;
use rt_core::camera::OrbitPlace;
use rt_core::image::{HEADER_BYTES, Segment};
use rt_core::volume::{
    BRICK_CELLS, RANGE_BYTES, RangeBranch, SampleKind, TABLE_BYTES, TABLE_EDGES, Volume, VolumeTable,
    bricks_along, levels_for, morton, range_offset, ranges_bytes,
};
use rt_core::{
    Bounds, Damaged, Flat, Frame, Isosurface, Kernel, Lanes, Orbit, Ray, SceneMemory, SceneNeeds, SceneView,
    Solver, Tiles, WorkCounts, render_tile,
};
use scene::volume::StoredType;
use scene::{BuildOptions, build, builtin, write_volume};

/// A dense volume too large for any machine: what is read is made up when it is.
struct Procedural {
    header: Vec<u8>,
    length: u64,
    volume: Volume,
    ranges: u64,
    bricks: u64,
    table: u64,
}

/// A small ball around the far corner sample less 10 along each axis, and one around sample 10.
fn sample(dims: [u32; 3], at: [u64; 3]) -> u8 {
    let near = |centre: [f64; 3]| {
        let r2: f64 = (0..3).map(|axis| (at[axis] as f64 - centre[axis]).powi(2)).sum();
        200.0 - 20.0 * r2.sqrt()
    };
    let far = dims.map(|count| f64::from(count) - 11.0);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the cast saturates")]
    let sample = near(far).max(near([10.0; 3])) as u8;
    sample
}

impl Procedural {
    fn new(dims: [u32; 3]) -> Self {
        let levels = levels_for(dims);
        // Breadth first: all branches of a level together, in Morton order.
        let branches: u64 = (0..levels).map(|level| 64_u64.pow(level)).sum();
        let volume = Volume {
            dims,
            sample: SampleKind::U8,
            levels,
            origin: [0.0; 3],
            spacing: [1.0; 3],
            slope: 1.0,
            intercept: 0.0,
            low: 0.0,
            high: 200.0,
            branches,
            bricks: 64_u64.pow(levels),
        };
        let mut image = InMemory::new([9; 3], |[x, ..]| x as f32).image(None, 4096);
        let mut header = *view(&image).header();
        let mut end = 4096;
        let mut segment = |bytes: u64| {
            let offset = end;
            end = (offset + bytes).next_multiple_of(4096);
            Segment { offset, bytes, checksum: 0 }
        };
        header.segments.table = segment(TABLE_BYTES as u64);
        header.segments.ranges = segment(ranges_bytes(branches));
        header.segments.bricks = segment(volume.brick_offset(volume.bricks));
        (header.image_bytes, header.volume) = (end, Some(volume));
        let (ranges, bricks, table) =
            (header.segments.ranges.offset, header.segments.bricks.offset, header.segments.table.offset);
        image.truncate(0);
        Self { header: header.emit().to_vec(), length: end, volume, ranges, bricks, table }
    }

    /// The branch with this number: its ranges tell nothing.
    fn branch(&self, index: u64) -> RangeBranch {
        let mut start = 0;
        let mut count = 1;
        while index >= start + count {
            start += count;
            count *= 64;
        }
        let child_start = if count == 64_u64.pow(self.volume.levels - 1) { 0 } else { start + count };
        RangeBranch {
            low: [0; 64],
            high: [255; 64],
            present: u64::MAX,
            first: child_start + 64 * (index - start),
        }
    }

    /// The brick with this Morton number.
    fn brick(&self, index: u64) -> Vec<u8> {
        let mut brick = [0_u64; 3];
        for level in 0..self.volume.levels {
            let digit = u32::try_from(index >> (6 * level) & 63).expect("six bits");
            let at = rt_core::grid::cell_coordinates(digit);
            for axis in 0..3 {
                brick[axis] |= u64::from(at[axis]) << (2 * level);
            }
        }
        let cells = u64::from(BRICK_CELLS.unsigned_abs());
        let corner = brick.map(|at| at * cells);
        (0..512_u64)
            .map(|i| sample(self.volume.dims, [corner[0] + i % 8, corner[1] + i / 8 % 8, corner[2] + i / 64]))
            .collect()
    }
}

impl SceneMemory for Procedural {
    type Record<'a> = Vec<u8>;

    fn record(&self, offset: u64, length: usize) -> Option<Vec<u8>> {
        if offset < HEADER_BYTES as u64 {
            return Some(self.header.clone());
        }
        if offset >= self.bricks {
            assert_eq!(((offset - self.bricks) % 512, length), (0, 512));
            return Some(self.brick((offset - self.bricks) / 512));
        }
        if offset >= self.ranges {
            let place = offset - self.ranges;
            let index = place / 4096 * 28 + place % 4096 / RANGE_BYTES as u64;
            assert_eq!(range_offset(index), place);
            return Some(bytemuck::bytes_of(&self.branch(index)).to_vec());
        }
        assert_eq!((offset, length), (self.table, TABLE_BYTES));
        let mut table: VolumeTable = bytemuck::Zeroable::zeroed();
        table.edges = core::array::from_fn::<f32, TABLE_EDGES, _>(|edge| edge as f32);
        Some(bytemuck::bytes_of(&table).to_vec())
    }

    fn length(&self) -> u64 {
        self.length
    }
}

#[test]
fn far_corners_of_volumes_beyond_32_bits_are_where_they_should_be() {
    // 2^33 samples and more: 2048^3, 5120^3, and one whose bricks alone need 36 bits.
    for dims in [[2048; 3], [5120; 3], [20_000; 3], [300_000, 1000, 50]] {
        let procedural = Procedural::new(dims);
        let scene = SceneView::new(procedural).expect("a sound header");
        let surfaces = scene.isosurfaces(&[100.5], Solver::default()).expect("sound").expect("a surface");
        let far = Vec3::from(dims.map(|count| count as f32 - 11.0));
        for centre in [Vec3::splat(10.0), far] {
            for axis in 0..3 {
                let mut direction = Vec3::new(0.03, -0.02, 0.01);
                direction[axis] = -1.0;
                let origin = centre - direction * 8.0;
                let ray = Ray { origin, direction, t_max: f32::INFINITY };
                let hit = surfaces.nearest(&ray, &mut ()).expect("sound").expect("the ball");
                let radius = (origin + direction * hit.t - centre).length();
                assert!((4.4..5.2).contains(&radius), "{dims:?}: {hit:?} is {radius} from {centre}");
            }
            let past = Ray { origin: centre + Vec3::splat(8.0), direction: Vec3::X, t_max: f32::INFINITY };
            assert_eq!(surfaces.any(&past, &mut ()), Ok(false));
        }
    }
    assert!(morton([2856; 3]) > u128::from(u32::MAX), "bricks of 20000^3");
    assert_eq!(bricks_along(20_000), 2857);
}

fn blob() -> InMemory {
    InMemory::new([40, 30, 36], |[x, y, z]| {
        let r2 = (x as f32 - 20.0).powi(2) + (y as f32 - 15.0).powi(2) + (z as f32 - 18.0).powi(2);
        single((x as f64 * 0.9).sin() * 30.0) + 150.0 - r2
    })
}

/// Traces some rays, and checks the bounds of their work.
fn trace(bytes: &[u8]) -> usize {
    let scene = SceneView::new(Flat::new(bytes)).expect("the header is sound");
    let volume = scene.header().volume.expect("a volume");
    let mut dice = Dice(5);
    let mut damaged = 0;
    let Ok(Some(surfaces)) = scene.isosurfaces(&[3.0, 60.0], Solver::default()) else { return 1 };
    for _ in 0..40 {
        let origin = Vec3::new(20.0, 15.0, 18.0) + dice.point() * 60.0;
        let target = Vec3::new(20.0, 15.0, 18.0) + dice.point() * 10.0;
        let ray = Ray { origin, direction: target - origin, t_max: f32::INFINITY };
        let mut work = WorkCounts::default();
        damaged += usize::from(surfaces.nearest(&ray, &mut work).is_err());
        assert!(work.branches <= volume.branches && work.bricks <= volume.bricks, "{work:?}");
    }
    damaged
}

proptest! {
    #[test]
    fn flipped_bytes_do_no_harm(
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..300),
        tree_only in any::<bool>(),
    ) {
        let mut bytes = blob().image(None, 4096);
        let end = {
            let scene = SceneView::new(Flat::new(&bytes)).expect("sound");
            usize::try_from(scene.header().segments.bricks.offset).expect("small")
        };
        let end = if tree_only { end } else { bytes.len() };
        for (place, value) in flips {
            let place = 4096 + place.index(end - 4096);
            bytes[place] = value;
        }
        trace(&bytes);
    }
}

#[test]
fn branches_that_lead_back_to_the_root_end() {
    let mut bytes = blob().image(None, 4096);
    let header = *view(&bytes).header();
    let volume = header.volume.expect("a volume");
    let start = usize::try_from(header.segments.ranges.offset).expect("small");
    for index in 0..volume.branches {
        let offset = start + usize::try_from(range_offset(index)).expect("small");
        let cycle = RangeBranch { low: [0; 64], high: [255; 64], present: u64::MAX, first: 0 };
        bytes[offset..offset + RANGE_BYTES].copy_from_slice(bytemuck::bytes_of(&cycle));
    }
    trace(&bytes);
    for index in 0..volume.branches {
        let offset = start + usize::try_from(range_offset(index)).expect("small");
        let beyond = RangeBranch { low: [0; 64], high: [255; 64], present: u64::MAX, first: u64::MAX - 3 };
        bytes[offset..offset + RANGE_BYTES].copy_from_slice(bytemuck::bytes_of(&beyond));
    }
    assert!(trace(&bytes) > 0);
}

/// Memory whose pages cannot be had after a while.
struct Failing<'a>(Flat<'a>, Cell<u32>);

impl SceneMemory for Failing<'_> {
    type Record<'b>
        = &'b [u8]
    where
        Self: 'b;

    fn record(&self, offset: u64, length: usize) -> Option<&[u8]> {
        self.1.set(self.1.get().checked_sub(1)?);
        self.0.record(offset, length)
    }

    fn length(&self) -> u64 {
        self.0.length()
    }
}

#[test]
fn a_page_that_cannot_be_had_ends_the_ray_with_its_record() {
    let bytes = blob().image(None, 4096);
    let ray = Ray { origin: Vec3::new(20.2, 15.3, 90.0), direction: Vec3::NEG_Z, t_max: f32::INFINITY };
    let nearest = |records: u32| {
        let scene = SceneView::new(Failing(Flat::new(&bytes), Cell::new(records + 1))).expect("the header");
        let surfaces = scene.isosurfaces(&[3.0], Solver::default())?.expect("a surface");
        surfaces.nearest(&ray, &mut ())
    };
    assert_eq!(nearest(0), Err(Damaged::Table));
    assert_eq!(nearest(1), Err(Damaged::RangeBranch(0)));
    let needed = (0..100).find(|&records| nearest(records).is_ok()).expect("a ray needs few records");
    assert!(nearest(needed).expect("enough").is_some());
    assert!((0..needed).all(|records| nearest(records).is_err()));
}

fn draw(scene: &SceneView<Flat<'_>>, frame: &Frame, kernel: Kernel) -> Vec<u8> {
    let tiles = Tiles::of(frame.width, frame.height);
    let mut picture = Vec::new();
    for tile in tiles.ids().filter_map(|id| tiles.get(id)) {
        let mut pixels = vec![0; tile.pixels()];
        let counts = render_tile(scene, frame, tile, kernel, &mut pixels, &mut ());
        assert_eq!(counts.damaged, 0);
        picture.extend(pixels);
    }
    picture
}

fn frame(view: &Bounds, radius: f32, surfaces: &[Isosurface], solver: Solver) -> Frame {
    let place = OrbitPlace { radius, elevation: 20.0, frame: 1, frames: 7 };
    let frame = Frame::on_orbit(&Orbit::around(view), &place, 150, 99).expect("a frame");
    frame.with_isosurfaces(surfaces, solver).expect("a frame")
}

#[test]
fn every_kernel_draws_the_bits_that_rays_draw() {
    let grey = |value: f32, albedo: f32| Isosurface { value, albedo };
    let mut thin = InMemory::new([2, 61, 17], |[x, y, z]| ((x * 3 + y * y + z * 5) % 11) as f32);
    thin.shape = thin.shape.with_spacing([10.0, 1.0, 3.0]).expect("spacing");
    let mut holes = InMemory::new([33; 3], |[x, y, z]| {
        if (x * y + z) % 37 == 0 { f32::NAN } else { ((x + 2 * y + 3 * z) % 17) as f32 }
    });
    let volumes: [(&mut InMemory, &[Isosurface]); 3] = [
        (&mut blob(), &[grey(3.0, 0.8), grey(60.0, 0.3)]),
        (&mut thin, &[grey(5.0, 0.8)]),
        (&mut holes, &[grey(8.0, 0.8), grey(3.5, 0.4)]),
    ];
    for (volume, surfaces) in volumes {
        let image = volume.image(None, 4096);
        let scene = view(&image);
        for solver in Solver::ALL {
            for radius in [0.1, 0.75, 1.5, 4.0] {
                let frame = frame(&scene.header().view, radius, surfaces, solver);
                let expected = draw(&scene, &frame, Kernel::Rays(Lanes::PORTABLE));
                let is_seen = expected.iter().any(|byte| *byte != expected[0]);
                assert!(is_seen || radius < 0.5, "radius {radius}");
                for kernel in Kernel::available() {
                    let differing =
                        draw(&scene, &frame, kernel).iter().zip(&expected).filter(|(a, b)| a != b).count();
                    assert_eq!(differing, 0, "{kernel}, {solver}, radius {radius}");
                }
            }
        }
    }
}

#[test]
fn from_inside_a_closed_surface_every_pixel_of_every_view_is_a_hit() {
    // Closed, with dents; the eye is in the middle of it.
    let dented = |spacing: [f64; 3]| {
        let mut volume = InMemory::new([31, 27, 35], |at| {
            let [x, y, z] = [0, 1, 2].map(|axis| at[axis] as f64 - [15.2, 13.1, 17.4][axis]);
            let ripple = (1.3 * x).sin() * (0.9 * y).cos() + (1.1 * z).sin();
            single(100.0 - (x * x + y * y + z * z) + 12.0 * ripple)
        });
        volume.shape = volume.shape.with_spacing(spacing).expect("spacing");
        volume
    };
    let mut pixels = 0;
    for (spacing, stored) in [([1.0; 3], None), ([1.0; 3], Some(StoredType::U8)), ([0.01, 1.0, 10.0], None)] {
        let image = dented(spacing).image(stored, 4096);
        let scene = view(&image);
        for (direction, solver) in (0..24).zip(Solver::ALL.into_iter().cycle()) {
            let place = OrbitPlace {
                radius: 1.0,
                elevation: f64::from(direction % 7) * 29.0 - 87.0,
                frame: direction,
                frames: 24,
            };
            let frame =
                Frame::on_orbit(&Orbit::around(&scene.header().view), &place, 70, 70).expect("a frame");
            let surfaces = [Isosurface { value: 0.5, albedo: 0.8 }];
            let mut frame = frame.with_isosurfaces(&surfaces, solver).expect("a frame");
            // The orbit is round, and the volume may be flat.
            frame.camera.eye = (scene.header().view.low + scene.header().view.high) * 0.5;
            for kernel in Kernel::available() {
                let tiles = Tiles::of(frame.width, frame.height);
                for tile in tiles.ids().filter_map(|id| tiles.get(id)) {
                    let mut drawn = vec![0; tile.pixels()];
                    let counts = render_tile(&scene, &frame, tile, kernel, &mut drawn, &mut ());
                    assert_eq!(counts.hits, counts.primary, "{kernel}, {solver}, {place:?}, {tile:?}");
                    pixels += counts.hits;
                }
            }
        }
    }
    assert!(pixels > 300_000, "{pixels}");
}

#[test]
fn of_a_mesh_and_a_volume_the_nearer_is_seen_and_each_shades_the_other() {
    let mesh = builtin::knot(3000);
    let built = build(mesh.clone(), &BuildOptions::default(), &|_| {}).expect("builds");
    let mut ball =
        InMemory::new([41; 3], |at| 150.0 - at.map(|i| (i as f32 - 20.0).powi(2)).iter().sum::<f32>());
    ball.shape = ball.shape.with_spacing([0.2; 3]).and_then(|s| s.with_origin([-4.0; 3])).expect("a shape");
    let mut out = Cursor::new(Vec::new());
    write_volume(&mut ball, Some(&built), None, 4096, &mut out, &|_| {}).expect("written");
    let image = out.into_inner();
    let both = view(&image);
    assert_eq!(both.header().needs, SceneNeeds::TRIANGLES.with(SceneNeeds::VOLUME));
    let (mesh_image, ball_image) = (built.to_bytes(4096).expect("fits"), ball.image(None, 4096));
    let (mesh_only, ball_only) = (view(&mesh_image), view(&ball_image));
    let surfaces = [Isosurface { value: 0.0, albedo: 0.5 }];
    let frame = frame(&both.header().view, 0.8, &surfaces, Solver::default());
    let frame = Frame { flags: Frame::NO_SHADOWS, ..frame };
    let [both_drawn, mesh_drawn, ball_drawn] =
        [&both, &mesh_only, &ball_only].map(|scene| draw(scene, &frame, Kernel::Rays(Lanes::PORTABLE)));
    let mut seen = [0; 3];
    for ((both, mesh), ball) in both_drawn.iter().zip(&mesh_drawn).zip(&ball_drawn) {
        // Each pixel is that of one of the two.
        assert!(both == mesh || both == ball, "{both} {mesh} {ball}");
        seen[0] += u32::from(both == mesh && both != ball);
        seen[1] += u32::from(both == ball && both != mesh);
    }
    assert!(seen[0] > 300 && seen[1] > 300, "{seen:?}");
    let with_shadows = Frame { flags: 0, ..frame };
    let shaded = draw(&both, &with_shadows, Kernel::Rays(Lanes::PORTABLE));
    let darker = |alone: &SceneView<Flat<'_>>, drawn: &[u8]| {
        let alone = draw(alone, &with_shadows, Kernel::Rays(Lanes::PORTABLE));
        let same_surface = shaded.iter().zip(&both_drawn).zip(drawn).zip(&alone);
        same_surface.filter(|(((shaded, both), own), alone)| both == own && shaded < alone).count()
    };
    assert!(darker(&mesh_only, &mesh_drawn) > 10 && darker(&ball_only, &ball_drawn) > 10);
    let hit =
        both.nearest(&Ray { origin: Vec3::new(3.0, 0.1, 9.0), direction: Vec3::NEG_Z, t_max: 99.0 }, &mut ());
    assert!(hit.expect("sound").is_some(), "triangles are found as ever");
}
