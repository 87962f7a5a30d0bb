//! The sphereflake: spheres that carry smaller ones, a classic of ray tracing, on a square of ground.

use core::f64::consts::PI;

use scene::Mesh;

/// A sphere: centre and radius.
pub(super) type Sphere = [f32; 4];

/// Spheres on spheres on spheres on a sphere: 1 + 9 + 81 + 729.
const DEPTH: u32 = 3;

/// The ground lies below the first sphere and reaches so far.
const GROUND: f32 = 8.0;

/// The spheres of the flake, the largest first among its own.
pub(super) fn spheres() -> Vec<Sphere> {
    let mut spheres = Vec::new();
    grow(&mut spheres, [0.0; 3], 1.0, [0.0, 1.0, 0.0], DEPTH);
    spheres
}

/// Two triangles.
pub(super) fn ground() -> Mesh {
    let corners = [[-GROUND, -GROUND], [GROUND, -GROUND], [GROUND, GROUND], [-GROUND, GROUND]];
    Mesh { positions: corners.map(|[x, z]| [x, -1.0, z]).into(), triangles: vec![[0, 2, 1], [0, 3, 2]] }
}

/// Adds a sphere, and nine a third of its size that touch it: six around its axis, three towards its tip.
fn grow(into: &mut Vec<Sphere>, centre: [f64; 3], radius: f64, axis: [f64; 3], depth: u32) {
    #[expect(clippy::cast_possible_truncation, reason = "rounded once, to the precision of a scene")]
    into.push([centre[0], centre[1], centre[2], radius].map(|number| number as f32));
    if depth == 0 {
        return;
    }
    let aside = if axis[0].abs() > 0.9 { [0.0, 1.0, 0.0] } else { [1.0, 0.0, 0.0] };
    let u = unit(cross(axis, aside));
    let v = cross(axis, u);
    let around = (0..6).map(|child| (PI / 3.0 * f64::from(child), 0.0));
    let above = (0..3).map(|child| (PI / 6.0 + 2.0 * PI / 3.0 * f64::from(child), PI / 3.0));
    for (turn, rise) in around.chain(above) {
        let (along_u, along_v, along_axis) = (turn.cos() * rise.cos(), turn.sin() * rise.cos(), rise.sin());
        let direction = [0, 1, 2].map(|i| u[i] * along_u + v[i] * along_v + axis[i] * along_axis);
        let child = [0, 1, 2].map(|i| centre[i] + direction[i] * radius * 4.0 / 3.0);
        grow(into, child, radius / 3.0, direction, depth - 1);
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    v.map(|x| x / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn children_touch_the_sphere_that_carries_them() {
        let spheres = spheres();
        assert_eq!(spheres.len(), 820);
        let [parent, child] = [spheres[0], spheres[1]];
        let distance = (0..3).map(|i| (child[i] - parent[i]).powi(2)).sum::<f32>().sqrt();
        assert!((distance - parent[3] - child[3]).abs() < 1.0e-6, "{distance}");
    }
}
