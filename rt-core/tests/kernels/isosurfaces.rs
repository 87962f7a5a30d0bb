//! Isosurfaces against the reference in double precision, in ordinary and in stiff cases.

use core::cell::Cell;

use crate::common::volume::{InMemory, view};
use crate::common::{Dice, single};
use glam::Vec3;
use rt_core::isosurface_f64::Crossing;
use rt_core::volume::VALUE_MAX;
use rt_core::{Flat, IsoHit, Ray, SceneMemory, SceneView, Solver, WorkCounts};
use scene::volume::StoredType;

/// A ray of the unit lattice: cells are world units.
fn ray(origin: [f32; 3], direction: [f32; 3]) -> Ray {
    Ray { origin: origin.into(), direction: direction.into(), t_max: f32::INFINITY }
}

fn nearest(scene: &SceneView<Flat<'_>>, ray: &Ray, isovalue: f32, solver: Solver) -> Option<IsoHit> {
    let surfaces = scene.isosurfaces(&[isovalue], solver).expect("sound")?;
    let hit = surfaces.nearest(ray, &mut ()).expect("sound");
    assert_eq!(surfaces.any(ray, &mut ()), Ok(hit.is_some()));
    hit
}

fn reference(volume: &InMemory, ray: &Ray, isovalue: f32) -> Option<Crossing> {
    let double = |v: Vec3| v.to_array().map(f64::from);
    volume.reference().first_crossing(double(ray.origin), double(ray.direction), f64::INFINITY, isovalue)
}

/// How kernel and reference may differ on one ray.
#[derive(Debug, Default)]
struct Differences {
    rays: u32,
    hits: u32,
    /// How far apart they may be, in cells.
    tolerance: f64,
    /// One of them hits and the other does not, or they hit farther apart.
    elsewhere: u32,
    /// The same, and it is not that the ray grazes.
    wrong: u32,
    /// Largest distance of the others, in cells.
    largest: f64,
}

impl Differences {
    fn compare(&mut self, volume: &InMemory, ray: &Ray, isovalue: f32, found: Option<IsoHit>) {
        self.rays += 1;
        let expected = reference(volume, ray, isovalue);
        self.hits += u32::from(expected.is_some());
        let length = f64::from(ray.direction.length());
        let distance = match (&found, &expected) {
            (None, None) => 0.0,
            (Some(found), Some(expected)) => (f64::from(found.t) - expected.t).abs() * length,
            _ => f64::INFINITY,
        };
        if distance > self.tolerance {
            self.elsewhere += 1;
            self.wrong += u32::from(!is_shifted(volume, ray, isovalue, found, self.tolerance));
        } else {
            self.largest = self.largest.max(distance);
        }
    }
}

/// Whether a ray shifted by a ten-thousandth of a cell at most meets what was found: then the ray grazes a surface, or
/// passes through samples, and a value's last digit decides.
fn is_shifted(volume: &InMemory, ray: &Ray, isovalue: f32, found: Option<IsoHit>, tolerance: f64) -> bool {
    let direction = ray.direction.to_array().map(f64::from);
    let length = f64::from(ray.direction.length());
    let meets = |shift: [f64; 3]| {
        let origin = [0, 1, 2].map(|axis| f64::from(ray.origin[axis]) + shift[axis]);
        let crossing = volume.reference().first_crossing(origin, direction, f64::INFINITY, isovalue);
        match (&found, crossing) {
            (None, None) => true,
            (Some(hit), Some(crossing)) => (f64::from(hit.t) - crossing.t).abs() * length < tolerance,
            _ => false,
        }
    };
    let shifts = |by: f64| (0..27).map(move |i| [i % 3, i / 3 % 3, i / 9].map(|k| by * (f64::from(k) - 1.0)));
    [1.0e-8, 1.0e-7, 1.0e-6, 1.0e-5, 1.0e-4].into_iter().flat_map(shifts).any(meets)
}

/// Rays from all around and from inside, some of them along axes, diagonals, faces and edges of cells.
fn rays(dims: [usize; 3], count: usize, seed: u64) -> Vec<Ray> {
    let mut dice = Dice(seed);
    let size = Vec3::from(dims.map(|count| (count - 1) as f32));
    (0..count)
        .map(|i| {
            let target = (dice.point() * 0.5 + 0.5) * size;
            let mut origin = (dice.point() * 1.5 + 0.5) * size;
            let mut direction = target - origin;
            match i % 8 {
                // Along an axis, in a face or along an edge.
                0 | 1 => {
                    let axis = dice.below(3);
                    origin = if i % 8 == 0 { target } else { target.floor() };
                    origin[axis] = -1.5;
                    direction = Vec3::ZERO;
                    direction[axis] = 1.0;
                }
                // Through lattice points, along diagonals.
                2 => {
                    direction = Vec3::from([0, 1, 2].map(|_| if dice.below(2) == 0 { 1.0 } else { -1.0 }));
                    origin = target.round() - direction * 64.0;
                }
                3 => direction = target.round() - origin,
                4 => origin = origin.round(),
                _ => {}
            }
            Ray { origin, direction, t_max: f32::INFINITY }
        })
        .filter(|ray| ray.direction != Vec3::ZERO)
        .collect()
}

/// Compares a volume's isosurface with the reference, and returns how they differ.
fn differences(volume: &mut InMemory, isovalue: f32, solver: Solver, count: usize) -> Differences {
    let image = volume.image(None, 4096);
    let scene = view(&image);
    let tolerance = if matches!(solver, Solver::MarmittNewton | Solver::Bisect) { 0.01 } else { 0.3 };
    let mut differences = Differences { tolerance, ..Differences::default() };
    let dims = volume.reference().dims;
    for ray in rays(dims, count, 3) {
        differences.compare(volume, &ray, isovalue, nearest(&scene, &ray, isovalue, solver));
    }
    differences
}

/// A smooth volume with a surface that is closed.
fn blobs(n: usize) -> InMemory {
    InMemory::new([n; 3], |at| {
        let [x, y, z] = at.map(|i| -1.0 + 2.0 * i as f64 / (n - 1) as f64);
        let wave = (7.0 * x).sin() * (6.0 * y).cos() + (5.0 * z).sin() * (8.0 * x).cos() * 0.5;
        single(wave + 0.6 - 3.0 * (x * x + y * y + z * z))
    })
}

/// Every sample any number: a surface in almost every cell, with two and three roots in many.
fn noise(n: usize, seed: u64) -> InMemory {
    let dice = Cell::new(seed);
    InMemory::new([n; 3], |_| {
        let mut next = Dice(dice.get());
        let value = next.unit() * 2.0 - 1.0;
        dice.set(next.0);
        value
    })
}

#[test]
fn smooth_surfaces_are_where_the_reference_has_them() {
    for (solver, largest) in
        [(Solver::MarmittNewton, 2.0e-4), (Solver::Bisect, 2.0e-4), (Solver::Marmitt, 0.15)]
    {
        let found = differences(&mut blobs(40), 0.0, solver, 8000);
        assert!(found.hits > 2000, "{found:?}");
        assert!(found.elsewhere <= 8 && found.wrong == 0, "{solver}: {found:?}");
        assert!(found.largest < largest, "{solver}: {found:?}");
    }
}

#[test]
fn noise_with_many_roots_in_a_cell_is_where_the_reference_has_it() {
    for seed in [1, 2, 3] {
        let found = differences(&mut noise(20, seed), 0.1, Solver::MarmittNewton, 4000);
        assert!(found.hits > 3500, "{found:?}");
        assert!(found.wrong == 0 && found.elsewhere <= 8, "{found:?}");
        let bisected = differences(&mut noise(20, seed), 0.1, Solver::Bisect, 4000);
        assert!(bisected.wrong == 0 && bisected.elsewhere <= 4, "{bisected:?}");
    }
}

#[test]
fn solvers_that_do_not_isolate_miss_some_surfaces_and_those_that_do_none() {
    let plain = differences(&mut noise(20, 5), 0.0, Solver::Linear, 4000);
    assert!(plain.wrong > 20, "the case is there: {plain:?}");
    let isolated = differences(&mut noise(20, 5), 0.0, Solver::Marmitt, 4000);
    assert!(isolated.wrong * 20 < plain.wrong, "{isolated:?}, {plain:?}");
}

#[test]
fn isovalues_equal_to_samples_constant_cells_and_plateaus() {
    // Whole numbers from 0 to 3: every fourth sample is the isovalue, with plateaus of it.
    let mut steps = InMemory::new([24; 3], |[x, y, z]| ((x / 3 + y / 2 * 2 + z / 4) % 4) as f32);
    for isovalue in [1.0, 2.0, 3.0, 1.5] {
        for stored in [Some(StoredType::F32), None] {
            steps.shape.sample =
                if stored.is_none() { scene::volume::SampleType::U8 } else { steps.shape.sample };
            let found = differences(&mut steps, isovalue, Solver::MarmittNewton, 4000);
            assert!(found.hits > 2500 && found.wrong == 0, "{isovalue}: {found:?}");
        }
    }
    let mut constant = InMemory::new([24; 3], |_| 7.0);
    let image = constant.image(None, 4096);
    assert_eq!(view(&image).header().volume.expect("a volume").bricks, 0);
    assert_eq!(differences(&mut constant, 7.0, Solver::MarmittNewton, 200).hits, 0);
}

#[test]
fn a_surface_that_touches_the_isovalue_shows_from_where_it_is_reached() {
    // 1 - |x - 8|: reaches 1 in the plane x = 8 alone.
    let mut ridge = InMemory::new([17, 9, 9], |[x, ..]| 1.0 - (x as f32 - 8.0).abs());
    let image = ridge.image(None, 4096);
    let hit = nearest(&view(&image), &ray([-3.0, 4.3, 4.1], [1.0, 0.0, 0.0]), 1.0, Solver::MarmittNewton);
    assert_eq!(hit.map(|hit| hit.t), Some(11.0), "from below it is reached");
    let mut valley = InMemory::new([17, 9, 9], |[x, ..]| 1.0 + (x as f32 - 8.0).abs());
    let image = valley.image(None, 4096);
    let hit = nearest(&view(&image), &ray([-3.0, 4.3, 4.1], [1.0, 0.0, 0.0]), 1.0, Solver::MarmittNewton);
    assert_eq!(hit, None, "from above it is not left");
}

#[test]
fn tangent_rays_of_a_sphere_differ_by_the_rounding_of_the_tangent_point_alone() {
    let n = 33;
    let mut ball =
        InMemory::new([n; 3], |at| 100.0 - at.map(|i| (i as f32 - 16.0).powi(2)).iter().sum::<f32>());
    let image = ball.image(None, 4096);
    let scene = view(&image);
    let mut found = Differences { tolerance: 0.01, ..Differences::default() };
    let mut dice = Dice(9);
    for _ in 0..4000 {
        // Along x, a hair inside and outside of where the trilinear surface ends.
        let angle = dice.unit();
        let [sin, cos] = crate::common::on_circle(f64::from(angle));
        let radius = 10.0 - 0.02 + 0.03 * dice.unit();
        let ray = ray([-5.0, 16.0 + radius * sin, 16.0 + radius * cos], [1.0, 1.0e-3 * cos, -1.0e-3 * sin]);
        found.compare(&ball, &ray, 0.0, nearest(&scene, &ray, 0.0, Solver::MarmittNewton));
    }
    assert!(found.hits > 500 && found.hits < 3500, "{found:?}");
    assert!(found.wrong == 0 && found.elsewhere * 50 < found.rays, "{found:?}");
}

#[test]
fn samples_of_1e_minus_30_and_1e30_side_by_side() {
    let sizes = [1.0e-30, 1.0e30, 1.0, 1.0e-10, 1.0e10];
    let mut wild = InMemory::new([20; 3], |[x, y, z]| {
        let size = sizes[(x * 7 + y * 3 + z * 11) % 5];
        if (x + y / 2 + z * z) % 3 == 0 { -size } else { size }
    });
    for isovalue in [0.0, 1.0e-30, -1.0, 1.0e20] {
        let found = differences(&mut wild, isovalue, Solver::MarmittNewton, 4000);
        assert!(found.hits > 1000 && found.wrong == 0, "{isovalue}: {found:?}");
        assert!(found.elsewhere * 20 < found.rays, "{isovalue}: {found:?}");
    }
}

#[test]
fn cells_with_absent_samples_show_nothing_and_their_neighbours_do() {
    let odd = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -f32::MAX];
    let mut volume = InMemory::new([24; 3], |[x, y, z]| {
        let hash = x * 131 + y * 31 + z * 17;
        if hash % 23 == 0 { odd[hash / 23 % 5] } else { (x as f32 - 11.3) + 0.2 * ((y + z) % 3) as f32 }
    });
    let found = differences(&mut volume, 0.0, Solver::MarmittNewton, 8000);
    assert!(found.hits > 2000 && found.wrong == 0, "{found:?}");
    let mut nothing = InMemory::new([9; 3], |_| f32::NAN);
    let image = nothing.image(None, 4096);
    assert_eq!(view(&image).header().volume.expect("a volume").bricks, 0);
    const { assert!(VALUE_MAX < f32::MAX) };
}

#[test]
fn volumes_without_cells_are_empty_and_thin_ones_are_not() {
    for dims in [[1, 1, 300], [1, 1, 1], [40, 1, 40]] {
        let mut line = InMemory::new(dims, |[x, y, z]| (x + y + z) as f32);
        let image = line.image(None, 4096);
        let scene = view(&image);
        assert_eq!(scene.header().volume.map(|volume| volume.bricks), Some(0), "{dims:?}");
        assert_eq!(
            nearest(&scene, &ray([0.0, 0.0, -1.0], [0.0, 0.0, 1.0]), 5.5, Solver::MarmittNewton),
            None
        );
    }
    let mut thin = InMemory::new([2, 2, 300], |[.., z]| z as f32);
    let found = differences(&mut thin, 150.25, Solver::MarmittNewton, 2000);
    assert!(found.hits > 300 && found.wrong == 0 && found.largest < 1.0e-4, "{found:?}");
}

#[test]
fn spacings_of_1000_to_1_and_far_origins() {
    let mut volume = blobs(24);
    let (spacing, origin) = ([1.0, 1.0 / 1024.0, 0.03125], [-3.0, 512.0, 0.125]);
    volume.shape =
        volume.shape.with_spacing(spacing).and_then(|shape| shape.with_origin(origin)).expect("a shape");
    let image = volume.image(None, 4096);
    let scene = view(&image);
    let world = |at: Vec3, from: [f64; 3]| {
        Vec3::from([0, 1, 2].map(|axis| single(f64::from(at[axis]) * spacing[axis] + from[axis])))
    };
    let in_cells =
        |at: Vec3, from: [f64; 3]| [0, 1, 2].map(|axis| (f64::from(at[axis]) - from[axis]) / spacing[axis]);
    let (mut hits, mut elsewhere) = (0, 0);
    for ray in rays([24; 3], 3000, 8) {
        let stretched =
            Ray { origin: world(ray.origin, origin), direction: world(ray.direction, [0.0; 3]), ..ray };
        let found = nearest(&scene, &stretched, 0.0, Solver::MarmittNewton);
        // The ray as it was rounded, where cells are cubes.
        let from = in_cells(stretched.origin, origin);
        let along = in_cells(stretched.direction, [0.0; 3]);
        let expected = volume.reference().first_crossing(from, along, f64::INFINITY, 0.0);
        hits += u32::from(expected.is_some());
        let length = along.iter().map(|x| x * x).sum::<f64>().sqrt();
        let distance = match (expected, found) {
            (None, None) => 0.0,
            (Some(expected), Some(found)) => (expected.t - f64::from(found.t)).abs() * length,
            _ => f64::INFINITY,
        };
        elsewhere += u32::from(distance > 0.01);
    }
    // Grazing rays, for which a value's last digit decides.
    assert!(hits > 800 && elsewhere * 200 < hits, "{elsewhere} of {hits}");
}

/// Memory that counts records.
struct Counting<'a>(Flat<'a>, Cell<u32>);

impl SceneMemory for Counting<'_> {
    type Record<'b>
        = &'b [u8]
    where
        Self: 'b;

    fn record(&self, offset: u64, length: usize) -> Option<&[u8]> {
        self.1.set(self.1.get() + 1);
        self.0.record(offset, length)
    }

    fn length(&self) -> u64 {
        self.0.length()
    }
}

#[test]
fn isovalues_outside_the_range_read_nothing_but_the_header() {
    let image = blobs(24).image(None, 4096);
    let memory = Counting(Flat::new(&image), Cell::new(0));
    let scene = SceneView::new(memory).expect("sound");
    let volume = scene.header().volume.expect("a volume");
    let after_header = scene.memory().1.get();
    for isovalue in [volume.low, volume.low - 1.0, volume.high + 1.0, f32::NAN, f32::INFINITY] {
        let surfaces = scene.isosurfaces(&[isovalue], Solver::default()).expect("sound");
        assert!(surfaces.is_none(), "{isovalue}");
    }
    assert_eq!(scene.memory().1.get(), after_header);
    assert!(scene.isosurfaces(&[volume.high], Solver::default()).expect("sound").is_some());
    assert!(scene.memory().1.get() > after_header);
}

#[test]
fn a_closed_surface_has_no_hole_from_outside_or_inside() {
    let mut volume = blobs(40);
    let image = volume.image(None, 4096);
    let scene = view(&image);
    let surfaces = scene.isosurfaces(&[0.0], Solver::Linear).expect("sound").expect("a surface");
    let inside: Vec<usize> = (0..volume.samples.len()).filter(|&i| volume.samples[i] > 0.0).collect();
    assert!(inside.len() > 1000);
    let mut dice = Dice(77);
    let mut leaks = 0;
    for i in 0..60_000 {
        let sample = inside[dice.below(inside.len())];
        let origin = Vec3::from([sample % 40, sample / 40 % 40, sample / 1600].map(|i| i as f32));
        let direction = match i % 4 {
            // Along edges and diagonals of cells, through nothing but lattice points.
            0 => Vec3::from([0, 1, 2].map(|_| dice.below(3) as f32 - 1.0)),
            1 => Vec3::from([0, 1, 2].map(|_| dice.below(11) as f32 - 5.0)),
            _ => dice.point(),
        };
        if direction == Vec3::ZERO {
            continue;
        }
        let outwards = Ray { origin, direction, t_max: f32::INFINITY };
        leaks += u32::from(!surfaces.any(&outwards, &mut ()).expect("sound"));
        // And from far outside to the inside point.
        let origin = origin - direction * 512.0;
        let inwards = Ray { origin, direction, t_max: 512.0 };
        leaks += u32::from(!surfaces.any(&inwards, &mut ()).expect("sound"));
    }
    assert_eq!(leaks, 0, "rays that got through a closed surface");
}

#[test]
fn several_surfaces_are_met_in_order_and_told_apart() {
    let mut ramp = InMemory::new([30; 3], |[x, ..]| x as f32);
    let image = ramp.image(None, 4096);
    let scene = view(&image);
    let surfaces =
        scene.isosurfaces(&[20.5, 100.0, 3.25, 7.75], Solver::default()).expect("sound").expect("some");
    let from_left =
        surfaces.nearest(&ray([-2.0, 5.5, 5.5], [2.0, 0.0, 0.0]), &mut ()).expect("sound").expect("a hit");
    assert_eq!((from_left.t, from_left.surface, from_left.normal), (2.625, 2, Vec3::NEG_X));
    assert_eq!(from_left.cell, [3, 5, 5]);
    let from_right =
        surfaces.nearest(&ray([40.0, 5.5, 5.5], [-1.0, 0.0, 0.0]), &mut ()).expect("sound").expect("a hit");
    assert_eq!((from_right.t, from_right.surface), (19.5, 0));
    // A ray that ends before the surface.
    let short = Ray { t_max: 2.6, ..ray([-2.0, 5.5, 5.5], [2.0, 0.0, 0.0]) };
    assert_eq!(surfaces.nearest(&short, &mut ()), Ok(None));
}

#[test]
fn normals_are_those_of_the_reference() {
    let mut volume = blobs(40);
    let image = volume.image(None, 4096);
    let scene = view(&image);
    let mut compared = 0;
    for ray in rays([40; 3], 4000, 21) {
        let hit = nearest(&scene, &ray, 0.0, Solver::MarmittNewton);
        let (Some(hit), Some(crossing)) = (hit, reference(&volume, &ray, 0.0)) else { continue };
        if (f64::from(hit.t) - crossing.t).abs() * f64::from(ray.direction.length()) < 1.0e-3 {
            let normal = -glam::DVec3::from(crossing.gradient).normalize();
            assert!(normal.dot(hit.normal.as_dvec3()) > 1.0 - 1.0e-5, "{hit:?} {crossing:?}");
            compared += 1;
        }
    }
    assert!(compared > 1000);
}

#[test]
fn storage_page_size_and_cache_do_not_show() {
    let mut volume = InMemory::new([50, 37, 20], |[x, y, z]| ((x * x + y * 7 + z * z * 3) % 200) as f32);
    let images: Vec<Vec<u8>> = [
        (Some(StoredType::F32), 4096),
        (Some(StoredType::F32), 1 << 20),
        (Some(StoredType::U16), 16384),
        (Some(StoredType::U8), 4096),
    ]
    .into_iter()
    .map(|(stored, page)| {
        volume.shape.sample = scene::volume::SampleType::U8;
        volume.image(stored, page)
    })
    .collect();
    let kinds: Vec<_> =
        images.iter().map(|image| view(image).header().volume.map(|v| v.sample.bytes())).collect();
    assert_eq!(kinds, [Some(4), Some(4), Some(2), Some(1)]);
    for ray in rays([50, 37, 20], 1000, 4) {
        let expected = nearest(&view(&images[0]), &ray, 77.5, Solver::MarmittNewton);
        for image in &images[1..] {
            assert_eq!(nearest(&view(image), &ray, 77.5, Solver::MarmittNewton), expected);
        }
    }
}

#[test]
fn a_ray_reads_few_bricks_and_empty_space_none() {
    let mut ball = InMemory::new([120; 3], |at| {
        let r2 = at.map(|i| (i as f32 - 60.0).powi(2)).iter().sum::<f32>();
        if r2 < 400.0 { 400.0 - r2 } else { 0.0 }
    });
    let image = ball.image(None, 4096);
    let scene = view(&image);
    let volume = scene.header().volume.expect("a volume");
    assert!(volume.bricks < 17 * 17 * 17 / 10, "{volume:?}");
    let surfaces = scene.isosurfaces(&[1.0], Solver::default()).expect("sound").expect("a surface");
    let mut work = WorkCounts::default();
    let through = surfaces.nearest(&ray([-9.0, 60.2, 60.4], [1.0, 0.0, 0.0]), &mut work).expect("sound");
    assert!(through.is_some() && work.bricks <= 2, "{work:?}");
    let mut work = WorkCounts::default();
    let past = surfaces.nearest(&ray([-9.0, 10.2, 10.4], [1.0, 0.0, 0.0]), &mut work).expect("sound");
    assert!(past.is_none() && work.bricks == 0, "{work:?}");
}
