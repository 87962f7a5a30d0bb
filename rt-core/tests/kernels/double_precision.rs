//! The kernel against a different test of the mesh itself, in double precision: not the same bits, but the
//! same answer wherever the answer does not hang on rounding.

use crate::common::{Dice, image};
use rt_core::{Flat, Ray, SceneView};
use scene::{Mesh, builtin};

/// Where a ray crosses a triangle's plane, and by how much inside the triangle, as the smallest of the three
/// weights.
struct Crossing {
    t: f64,
    margin: f64,
    id: u32,
}

/// Möller and Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection", JGT 2(1), 1997, in `f64`.
fn cross(mesh: &Mesh, id: usize, ray: &Ray) -> Option<Crossing> {
    let double = |v: [f32; 3]| v.map(f64::from);
    let sub = |a: [f64; 3], b: [f64; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let product = |a: [f64; 3], b: [f64; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let [a, b, c] = mesh.triangles[id].map(|v| double(mesh.positions[v as usize]));
    let (origin, direction) = (double(ray.origin.into()), double(ray.direction.into()));
    let (e, f, from_a) = (sub(b, a), sub(c, a), sub(origin, a));
    let p = product(direction, f);
    let determinant = dot(e, p);
    let q = product(from_a, e);
    let (u, v, t) = (dot(from_a, p) / determinant, dot(direction, q) / determinant, dot(f, q) / determinant);
    let margin = u.min(v).min(1.0 - u - v);
    (determinant != 0.0).then_some(Crossing { t, margin, id: u32::try_from(id).expect("a small mesh") })
}

#[test]
fn nearest_hits_are_those_of_double_precision() {
    let mesh = builtin::knot(4000);
    let image = image(&mesh, 0.5, 4096);
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    let mut dice = Dice(21);
    let (mut hits, mut same_triangle) = (0, 0);
    for _ in 0..3000 {
        let origin = dice.point() * 5.0;
        let ray = Ray { origin, direction: dice.point() * 3.0 - origin, t_max: f32::INFINITY };
        let crossings: Vec<Crossing> = (0..mesh.triangles.len())
            .filter_map(|id| cross(&mesh, id, &ray))
            .filter(|c| c.t > 1.0e-5)
            .collect();
        let clear =
            crossings.iter().filter(|crossing| crossing.margin > 1.0e-4).map(|c| c.t).reduce(f64::min);
        match scene.nearest(&ray, &mut ()).expect("a sound image") {
            None => assert!(clear.is_none(), "{ray:?} misses, but is well inside a triangle at {clear:?}"),
            Some(hit) => {
                hits += 1;
                let t = f64::from(hit.t);
                assert!(
                    clear.is_none_or(|clear| t <= clear * (1.0 + 1.0e-5)),
                    "{ray:?}: {t} behind {clear:?}"
                );
                let id = scene.original_id(hit.primitive).expect("an id");
                let near = |c: &&Crossing| c.margin > -1.0e-4 && (c.t - t).abs() <= 1.0e-5 * t;
                let supported = crossings.iter().find(near);
                assert!(supported.is_some(), "{ray:?}: nothing at {t} in double precision");
                same_triangle += u32::from(crossings.iter().filter(near).any(|c| c.id == id));
            }
        }
    }
    assert!(hits > 1000 && same_triangle == hits, "{same_triangle} of {hits}");
}
