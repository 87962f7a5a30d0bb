//! Spheres, alone and among triangles: the grid against brute force, bit for bit, and the test itself against
//! arithmetic of twice the precision.

use crate::common::models::{image_of, models};
use crate::common::{Dice, agree, single};
use glam::Vec3;
use proptest::prelude::*;
use rt_core::scale::{Scale, exponent_of};
use rt_core::sphere::{Sphere, SphereRay};
use rt_core::triangle_f64::F64Ray;
use rt_core::{Flat, GeometryId, Hit, Packet16, Ray, SceneNeeds, SceneView, WorkCounts};
use scene::{Mesh, Model, builtin};

/// Rays of all the kinds that have gone wrong, at a sphere or past it.
fn ray_at(sphere: &Sphere, diagonal: f32, dice: &mut Dice) -> Ray {
    let outwards = dice.direction();
    let aim = match dice.below(6) {
        0 => sphere.centre,
        1 => sphere.centre + outwards * sphere.radius,
        // Touches, or nearly.
        2 => sphere.centre + outwards.any_orthonormal_vector() * sphere.radius,
        3 => sphere.centre + outwards.any_orthonormal_vector() * sphere.radius * (1.0 + dice.unit() * 1.0e-5),
        4 => sphere.centre + Vec3::X * sphere.radius,
        _ => sphere.centre + dice.point() * diagonal,
    };
    let distances = [0.0, sphere.radius * 0.5, sphere.radius, sphere.radius * 3.0, diagonal, 30.0 * diagonal];
    let far = [1.0e3, 1.0e5, 1.0e7, 1.0e12].map(|times| times * diagonal);
    let distance = [&distances[..], &far].concat()[dice.below(10)];
    let mut direction = outwards;
    match dice.below(8) {
        0 => {
            direction = Vec3::ZERO;
            direction[dice.below(3)] = if dice.unit() < 0.5 { 1.0 } else { -1.0 };
        }
        1 => direction[dice.below(3)] = [0.0, -0.0, 1.0e-30, -1.0e-20, 1.0e-10][dice.below(5)],
        2 => direction *= [1.0e-18, 1.0e18, 7.0][dice.below(3)],
        _ => {}
    }
    let unit = direction / direction.abs().max_element();
    let t_max = if dice.below(4) == 0 { dice.unit() * 2.0 } else { f32::INFINITY };
    Ray { origin: aim - unit * distance, direction, t_max }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 600, max_shrink_iters: 2000, ..ProptestConfig::default() })]

    #[test]
    fn the_grid_finds_what_testing_everything_finds(
        model in models(),
        seed in any::<u64>(),
        slack in prop_oneof![Just(0.0_f32), Just(0.5), Just(1.0), Just(3.0)],
        page_bytes in prop_oneof![Just(4096_u32), Just(16_384)],
    ) {
        let image = image_of(&model, slack, page_bytes);
        let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
        let bounds = scene.header().bounds;
        let mut dice = Dice(seed);
        for _ in 0..60 {
            let sphere = model.spheres[dice.below(model.spheres.len())];
            agree(&scene, &ray_at(&sphere, (bounds.high - bounds.low).max_element(), &mut dice));
        }
    }
}

#[test]
fn many_rays_through_a_sphereflake_agree() {
    for (depth, slack) in [(3, 0.5), (3, 0.0), (4, 0.5), (0, 0.5)] {
        let model = builtin::sphereflake(depth);
        let image = image_of(&model, slack, 4096);
        let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
        assert_eq!(scene.header().needs, SceneNeeds::TRIANGLES.with(SceneNeeds::SPHERES));
        let mut dice = Dice(7);
        let mut hits = [0; 2];
        for _ in 0..2000 {
            let origin = dice.point() * 4.0 + Vec3::Y * 2.0;
            let ray = Ray { origin, direction: dice.point() * 1.5 - origin, t_max: f32::INFINITY };
            if let Some(hit) = agree(&scene, &ray) {
                hits[usize::from(scene.original_id(hit.primitive).expect("an id") >= 2)] += 1;
            }
        }
        assert!(hits.iter().all(|&hits| hits > 200), "triangles and spheres hit: {hits:?}");
    }
}

#[test]
fn filters_packets_and_triangle_tests_know_both_kinds() {
    let model = builtin::sphereflake(2);
    let alone = |model: Model| image_of(&model, 0.5, 4096);
    let images =
        [alone(model.clone()), alone(model.mesh.clone().into()), alone(model.spheres.clone().into())];
    let [both, ground, flake] =
        images.each_ref().map(|image| SceneView::new(Flat::new(image)).expect("a valid image"));
    let t = |hit: Result<Option<Hit>, _>| hit.expect("sound").map(|hit| hit.t);
    let mut dice = Dice(11);
    let mut hits = [0, 0];
    for _ in 0..2000 {
        let sphere = model.spheres[dice.below(model.spheres.len())];
        let ray = ray_at(&sphere, 4.0, &mut dice);
        let hit = agree(&both, &ray);
        let of = |wanted: GeometryId| move |hit: &Hit| both.geometry_id(hit.primitive) == Some(wanted);
        let only = |wanted| both.nearest_filtered(&ray, of(wanted), &mut ());
        // The scales of the images differ by powers of two, which are exact.
        assert_eq!(t(only(GeometryId::TRIANGLES)), t(ground.nearest(&ray, &mut ())));
        assert_eq!(t(only(GeometryId::SPHERES)), t(flake.nearest(&ray, &mut ())));
        let any_sphere = both.any_filtered(&ray, of(GeometryId::SPHERES), &mut ());
        assert_eq!(any_sphere, flake.any(&ray, &mut ()));
        let by_double = both.nearest_by::<F64Ray, _>(&ray, &mut ());
        assert_eq!(both.any_by::<F64Ray, _>(&ray, &mut ()), Ok(by_double.expect("sound").is_some()));
        assert_eq!(flake.nearest_by::<F64Ray, _>(&ray, &mut ()), flake.nearest(&ray, &mut ()));
        let (packet, active) = Packet16::pack(&[ray; 3]);
        assert_eq!(both.nearest16(&packet, active, &mut ()).expect("sound").hit(2), hit);
        if let Some(hit) = hit {
            hits[usize::from(of(GeometryId::SPHERES)(&hit))] += 1;
        }
    }
    assert!(hits.iter().all(|&hits| hits > 100), "triangles and spheres hit: {hits:?}");
}

#[test]
fn a_cell_inside_a_sphere_does_not_know_of_it() {
    let mut dice = Dice(4);
    let small = |dice: &mut Dice| Sphere { centre: dice.point() * 0.4, radius: 0.01 };
    let mut spheres: Vec<Sphere> = (0..4000).map(|_| small(&mut dice)).collect();
    spheres.push(Sphere { centre: Vec3::ZERO, radius: 2.0 });
    let image = image_of(&spheres.into(), 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    let mut work = WorkCounts::default();
    // Short rays among the small ones never come near the shell.
    for _ in 0..1000 {
        let ray = Ray { origin: dice.point() * 0.4, direction: dice.direction(), t_max: 0.05 };
        agree(&scene, &ray);
        scene.nearest(&ray, &mut work).expect("a sound image");
    }
    assert!(work.spheres < 1000 * 100, "{work:?}");
    assert_eq!(work.triangles, 0);
    let out = Ray { origin: Vec3::new(0.5, 0.5, 0.5), direction: Vec3::ONE, t_max: f32::INFINITY };
    let hit = agree(&scene, &out).expect("nothing gets out of the shell");
    assert_eq!(scene.original_id(hit.primitive), Some(4000));
    assert!(
        (hit.normal - Vec3::splat(single(1.0 / 3.0_f64.sqrt()))).abs().max_element() < 1.0e-6,
        "outwards: {}",
        hit.normal
    );
}

#[test]
fn where_a_sphere_touches_a_triangle_the_triangle_is_hit() {
    let floor = Mesh {
        positions: vec![[-4.0, -4.0, 0.0], [4.0, -4.0, 0.0], [0.0, 4.0, 0.0]],
        triangles: vec![[0, 1, 2]],
    };
    // Two concentric spheres are no tie; two that touch in the same point are.
    let spheres = [0.5, 1.0].map(|radius| Sphere { centre: Vec3::new(0.0, 0.0, -radius), radius }).to_vec();
    let down = Ray { origin: Vec3::Z, direction: Vec3::NEG_Z, t_max: f32::INFINITY };
    for slack in [0.0, 0.5] {
        let id = |model: Model| {
            let image = image_of(&model, slack, 4096);
            let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
            let hit = agree(&scene, &down).expect("in the way");
            assert_eq!((hit.t, hit.normal), (1.0, Vec3::Z));
            scene.original_id(hit.primitive).expect("an id")
        };
        assert_eq!(id(Model { mesh: floor.clone(), spheres: spheres.clone(), view: None }), 0);
        assert_eq!(id(spheres.clone().into()), 1, "the larger one's centre is lower");
        assert_eq!(id(spheres.iter().rev().copied().collect::<Vec<_>>().into()), 0);
    }
}

#[test]
fn equal_spheres_are_kept_once_and_specks_not_at_all() {
    let ball = Sphere { centre: Vec3::new(1.0, 2.0, 3.0), radius: 0.5 };
    let mut spheres = vec![ball; 100_000];
    spheres.push(Sphere { radius: 0.0, ..ball });
    spheres.push(Sphere { centre: Vec3::new(-0.0, 2.0, 3.0), radius: 0.25 });
    spheres.push(Sphere { centre: Vec3::new(0.0, 2.0, 3.0), radius: 0.25 });
    let image = image_of(&spheres.into(), 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    let header = scene.header();
    assert_eq!((header.spheres, header.repeated, header.collapsed), (100_003, 100_000, 1));
    assert_eq!((header.primitives, header.needs), (2, SceneNeeds::SPHERES));
    let ray = Ray { origin: Vec3::new(1.0, 2.0, 9.0), direction: Vec3::NEG_Z, t_max: f32::INFINITY };
    let hit = agree(&scene, &ray).expect("in the middle of them");
    assert_eq!((hit.t, hit.u, hit.v, scene.original_id(hit.primitive)), (5.5, 0.0, 0.0, Some(0)));
}

#[test]
fn the_test_is_right_to_double_precision() {
    let mut dice = Dice(31);
    let (mut hits, mut inside) = (0, 0);
    for round in 0..200_000 {
        let sphere = Sphere {
            centre: dice.point(),
            radius: [1.0e-18, 1.0e-9, 1.0e-4, 0.1, 1.0, 2.0][round % 6] * (0.5 + dice.unit()),
        };
        let ray = ray_at(&sphere, 1.0, &mut dice);
        // As the grid prepares it: the largest component in 1..2.
        let normalise = Scale::new(-exponent_of(ray.direction.abs().max_element()));
        let direction = normalise.apply_to(ray.direction);
        let ours = SphereRay::new(ray.origin, direction).intersect(&sphere, f32::INFINITY);
        let exact = Exact::new(ray.origin, direction, &sphere);
        // The stated bound, and what rounding `t` to single precision adds.
        let bound = 2.0_f64.powi(-47) * exact.reach;
        match ours {
            None => assert!(
                exact.gap > -bound || exact.last < bound,
                "{ray:?} {sphere:?}: {} inside, up to {}",
                -exact.gap,
                exact.last
            ),
            Some(crossing) => {
                hits += 1;
                assert!(exact.gap < bound, "{ray:?} {sphere:?}: passes at {}", exact.gap);
                let t = f64::from(crossing.t);
                let rounding = exact.length * t * 2.0_f64.powi(-24);
                let off = exact.off_surface(t).abs();
                assert!(
                    off <= bound + rounding,
                    "{ray:?} {sphere:?}: {off:e} off the surface, {bound:e} {rounding:e}"
                );
                // From inside, the far side.
                if exact.starts_inside && exact.depth > bound {
                    inside += 1;
                    assert!(t * exact.length >= exact.depth * 0.999_999, "{ray:?} {sphere:?}: {t}");
                }
            }
        }
    }
    assert!(hits > 20_000 && inside > 2000, "{hits} hits, {inside} from inside");
}

/// A ray and a sphere in double-double arithmetic, some 100 bits.
struct Exact {
    origin_to_centre: [Wide; 3],
    direction: [f64; 3],
    radius: f64,
    /// Length of the direction.
    length: f64,
    /// Largest length in play.
    reach: f64,
    /// Distance of the line from the surface; negative where it pierces the sphere.
    gap: f64,
    /// Where the line leaves the sphere, as a length.
    last: f64,
    /// How deep inside the sphere the origin is.
    depth: f64,
    starts_inside: bool,
}

impl Exact {
    fn new(origin: Vec3, direction: Vec3, sphere: &Sphere) -> Self {
        let double = |v: Vec3| v.to_array().map(f64::from);
        let (o, c, d) = (double(origin), double(sphere.centre), double(direction));
        let f = [0, 1, 2].map(|axis| Wide::sum(c[axis], -o[axis]));
        let radius = f64::from(sphere.radius);
        let dd = dot(d.map(Wide::from), d.map(Wide::from));
        let fd = dot(f, d.map(Wide::from));
        let ff = dot(f, f);
        // Squared distance of the line from the centre, times dd.
        let across = ff.times(dd).plus(fd.times(fd).negated());
        let length = dd.0.sqrt();
        let distance = (across.0.max(0.0)).sqrt() / length;
        // r - distance cancels where the line touches: from the difference of squares instead.
        let under = Wide::product(radius, radius).times(dd).plus(across.negated());
        let gap = -under.0 / dd.0 / (radius + distance).max(f64::MIN_POSITIVE);
        let half = (under.0.max(0.0)).sqrt();
        let depth = Wide::product(radius, radius).plus(ff.negated()).0 / (radius + ff.0.sqrt());
        Self {
            origin_to_centre: f,
            direction: d,
            radius,
            length,
            reach: f.iter().fold(radius, |reach, component| reach.max(component.0.abs())),
            gap,
            last: (fd.0 + half) / length,
            depth: depth.abs(),
            starts_inside: depth > 0.0,
        }
    }

    /// How far the point at `t` is off the surface.
    fn off_surface(&self, t: f64) -> f64 {
        let from_centre =
            [0, 1, 2].map(|i| Wide::product(t, self.direction[i]).plus(self.origin_to_centre[i].negated()));
        let squared = dot(from_centre, from_centre);
        let excess = squared.plus(Wide::product(self.radius, self.radius).negated());
        excess.0 / (squared.0.sqrt() + self.radius)
    }
}

/// A number in two parts; the second is what the first rounds off.
#[derive(Clone, Copy)]
struct Wide(f64, f64);

impl Wide {
    const fn from(value: f64) -> Self {
        Self(value, 0.0)
    }

    /// Knuth, The Art of Computer Programming 2, 4.2.2, theorem B: exact.
    fn sum(a: f64, b: f64) -> Self {
        let sum = a + b;
        let of_b = sum - a;
        Self(sum, (a - (sum - of_b)) + (b - of_b))
    }

    fn product(a: f64, b: f64) -> Self {
        let product = a * b;
        Self(product, a.mul_add(b, -product))
    }

    fn plus(self, other: Self) -> Self {
        let sum = Self::sum(self.0, other.0);
        let low = Self::sum(self.1, other.1);
        let carried = Self::sum(sum.0, sum.1 + low.0);
        Self::sum(carried.0, carried.1 + low.1)
    }

    fn times(self, other: Self) -> Self {
        let product = Self::product(self.0, other.0);
        Self::sum(product.0, product.1 + (self.0 * other.1 + self.1 * other.0))
    }

    fn negated(self) -> Self {
        Self(-self.0, -self.1)
    }
}

fn dot(a: [Wide; 3], b: [Wide; 3]) -> Wide {
    a[0].times(b[0]).plus(a[1].times(b[1])).plus(a[2].times(b[2]))
}
