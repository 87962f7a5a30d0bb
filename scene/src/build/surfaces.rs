//! What the builder asks of a triangle or a sphere.

use glam::Vec3;
use rt_core::sphere::Sphere;
use rt_core::surface::Surface;

/// Whether no ray can hit it: two corners are the same point, which makes a determinant of exactly 0 for every
/// ray, or the radius is 0.
pub(super) fn is_collapsed(surface: &Surface) -> bool {
    match *surface {
        Surface::Triangle([a, b, c]) => a == b || b == c || c == a,
        Surface::Sphere(sphere) => sphere.radius == 0.0,
    }
}

/// The smallest box around it; rounded to `f64` for a sphere, exact for a triangle.
pub(super) fn extent(surface: &Surface) -> ([f64; 3], [f64; 3]) {
    let double = |point: Vec3| point.to_array().map(f64::from);
    match *surface {
        Surface::Triangle([a, b, c]) => (double(a.min(b).min(c)), double(a.max(b).max(c))),
        Surface::Sphere(Sphere { centre, radius }) => {
            let (centre, radius) = (double(centre), f64::from(radius));
            (centre.map(|x| x - radius), centre.map(|x| x + radius))
        }
    }
}

/// Bits that two surfaces share if, and only if, they are the same.
pub(super) fn bits(surface: &Surface) -> [[u32; 3]; 3] {
    let bits_of = |point: Vec3| point.to_array().map(f32::to_bits);
    match *surface {
        Surface::Triangle(corners) => corners.map(bits_of),
        // No finite corner has the bits of NOT_FINITE.
        Surface::Sphere(Sphere { centre, radius }) => {
            [bits_of(centre), [radius.to_bits(), 0, 0], [NOT_FINITE; 3]]
        }
    }
}

/// Whether the surface of a sphere, not merely its inside, touches a box; errs only towards yes.
pub(super) fn surface_touches(centre: [f64; 3], radius: f64, low: [f64; 3], high: [f64; 3]) -> bool {
    let spans = [0, 1, 2].map(|axis| span(centre[axis], low[axis], high[axis]));
    let margin = (high[0] - low[0]).abs() * MARGIN;
    let distance =
        |of: fn(&(f64, f64)) -> f64| spans.iter().map(|span| of(span) * of(span)).sum::<f64>().sqrt();
    distance(|span| span.0) <= radius + margin && distance(|span| span.1) >= radius - margin
}

/// The box of that part of a sphere's surface that lies in the box `low..=high`, or `None` when there is no such
/// part; errs only towards larger.
///
/// Along each axis, the nearest place of the box on the other two axes bounds how far out the surface can be, and
/// the farthest place how far in.
pub(super) fn surface_inside(
    centre: [f64; 3],
    radius: f64,
    low: [f64; 3],
    high: [f64; 3],
) -> Option<([f64; 3], [f64; 3])> {
    let spans = [0, 1, 2].map(|axis| span(centre[axis], low[axis], high[axis]));
    let margin = radius * ROOT_MARGIN;
    let (mut inner_low, mut inner_high) = (low, high);
    for axis in 0..3 {
        let (b, c) = (spans[(axis + 1) % 3], spans[(axis + 2) % 3]);
        let across = |b: f64, c: f64| (radius * radius - b * b - c * c).max(0.0).sqrt();
        let (out, inside) = (across(b.0, c.0) + margin, across(b.1, c.1) - margin);
        let (mut from, mut to) = (low[axis].max(centre[axis] - out), high[axis].min(centre[axis] + out));
        if from > centre[axis] - inside {
            from = from.max(centre[axis] + inside);
        }
        if to < centre[axis] + inside {
            to = to.min(centre[axis] - inside);
        }
        (inner_low[axis], inner_high[axis]) = (from, to);
    }
    (0..3).all(|axis| inner_low[axis] <= inner_high[axis]).then_some((inner_low, inner_high))
}

/// Nearest and farthest distance of a place on an axis from an interval of it.
const fn span(place: f64, low: f64, high: f64) -> (f64, f64) {
    let nearest = (low - place).max(place - high).max(0.0);
    (nearest, (low - place).abs().max((high - place).abs()))
}

/// Bits of a NaN.
const NOT_FINITE: u32 = u32::MAX;

/// Share of a box's edge by which distances in it are off, and more.
const MARGIN: f64 = 1.0e-9;

/// Share of a radius by which the root of a rounded difference of squares is off, and more.
const ROOT_MARGIN: f64 = 1.0e-7;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_inside_a_sphere_does_not_touch_its_surface() {
        let touches = |low: f64, high: f64| surface_touches([0.0; 3], 1.0, [low; 3], [high; 3]);
        assert!(!touches(-0.5, 0.5) && touches(-0.5, 0.6) && touches(0.5, 2.0) && !touches(0.6, 2.0));
        assert!(touches(-2.0, 2.0));
    }

    #[test]
    fn a_box_whose_corner_is_on_the_surface_touches_it_and_the_next_does_not() {
        let centre = [0.3, -0.2, 0.1];
        for i in 1..200_u32 {
            let (around, up) = (f64::from(i) * 0.731, f64::from(i) * 0.317);
            let outwards = [around.cos() * up.sin(), around.sin() * up.sin(), up.cos()];
            // A box from the point at `share` of the radius, so far outwards, or with a negative length inwards.
            let touches = |share: f64, length: f64| {
                let from = [0, 1, 2].map(|axis| centre[axis] + outwards[axis] * share);
                let to = [0, 1, 2].map(|axis| from[axis] + outwards[axis] * length);
                let low = [0, 1, 2].map(|axis| from[axis].min(to[axis]));
                let high = [0, 1, 2].map(|axis| from[axis].max(to[axis]));
                surface_touches(centre, 1.0, low, high)
            };
            for length in [1.0e-6, 0.01, 0.3] {
                let hair = 1.0e-12;
                assert!(touches(1.0 - hair, length) && touches(1.0 + hair, -length), "{outwards:?} {length}");
                assert!(!touches(1.000_001, length) && !touches(0.999_999, -length), "{outwards:?} {length}");
            }
        }
    }

    #[test]
    fn the_box_of_a_cap_is_tight() {
        let (low, high) = ([-0.6, -0.6, 0.0], [0.6, 0.6, 2.0]);
        let (from, to) = surface_inside([0.0; 3], 1.0, low, high).expect("a cap");
        assert!(
            (to[2] - 1.0).abs() < 1.0e-6 && (from[2] - 0.28_f64.sqrt()).abs() < 1.0e-6,
            "{from:?} {to:?}"
        );
        assert!((0..2).all(|axis| from[axis] == -0.6 && to[axis] == 0.6));
        assert_eq!(surface_inside([0.0; 3], 1.0, [-0.5; 3], [0.5; 3]), None);
    }

    #[test]
    fn every_point_of_a_surface_inside_a_box_lies_in_the_smaller_one() {
        for seed in 0..400_u32 {
            let at = |i: u32| f64::from((seed * 9 + i).wrapping_mul(2_654_435_761) >> 8) / f64::from(1 << 24);
            let centre = [at(0), at(1), at(2)];
            let radius = at(3) * 1.5;
            let (a, b) = ([at(4), at(5), at(6)], [at(7), at(8), at(9)]);
            let low = [0, 1, 2].map(|axis| a[axis].min(b[axis]));
            let high = [0, 1, 2].map(|axis| a[axis].max(b[axis]));
            let smaller = surface_inside(centre, radius, low, high);
            for i in 0..64_u32 {
                for j in 0..64_u32 {
                    let (around, up) = (f64::from(i) * 0.098_2, f64::from(j) * 0.049_1);
                    let outwards = [around.cos() * up.sin(), around.sin() * up.sin(), up.cos()];
                    let point = [0, 1, 2].map(|axis| centre[axis] + radius * outwards[axis]);
                    let within = |(low, high): ([f64; 3], [f64; 3])| {
                        (0..3).all(|axis| low[axis] <= point[axis] && point[axis] <= high[axis])
                    };
                    if within((low, high)) {
                        assert!(surface_touches(centre, radius, low, high));
                        assert!(smaller.is_some_and(within), "{point:?} is not in {smaller:?}");
                    }
                }
            }
        }
    }
}
