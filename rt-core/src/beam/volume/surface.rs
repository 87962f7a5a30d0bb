//! Depths and normals of what sixteen pixels of one block see of a volume.
//!
//! The very arithmetic of [`isosurface`](crate::isosurface), lane by lane.

use super::cubics::{Cubics, between};
use super::pixels::Found;
use crate::beam::surface::{Met, unit};
use crate::isosurface::Isosurfaces;
use crate::memory::SceneMemory;
use crate::simd::{Simd, each};

/// Finds where the rays of a block's pixels meet the isosurfaces they were found to meet.
#[inline(always)]
pub(super) fn meet<S: Simd, M: SceneMemory>(
    s: S,
    surfaces: &Isosurfaces<'_, M>,
    found: &Found<S::D, S::F>,
    direction: [S::F; 3],
) -> Met<S::F> {
    let stored = by_sought(s, surfaces, found.sought, |index| surfaces.sought()[index].stored);
    let mut values = found.samples;
    for value in &mut values {
        *value = s.sub(*value, stored);
    }
    let open = found.lanes & !found.known;
    let roots = Cubics::new(s, &values, &found.from, &found.to).roots(s, open, surfaces.solver);
    let at = s.select(found.known, found.at, roots);
    let way = s.mul_f64(s.widen(at), s.sub_f64(found.exit, found.enter));
    let t = s.narrow(s.min_f64(s.add_f64(found.enter, way), found.exit));
    Met { direction, t, normal: normal(s, surfaces.place.per_length, found, at, direction) }
}

/// A number of the isosurface that each pixel shows.
#[inline(always)]
pub(super) fn by_sought<S: Simd, M: SceneMemory>(
    s: S,
    surfaces: &Isosurfaces<'_, M>,
    sought: S::F,
    number: impl Fn(usize) -> f32,
) -> S::F {
    let mut numbers = s.splat(number(0));
    for index in 1..surfaces.sought().len() {
        let lanes = s.le(s.splat(index as f32), sought);
        numbers = s.select(lanes, s.splat(number(index)), numbers);
    }
    numbers
}

/// Unit normals, as [`Isosurfaces::normal`] finds them.
#[inline(always)]
fn normal<S: Simd>(
    s: S,
    per_length: [f64; 3],
    found: &Found<S::D, S::F>,
    at: S::F,
    direction: [S::F; 3],
) -> [S::F; 3] {
    let at = (at, s.sub(s.splat(1.0), at));
    let place = each!(3: [0, 1, 2], axis => {
        let place = between(s, found.from[axis], found.to[axis], at);
        (place, s.sub(s.splat(1.0), place))
    });
    let [x, y, z] = place;
    let samples = &found.samples;
    let gradient = [
        face(s, samples, ([0, 2, 4, 6], 1), y, z),
        face(s, samples, ([0, 1, 4, 5], 2), x, z),
        face(s, samples, ([0, 1, 2, 3], 4), x, y),
    ];
    let downwards = each!(3: [0, 1, 2], axis => {
        s.mul_f64(negated(s, s.widen(gradient[axis])), s.splat_f64(per_length[axis]))
    });
    let is_zero = each!(3: downwards, component => s.is_zero_f64(component));
    let is_zero = is_zero[0] & is_zero[1] & is_zero[2];
    let normal = unit(s, downwards);
    if is_zero & found.lanes == 0 {
        return normal;
    }
    let against = unit(s, each!(3: direction, component => negated(s, s.widen(component))));
    each!(3: [0, 1, 2], axis => s.select(is_zero, against[axis], normal[axis]))
}

/// The mean difference of samples across cells along one axis.
#[inline(always)]
fn face<S: Simd>(
    s: S,
    samples: &[S::F; 8],
    (corners, step): ([usize; 4], usize),
    u: (S::F, S::F),
    v: (S::F, S::F),
) -> S::F {
    let [a, b, c, d] = each!(4: corners, corner => s.sub(samples[corner + step], samples[corner]));
    between(s, between(s, a, b, u), between(s, c, d, u), v)
}

#[inline(always)]
fn negated<S: Simd>(s: S, value: S::D) -> S::D {
    s.mul_f64(value, s.splat_f64(-1.0))
}
