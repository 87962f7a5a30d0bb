//! A knot of triangles.

use core::f64::consts::TAU;

use rayon::prelude::*;

use crate::mesh::Mesh;

/// A trefoil knot tied from a rope of three strands: closed, and the same bits on every machine.
///
/// Has at least `triangles` triangles and few more; up to some 2 * 10^9, memory permitting.
pub fn knot(triangles: usize) -> Mesh {
    let around = (triangles / (2 * QUADS_ALONG)).isqrt().max(AROUND_MIN);
    let along = triangles.div_ceil(2 * around).max(AROUND_MIN);
    let points = (0..along).into_par_iter().flat_map_iter(|ring| {
        let ring = Ring::new(fraction(ring, along));
        (0..around).map(move |spoke| ring.point(fraction(spoke, around)))
    });
    let index = |ring: usize, spoke: usize| {
        let vertex = ring % along * around + spoke % around;
        u32::try_from(vertex)
            .unwrap_or_else(|_| panic!("a knot of {triangles} triangles has too many vertices"))
    };
    let faces = (0..along * around).into_par_iter().flat_map_iter(|quad| {
        let (ring, spoke) = (quad / around, quad % around);
        let [a, b] = [index(ring, spoke), index(ring + 1, spoke)];
        let [c, d] = [index(ring + 1, spoke + 1), index(ring, spoke + 1)];
        [[a, b, c], [a, c, d]]
    });
    Mesh { positions: points.collect(), triangles: faces.collect() }
}

/// The rope's cross-section at one place along the knot.
struct Ring {
    middle: [f64; 3],
    /// Unit vectors across the rope.
    normal: [f64; 3],
    binormal: [f64; 3],
    /// How far the strands have turned, as an angle.
    twist: f64,
    /// The fibres' phase.
    fibre: f64,
}

impl Ring {
    /// The ring at `place` in `0..1` along the knot.
    fn new(place: f64) -> Self {
        let t = TAU * place;
        let (sin2, cos2) = libm::sincos(2.0 * t);
        let (sin3, cos3) = libm::sincos(3.0 * t);
        // The knot winds around a torus, whose normal is across the rope everywhere.
        let normal = [cos3 * cos2, cos3 * sin2, sin3];
        let (distance, slope) = (2.0 + cos3, -3.0 * sin3);
        let tangent =
            [slope * cos2 - 2.0 * distance * sin2, slope * sin2 + 2.0 * distance * cos2, 3.0 * cos3];
        Self {
            middle: [distance * cos2, distance * sin2, sin3],
            normal,
            binormal: unit(cross(tangent, normal)),
            twist: TURNS * t,
            fibre: FIBRE_TURNS * t,
        }
    }

    /// The point at `place` in `0..1` around the rope.
    fn point(&self, place: f64) -> [f32; 3] {
        let angle = TAU * place;
        let (sin, cos) = libm::sincos(angle);
        let strand = libm::fabs(libm::cos(STRANDS * 0.5 * (angle + self.twist)));
        let fibre = libm::sin(FIBRES * (angle + self.twist) + self.fibre);
        let radius = 0.36 + 0.13 * libm::sqrt(strand) + 0.009 * strand * fibre;
        [0, 1, 2].map(|axis| {
            let offset = cos * self.normal[axis] + sin * self.binormal[axis];
            #[expect(clippy::cast_possible_truncation, reason = "rounded once, to the precision of a mesh")]
            let coordinate = (self.middle[axis] + radius * offset) as f32;
            coordinate
        })
    }
}

/// `part / whole`, for counts that `f64` holds exactly.
fn fraction(part: usize, whole: usize) -> f64 {
    part as f64 / whole as f64
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = libm::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    v.map(|x| x / length)
}

/// Quads along the knot for each quad around the rope, which makes them about square.
const QUADS_ALONG: usize = 10;

/// Fewest quads around the rope, and along it.
const AROUND_MIN: usize = 6;

/// Strands of the rope; each is a lobe of the cross-section.
const STRANDS: f64 = 3.0;

/// Turns of the strands along the knot; a multiple of one third, so that lobe meets lobe where the knot
/// closes.
const TURNS: f64 = 31.0 / 3.0;

/// Fibres on the rope's surface; a multiple of the strands, for the same reason.
const FIBRES: f64 = 15.0;

/// Turns of the fibres against the strands.
const FIBRE_TURNS: f64 = 60.0;

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;

    #[test]
    fn the_knot_is_closed_and_consistently_wound() {
        for triangles in [1, 1000, 20_000] {
            let mesh = knot(triangles);
            assert!(mesh.triangles.len() >= triangles);
            let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
            for &[a, b, c] in &mesh.triangles {
                for (from, to) in [(a, b), (b, c), (c, a)] {
                    *edges.entry((from, to)).or_default() += 1;
                }
            }
            assert!(
                edges.iter().all(|(&(from, to), &times)| times == 1 && edges.get(&(to, from)) == Some(&1))
            );
        }
    }

    #[test]
    fn the_number_of_triangles_is_close_to_what_was_asked_for() {
        for triangles in [10_000, 500_000] {
            let made = knot(triangles).triangles.len();
            assert!((triangles..triangles + triangles / 50).contains(&made), "{made} for {triangles}");
        }
    }
}
