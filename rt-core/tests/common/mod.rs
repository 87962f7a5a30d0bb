//! Scenes, rays and the comparison with brute force that the kernel tests share.
#![allow(dead_code, unreachable_pub, reason = "every test binary uses a part")]

pub mod allocations;
pub mod drawing;
pub mod exact;
pub mod models;
pub mod pass;
pub mod reference;
pub mod shapes;
pub mod surface;
pub mod target;
pub mod volume;
pub mod watched;

use glam::Vec3;
use proptest::prelude::*;
use rt_core::{Flat, Hit, Lanes, Ray, SceneView, brute};
use scene::{BuildOptions, Mesh, build};

/// The image of a mesh.
pub fn image(mesh: &Mesh, slack: f32, page_bytes: u32) -> Vec<u8> {
    let scene = build(mesh.clone(), &BuildOptions { slack }, &|_| {}).expect("a mesh that builds");
    scene.to_bytes(page_bytes).expect("an image that fits")
}

/// A file of the data folder; `None`, said aloud, when there is no such folder.
pub fn data(name: &str) -> Option<std::path::PathBuf> {
    let folder = std::env::var_os("MEMSAVVY_DATA").map(std::path::PathBuf::from);
    if folder.is_none() {
        eprintln!("skipped: MEMSAVVY_DATA does not name the folder with {name}");
    }
    folder.map(|folder| folder.join(name))
}

/// Asserts that the grid answers as brute force does, bit for bit and with all lanes, for nearest and any hit.
pub fn agree(scene: &SceneView<Flat<'_>>, ray: &Ray) -> Option<Hit> {
    Lanes::available().map(|lanes| agree_with(&scene.with_lanes(lanes), ray)).last().flatten()
}

fn agree_with(scene: &SceneView<Flat<'_>>, ray: &Ray) -> Option<Hit> {
    let walked = scene.nearest(ray, &mut ()).expect("a sound image");
    let tested = brute::nearest(scene, ray).expect("a sound image");
    // A copy of the triangle may stand for it, so the mesh's number is compared, not the place.
    let key = |hit: &Hit| {
        let Hit { t, u, v, primitive, normal } = hit;
        let bits = [*t, *u, *v, normal.x, normal.y, normal.z].map(f32::to_bits);
        (bits, scene.original_id(*primitive).expect("a place in the image"))
    };
    assert_eq!(
        walked.as_ref().map(key),
        tested.as_ref().map(key),
        "{ray:?}: {walked:?} by the grid with {}, {tested:?} by brute force",
        scene.lanes()
    );
    assert_eq!(scene.any(ray, &mut ()).expect("a sound image"), tested.is_some(), "any hit of {ray:?}");
    walked
}

/// Rounds a number that a test computed in double precision.
#[expect(clippy::cast_possible_truncation, reason = "rounding is what it is for")]
pub fn single(value: f64) -> f32 {
    value as f32
}

/// A point of the unit circle, a share of the way around.
pub fn on_circle(share: f64) -> [f32; 2] {
    let (sin, cos) = (share * core::f64::consts::TAU).sin_cos();
    [single(cos), single(sin)]
}

/// A small splittable source of numbers for loops that are too long for proptest.
pub struct Dice(pub u64);

impl Dice {
    pub fn next(&mut self) -> u64 {
        // SplitMix64: Steele, Lea and Flood, OOPSLA 2014.
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub fn below(&mut self, bound: usize) -> usize {
        usize::try_from(self.next() % bound as u64).expect("below a usize")
    }

    /// A number in `0..1`.
    pub fn unit(&mut self) -> f32 {
        f32::from(u16::try_from(self.next() >> 48).expect("16 bits")) / 65_536.0
            + f32::from(u16::try_from(self.next() >> 48).expect("16 bits")) / 4_294_967_296.0
    }

    /// A point of the cube `-1..1`.
    pub fn point(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit()) * 2.0 - 1.0
    }

    pub fn direction(&mut self) -> Vec3 {
        loop {
            let point = self.point();
            if (0.01..1.0).contains(&point.length_squared()) {
                return point.normalize();
            }
        }
    }
}

/// Meshes of a few to some hundred triangles: soups of all sizes, needles, coincident ones, shared vertices.
pub fn meshes() -> impl Strategy<Value = Mesh> {
    let sizes = prop_oneof![Just(1.0_f32), Just(0.1), Just(0.01), Just(1.0e-4)];
    let triangle = (point(), [point(), point()], sizes, 0..6_u8).prop_map(|(at, [a, b], size, shape)| {
        let (a, b) = (a * size, b * size);
        match shape {
            // A needle, an axis-parallel right angle, and a collinear triangle.
            0 => [at, at + a, at + a * 1.0001 + b * 1.0e-5],
            1 => [at, at + Vec3::X * size, at + Vec3::Y * size],
            2 => [at, at + a, at + a * 0.5],
            _ => [at, at + a, at + b],
        }
    });
    let soup = prop::collection::vec((triangle, 1..4_usize), 1..150).prop_map(|triangles| {
        let corners = triangles
            .into_iter()
            .flat_map(|(triangle, copies)| vec![triangle; if copies == 3 { 40 } else { 1 }]);
        soup(corners.collect())
    });
    let placed = |mesh: Mesh, offset: Vec3, scale: f32| {
        let place = |p: &[f32; 3]| ((Vec3::from(*p) + offset) * scale).to_array();
        Mesh { positions: mesh.positions.iter().map(place).collect(), triangles: mesh.triangles }
    };
    let offsets = prop_oneof![
        3 => Just(Vec3::ZERO),
        1 => Just(Vec3::new(50.0, -3.0, 0.0)),
        1 => Just(Vec3::splat(3000.0)),
        1 => Just(Vec3::splat(1.0e5)),
    ];
    let scales = prop_oneof![3 => Just(1.0_f32), 1 => Just(1.0e-18), 1 => Just(3.0e17), 1 => Just(0.37)];
    prop_oneof![3 => soup, 1 => (20..800_usize).prop_map(scene::builtin::knot), 1 => Just(grid_of_squares())]
        .prop_flat_map(move |mesh| (Just(mesh), offsets.clone(), scales.clone()))
        .prop_map(move |(mesh, offset, scale)| placed(mesh, offset, scale))
        .prop_filter("something to hit", |mesh| {
            build(mesh.clone(), &BuildOptions::default(), &|_| {}).is_ok()
        })
}

/// Triangles with vertices of their own.
fn soup(triangles: Vec<[Vec3; 3]>) -> Mesh {
    let positions = triangles.iter().flatten().map(Vec3::to_array).collect();
    let count = u32::try_from(triangles.len()).expect("a small mesh");
    Mesh { positions, triangles: (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect() }
}

/// Squares on an even grid in three planes: edges and corners lie exactly on cell boundaries.
fn grid_of_squares() -> Mesh {
    let mut triangles = Vec::new();
    for plane in 0..3 {
        for i in 0..8_u8 {
            for j in 0..8_u8 {
                let at = |i: u8, j: u8| {
                    let mut point = Vec3::ZERO;
                    point[(plane + 1) % 3] = f32::from(i) / 4.0 - 1.0;
                    point[(plane + 2) % 3] = f32::from(j) / 4.0 - 1.0;
                    point
                };
                triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
    }
    soup(triangles)
}

/// How to choose a ray, given a mesh and where its grid lies.
#[derive(Clone, Debug)]
pub struct RayPlan {
    aim: Aim,
    from: From,
    bend: Bend,
    t_max: f32,
}

/// What the ray goes through.
#[derive(Clone, Debug)]
enum Aim {
    /// A point of the bounds, as shares of them.
    Anywhere(Vec3),
    /// A vertex, an edge, or the inside of a triangle.
    Vertex(prop::sample::Index, usize),
    Edge(prop::sample::Index, usize, f32),
    Inside(prop::sample::Index, f32, f32),
    /// A corner of a cell on some level.
    CellCorner(u32, [u16; 3]),
}

/// Where it starts: so many diagonals away from the aim, in this direction.
#[derive(Clone, Debug)]
struct From {
    direction: Vec3,
    diagonals: f32,
}

/// What is done to the direction.
#[derive(Clone, Debug)]
enum Bend {
    None,
    /// Only one axis is left, with zeros of this sign in the others.
    Axis(usize, f32),
    /// One component becomes this.
    Component(usize, f32),
    /// All components get the same size.
    Diagonal,
    /// The direction gets this length.
    Length(f32),
}

/// Rays of all the kinds that have gone wrong in ray tracers.
pub fn ray_plans() -> impl Strategy<Value = RayPlan> {
    let index = any::<prop::sample::Index>;
    let aim = prop_oneof![
        point().prop_map(Aim::Anywhere),
        (index(), 0..3_usize).prop_map(|(t, k)| Aim::Vertex(t, k)),
        (index(), 0..3_usize, 0.0..1.0_f32).prop_map(|(t, k, s)| Aim::Edge(t, k, s)),
        (index(), 0.0..1.0_f32, 0.0..1.0_f32).prop_map(|(t, u, v)| Aim::Inside(t, u, v)),
        (1..4_u32, [0..256_u16, 0..256_u16, 0..256_u16]).prop_map(|(level, at)| Aim::CellCorner(level, at)),
    ];
    let diagonals = prop_oneof![
        Just(0.0_f32),
        Just(0.01),
        Just(0.3),
        Just(1.0),
        Just(100.0),
        Just(1.0e4),
        Just(1.0e5),
        Just(1.0e7)
    ];
    let bend = prop_oneof![
        4 => Just(Bend::None),
        2 => (0..3_usize, prop_oneof![Just(0.0_f32), Just(-0.0)])
            .prop_map(|(axis, zero)| Bend::Axis(axis, zero)),
        1 => (0..3_usize, prop_oneof![Just(1.0e-30_f32), Just(-1.0e-25), Just(-0.0), Just(1.0e-10)])
            .prop_map(|(axis, value)| Bend::Component(axis, value)),
        1 => Just(Bend::Diagonal),
        1 => prop_oneof![Just(1.0e-30_f32), Just(1.0e30), Just(7.0)].prop_map(Bend::Length),
    ];
    let t_max = prop_oneof![4 => Just(f32::INFINITY), 1 => Just(1.0_f32), 1 => 0.5..1.5_f32];
    (aim, point(), diagonals, bend, t_max).prop_map(|(aim, direction, diagonals, bend, t_max)| RayPlan {
        aim,
        from: From { direction, diagonals },
        bend,
        t_max,
    })
}

impl RayPlan {
    /// The ray, for this mesh and scene.
    pub fn ray(&self, mesh: &Mesh, scene: &SceneView<Flat<'_>>) -> Ray {
        let bounds = scene.header().bounds;
        let diagonal = (bounds.high - bounds.low).abs().max_element();
        let aim = self.aim.point(mesh, scene);
        let direction = self.bend.apply(self.from.direction);
        let unit = direction / direction.abs().max_element();
        Ray { origin: aim - unit * (self.from.diagonals * diagonal), direction, t_max: self.t_max }
    }
}

impl Aim {
    fn point(&self, mesh: &Mesh, scene: &SceneView<Flat<'_>>) -> Vec3 {
        let corners = |index: &prop::sample::Index| {
            mesh.triangles[index.index(mesh.triangles.len())].map(|v| Vec3::from(mesh.positions[v as usize]))
        };
        let bounds = scene.header().bounds;
        match self {
            Self::Anywhere(share) => bounds.low + (bounds.high - bounds.low) * (*share * 0.6 + 0.5),
            Self::Vertex(triangle, k) => corners(triangle)[*k],
            Self::Edge(triangle, k, share) => {
                let [a, b] = [corners(triangle)[*k], corners(triangle)[(*k + 1) % 3]];
                a + (b - a) * *share
            }
            Self::Inside(triangle, u, v) => {
                let [a, b, c] = corners(triangle);
                a + (b - a) * (*u * 0.5) + (c - a) * (*v * 0.5)
            }
            Self::CellCorner(level, at) => {
                let grid = scene.header().grid;
                let cells = 1_u16 << (2 * level);
                let cell = grid.size / f32::from(cells);
                let corner = grid.origin + Vec3::from(at.map(|i| f32::from(i % (cells + 1)))) * cell;
                scene.header().scale().inverse().apply_to(corner)
            }
        }
    }
}

impl Bend {
    fn apply(&self, direction: Vec3) -> Vec3 {
        let mut bent = direction;
        match *self {
            Self::None => {}
            Self::Axis(axis, zero) => {
                bent = Vec3::splat(zero);
                bent[axis] = if direction[axis] < 0.0 { -1.0 } else { 1.0 };
            }
            Self::Component(axis, value) => bent[axis] = value,
            Self::Diagonal => {
                bent = Vec3::from(direction.to_array().map(|d| if d < 0.0 { -1.0 } else { 1.0 }))
            }
            Self::Length(length) => bent = direction.normalize_or(Vec3::X) * length,
        }
        if bent == Vec3::ZERO { Vec3::X } else { bent }
    }
}

fn point() -> impl Strategy<Value = Vec3> + Clone {
    [-1.0..1.0_f32, -1.0..1.0_f32, -1.0..1.0_f32].prop_map(Vec3::from)
}
