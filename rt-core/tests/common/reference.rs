//! Brute force over the mesh itself, in double precision, and where a kernel may differ from it.

use glam::Vec3;
use rt_core::triangle_f64::F64Ray;
use rt_core::triangle_test::TriangleTest;
use rt_core::{Hit, Ray};
use scene::Mesh;

use super::pass::{Pass, is_at_an_edge, judge, range_of_t};
use super::surface::Surface;

/// Asserts that what a kernel found is what double precision finds, or that the ray passes an edge so closely
/// that the rounding of its corners decides. `id` is the number that the hit's triangle has in the mesh.
///
/// What lies within the rounding of the ray's start or of `t_max` may be found or not.
pub fn assert_agrees(mesh: &Mesh, ray: &Ray, found: Option<(&Hit, u32)>) {
    let at_start = tolerance(mesh, ray, 0.0);
    let t = found.map_or(ray.t_max, |(hit, _)| hit.t);
    let expected = nearest_behind(mesh, ray, at_start);
    if let Some(expected) = expected
        && t > expected + tolerance(mesh, ray, expected)
    {
        let pass = judge(&Surface::new(mesh), ray, t);
        assert!(!matches!(pass, Pass::Leak { .. }), "{ray:?}: {found:?} for {expected}, {pass:?}");
    }
    if let Some((hit, id)) = found
        && t > at_start
        && expected.is_none_or(|expected| t < expected - tolerance(mesh, ray, expected))
    {
        let triangle = mesh.triangles[id as usize];
        let alone = Surface::new(&Mesh { positions: mesh.positions.clone(), triangles: vec![triangle] });
        let (low, high) = range_of_t(&alone, ray);
        let is_steep = low <= 0.0 || expected.is_some_and(|expected| high >= f64::from(expected));
        assert!(is_at_an_edge(&alone, ray) || is_steep, "{ray:?}: {hit:?} for {expected:?}");
    }
}

/// The nearest `t` above `start` of all triangles, whatever `t_max`; `None` for a miss, and for a ray that is
/// none.
fn nearest_behind(mesh: &Mesh, ray: &Ray, start: f32) -> Option<f32> {
    let usable = ray.origin.is_finite() && ray.direction.is_finite() && ray.direction != Vec3::ZERO;
    if !usable {
        return None;
    }
    let test = F64Ray::new(ray.origin, ray.direction);
    let crossing = |corners: &[u32; 3]| test.intersect(corners_of(mesh, corners), f32::INFINITY);
    let crossings = mesh.triangles.iter().filter_map(crossing);
    crossings.map(|crossing| crossing.t).filter(|&t| t > start).reduce(f32::min)
}

/// What rounding may do to `t`, other than along a steep triangle: 2^-21 of the way from the origin, and of
/// the largest coordinate.
fn tolerance(mesh: &Mesh, ray: &Ray, t: f32) -> f32 {
    let largest = mesh.positions.iter().flatten().fold(0.0_f32, |largest, x| largest.max(x.abs()));
    (t + largest / ray.direction.abs().max_element()) / 2_097_152.0
}

fn corners_of(mesh: &Mesh, corners: &[u32; 3]) -> [Vec3; 3] {
    corners.map(|vertex| mesh.positions[vertex as usize].into())
}
