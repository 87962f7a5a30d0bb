//! No ray passes through a surface at an edge or a vertex.
//!
//! Rays are aimed at random points of interior edges whose two triangles are turned to the eye the same way,
//! and at vertices all of whose triangles are. A ray that has no hit there is judged by exact arithmetic
//! ([`common::pass`]): it is a leak unless the exact ray meets nothing, or meets only what is closer to a
//! silhouette than the rounding of its corners.
//!
//! The meshes of other people need the folder that `MEMSAVVY_DATA` names; their test skips, and says so, when
//! it is not set.

mod common;

use std::fs;
use std::path::{Path, PathBuf};

use common::pass::{Pass, judge};
use common::surface::{Side, Surface};
use common::{Dice, image, on_circle, shapes, single};
use glam::Vec3;
use rt_core::{Flat, Ray, SceneView, brute};
use scene::{Mesh, builtin, read_mesh};

/// A surface under fire.
struct Target {
    name: String,
    surface: Surface,
    size: f32,
    image: Vec<u8>,
    dice: Dice,
    tally: Tally,
}

/// What became of the rays.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    rays: u32,
    /// Rays that the exact ray takes past the surface.
    meet_nothing: u32,
    at_silhouette: u32,
    hit_behind_aim: u32,
}

impl Tally {
    /// Asserts that of a surface with fat triangles nearly every ray was stopped, so that the excuses that
    /// the judge accepts are not what passes the test.
    fn assert_few_excused(&self, name: &str) {
        let excused = self.meet_nothing + self.at_silhouette + self.hit_behind_aim;
        assert!(excused * 100 <= self.rays + 99, "{name}: {self:?}");
    }
}

impl core::ops::AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.rays += other.rays;
        self.meet_nothing += other.meet_nothing;
        self.at_silhouette += other.at_silhouette;
        self.hit_behind_aim += other.hit_behind_aim;
    }
}

impl Target {
    fn new(name: String, surface: Surface, seed: u64) -> Self {
        let image = image(&surface.mesh, 0.5, 4096);
        let name = format!("{name}, seed {seed}");
        Self { name, size: surface.size(), surface, image, dice: Dice(seed), tally: Tally::default() }
    }

    /// Aims rays from eyes in all directions, `distance` sizes away, at what can be seen from there.
    fn shoot_from(&mut self, distance: f32, rays: u32) {
        for _ in 0..rays {
            let aimed_at = self.aim();
            let towards_eye = self.dice.direction();
            let origin = aimed_at.point + towards_eye * (distance * self.size);
            let ray = Ray { origin, direction: aimed_at.point - origin, t_max: f32::INFINITY };
            // A thousandth of the size behind the aim, less than the thickness of anything.
            self.shoot(&aimed_at, &ray, (distance + 1.0e-3) / distance);
        }
    }

    /// Aims parallel rays that start `distance` sizes away, at a surface that has no back.
    fn shoot_along(&mut self, direction: Vec3, distance: f32, rays: u32) {
        for _ in 0..rays {
            let aimed_at = self.aim();
            let origin = aimed_at.point - direction * (distance * self.size);
            self.shoot(&aimed_at, &Ray { origin, direction, t_max: f32::INFINITY }, f32::MAX);
        }
    }

    /// A random point of an edge, or a vertex.
    fn aim(&mut self) -> Aim {
        let triangle = self.dice.below(self.surface.mesh.triangles.len());
        let side = Side { triangle: u32::try_from(triangle).expect("a mesh"), corner: self.dice.below(3) };
        let [a, b] = self.surface.ends(side);
        if self.dice.unit() < 0.25 {
            Aim { point: a, around: self.surface.fan(side) }
        } else {
            let around = self.surface.across(side).map(|across| vec![side.triangle, across]);
            Aim { point: a + (b - a) * self.dice.unit(), around }
        }
    }

    fn shoot(&mut self, Aim { point, around }: &Aim, ray: &Ray, t_of_aim: f32) {
        let Some(around) = around else { return };
        if !self.surface.all_turned_alike(around, ray) {
            return;
        }
        self.tally.rays += 1;
        let scene = SceneView::new(Flat::new(&self.image)).expect("a valid image");
        let hit = scene.nearest(ray, &mut ()).expect("a sound image").map_or(f32::INFINITY, |hit| hit.t);
        if hit <= t_of_aim {
            return;
        }
        match judge(&self.surface, ray, hit) {
            Pass::Leak { triangle, t } => {
                panic!("{}: {ray:?}, aimed at {point}, passes triangle {triangle} at {t}", self.name)
            }
            Pass::MeetsNothing => self.tally.meet_nothing += 1,
            Pass::AtSilhouette => self.tally.at_silhouette += 1,
            Pass::HitBehindAim => self.tally.hit_behind_aim += 1,
        }
    }
}

/// A point of a surface, and the triangles that meet there when the surface goes on in every direction.
struct Aim {
    point: Vec3,
    around: Option<Vec<u32>>,
}

/// Closed meshes with fat triangles, with needles, and with few large ones.
fn closed_shapes() -> Vec<(String, Mesh)> {
    let spindle = |exponent: i32| {
        let mesh = shapes::spindle(10.0_f64.powi(exponent), 24);
        (format!("spindle of aspect 1e{exponent}"), mesh)
    };
    let named = |name: &str, mesh: Mesh| (name.to_owned(), mesh);
    let mut shapes = vec![
        named("sphere", shapes::sphere(20, 30)),
        named("torus", shapes::torus(40, 16)),
        named("cube", shapes::cube()),
        named("knot", builtin::knot(2000)),
    ];
    shapes.extend([1, 3, 6].map(spindle));
    shapes
}

/// Whether the triangles of a shape are wider than the rounding of its corners, by far.
fn is_fat(name: &str) -> bool {
    !name.contains("spindle")
}

#[test]
fn closed_shapes_of_any_size_and_aspect_do_not_leak() {
    let mut all = Tally::default();
    for (name, mesh) in closed_shapes() {
        for scale in SCALES {
            for mesh in [shapes::turned(&mesh, scale), scaled(&mesh, scale)] {
                let surface = Surface::new(&mesh);
                assert_eq!(surface.interior(), 1.0, "{name} is closed");
                let mut target = Target::new(format!("{name} at scale {scale:e}"), surface, 1);
                for distance in [0.4, 2.0, 30.0, 1000.0] {
                    target.shoot_from(distance, 300);
                }
                if is_fat(&name) {
                    target.tally.assert_few_excused(&target.name);
                }
                all += target.tally;
            }
        }
    }
    println!("{all:?}");
    assert!(all.rays > 60_000);
}

#[test]
fn the_front_of_a_closed_shape_does_not_leak_to_rays_from_far_away() {
    let mut all = Tally::default();
    for (name, mesh) in closed_shapes() {
        for scale in SCALES {
            let closed = Surface::new(&shapes::turned(&mesh, scale));
            for direction in DIRECTIONS {
                let full_name = format!("{name} at scale {scale:e} seen along {direction}");
                let mut target = Target::new(full_name, closed.front(direction), 2);
                for distance in [10.0, 1.0e3, 1.0e5, 1.0e7] {
                    target.shoot_along(direction, distance, 60);
                }
                if is_fat(&name) && direction.abs().element_sum() == 1.0 {
                    target.tally.assert_few_excused(&target.name);
                }
                all += target.tally;
            }
        }
    }
    println!("{all:?}");
    assert!(all.rays > 30_000);
}

#[test]
fn a_hole_would_be_called_a_leak() {
    let mut target = Target::new("torus".to_owned(), Surface::new(&shapes::torus(40, 16)), 5);
    let mut leaks = 0;
    for _ in 0..500 {
        let Aim { point, around } = target.aim();
        let origin = point + target.dice.direction() * 3.0;
        let ray = Ray { origin, direction: point - origin, t_max: f32::INFINITY };
        let around = around.expect("a closed shape");
        if target.surface.all_turned_alike(&around, &ray) {
            let pass = judge(&target.surface, &ray, f32::INFINITY);
            leaks += u32::from(matches!(pass, Pass::Leak { .. }));
            assert_ne!(pass, Pass::MeetsNothing);
            assert_ne!(pass, Pass::HitBehindAim);
        }
    }
    assert!(leaks > 200, "{leaks}");
}

#[test]
fn meshes_of_other_people_do_not_leak() {
    let Some(data) = std::env::var_os("MEMSAVVY_DATA").map(PathBuf::from) else {
        eprintln!("skipped: MEMSAVVY_DATA does not name the data folder");
        return;
    };
    let mut meshes = 0;
    for folder in ["meshes", "meshes-dialects"] {
        for path in meshes_in(&data.join(folder)) {
            let surface = Surface::new(&read_mesh(&path).expect("a mesh of the data folder"));
            if surface.interior() > 0.0 {
                meshes += 1;
                shoot_at_mesh(&path.file_name().expect("a file").to_string_lossy(), surface);
            }
        }
    }
    assert!(meshes >= 20, "only {meshes} meshes in the data folder");
}

fn meshes_in(folder: &Path) -> Vec<PathBuf> {
    let files = fs::read_dir(folder).expect("a folder of meshes").map(|file| file.expect("a file").path());
    let is_mesh =
        |path: &PathBuf| path.extension().is_some_and(|extension| extension == "ply" || extension == "obj");
    let mut meshes: Vec<PathBuf> = files.filter(is_mesh).collect();
    meshes.sort();
    meshes
}

fn shoot_at_mesh(name: &str, surface: Surface) {
    let interior = surface.interior();
    let rays = if surface.mesh.triangles.len() > 10_000 { 100_000 } else { 3000 };
    let front = surface.front(Vec3::NEG_Z);
    if front.interior() > 0.0 {
        let mut front = Target::new(format!("front of {name}"), front, 4);
        for distance in [2.0, 1.0e4, 1.0e7] {
            front.shoot_along(Vec3::NEG_Z, distance, rays / 10);
        }
        println!("{}: {:?}", front.name, front.tally);
        front.tally.assert_few_excused(&front.name);
    }
    let mut target = Target::new(name.to_owned(), surface, 3);
    for distance in [0.4, 2.0, 100.0] {
        target.shoot_from(distance, rays);
    }
    println!("{}: {interior} of its edges are interior, {:?}", target.name, target.tally);
    target.tally.assert_few_excused(&target.name);
}

#[test]
fn from_inside_no_ray_gets_out() {
    // The rope's middle line is inside the knot; from there every ray meets the surface, through whatever it
    // is aimed.
    let mesh = builtin::knot(4000);
    let image = image(&mesh, 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    let mut dice = Dice(5);
    for _ in 0..20_000 {
        let t = f64::from(dice.unit()) * core::f64::consts::TAU;
        let distance = 2.0 + (3.0 * t).cos();
        let inside = [distance * (2.0 * t).cos(), distance * (2.0 * t).sin(), (3.0 * t).sin()];
        let origin = Vec3::from(inside.map(single));
        let [a, b, _] = mesh.triangles[dice.below(mesh.triangles.len())];
        let [a, b] = [a, b].map(|vertex| Vec3::from(mesh.positions[vertex as usize]));
        let aim = if dice.unit() < 0.3 { a } else { a + (b - a) * dice.unit() };
        let ray = Ray { origin, direction: aim - origin, t_max: f32::INFINITY };
        assert!(scene.any(&ray, &mut ()) == Ok(true), "{ray:?} gets out");
    }
}

#[test]
fn a_vertex_of_many_needles_has_no_hole() {
    let spokes = 999_u32;
    let rim = |i: u32| {
        let [x, y] = on_circle(f64::from(i) / f64::from(spokes));
        [x, y, 0.0]
    };
    // A double cone: two apexes over one rim.
    let mut positions = vec![[0.1, 0.2, 0.7], [0.0, 0.0, -0.9]];
    positions.extend((0..spokes).map(rim));
    let side = |i: u32| [i + 2, (i + 1) % spokes + 2];
    let upper = (0..spokes).map(|i| [0, side(i)[0], side(i)[1]]);
    let lower = (0..spokes).map(|i| [1, side(i)[1], side(i)[0]]);
    let cone = Mesh { positions, triangles: upper.chain(lower).collect() };
    let image = image(&cone, 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    let mut dice = Dice(9);
    for i in 0..4000_u32 {
        let origin = dice.point() * 0.05;
        let aim = Vec3::from(cone.positions[if i % 3 < 2 { i % 3 } else { 2 + i % spokes } as usize]);
        let ray = Ray { origin, direction: aim - origin, t_max: f32::INFINITY };
        assert!(brute::any(&scene, &ray) == Ok(true), "the test itself leaks: {ray:?}");
        assert!(scene.any(&ray, &mut ()) == Ok(true), "{ray:?} gets out");
    }
}

/// Powers of ten, not of two, so that coordinates round differently at each.
const SCALES: [f32; 5] = [1.0e-18, 1.0e-9, 1.0, 1.0e9, 1.0e18];

/// Along the axes rays meet exactly the point they are aimed at, from any distance; the others have few bits.
const DIRECTIONS: [Vec3; 5] =
    [Vec3::X, Vec3::NEG_Y, Vec3::NEG_Z, Vec3::new(0.5, -1.0, 0.25), Vec3::new(1.0, 1.0, 1.0)];

fn scaled(mesh: &Mesh, scale: f32) -> Mesh {
    let positions = mesh.positions.iter().map(|p| p.map(|x| x * scale)).collect();
    Mesh { positions, triangles: mesh.triangles.clone() }
}
