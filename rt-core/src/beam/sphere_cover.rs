//! Rays against spheres in single precision, with what that leaves uncertain.
//!
//! Only the arithmetic of [`sphere`](crate::sphere) says whether and where a ray meets a sphere. This says it too, for sixteen
//! rays at a time, where there is no doubt; where there is some, the ray decides.
//!
//! # How large the doubt is
//! Let `e = 2^-24`, `f` the centre as seen from the ray's origin, `s = |f_x| + |f_y| + |f_z|`. The distance at which the
//! ray passes the centre is off by `6 e s`, its square by `8 e` more; so a sphere with a radius of `16 e s` more, and 16
//! `e` of itself, is hit wherever the true one is, and one with as much less is hit only there. `m`, the
//! middle of the hits, is off by `11 e s / |d|`, half the way between them by no more than the two radii tell, and `4 e`;
//! taken are `32 e (s + r) / |d|` together.
//!
//! Where the origin lies outside by more than the same doubt, the sphere is met at the first root, and that has the sign of
//! `m`; where it lies inside, at the second.

use super::edges::Covered;
use super::spheres::Balls;
use crate::simd::{Mask, Simd, each};

/// Spheres as seen from the origin of rays, one sphere in each lane or one in all.
#[derive(Clone, Copy)]
pub(super) struct Outline<F> {
    /// From the origin to the centre.
    pub(super) centre: [F; 3],
    /// Squares of the radius of what may be hit, and of what is hit without doubt (not above 0 when nothing is).
    pub(super) outer: F,
    pub(super) inner: F,
    /// Doubt about a place along the ray, for a direction of length 1.
    pub(super) doubt: F,
    /// Lanes in which the origin lies inside without doubt, and outside.
    pub(super) inside: Mask,
    pub(super) outside: Mask,
}

impl<F: Copy> Outline<F> {
    /// Spheres whose centres lie at `centre` from the origin.
    #[inline(always)]
    pub(super) fn new<S: Simd<F = F>>(s: S, centre: [F; 3], radius: F) -> Self {
        let [x, y, z] = each!(3: centre, value => s.abs(value));
        let size = s.add(s.add(x, y), z);
        let (share, more, less) = (s.splat(SHARE), s.splat(1.0 + SHARE), s.splat(1.0 - SHARE));
        let doubt = s.mul(size, share);
        let outer = s.mul(s.add(radius, doubt), more);
        let inner = s.max(s.mul(s.sub(radius, doubt), less), s.splat(0.0));
        let outer = s.add(s.mul(outer, outer), s.splat(f32::MIN_POSITIVE));
        let inner = s.mul(inner, inner);
        let square = s.dot(centre, centre);
        Self {
            centre,
            outer,
            inner,
            doubt: s.mul(s.add(size, radius), s.splat(2.0 * SHARE)),
            inside: s.lt(s.mul(square, more), inner),
            outside: s.lt(outer, s.mul(square, less)),
        }
    }

    /// How rays along `direction` meet the spheres. All directions are at least 0.64 long.
    #[inline(always)]
    pub(super) fn cover<S: Simd<F = F>>(&self, s: S, direction: [F; 3]) -> Covered<F> {
        let (zero, one) = (s.splat(0.0), s.splat(1.0));
        let per_square = s.div(one, s.dot(direction, direction));
        let apart = s.mul(self.across(s, direction), per_square);
        let middle = s.mul(s.dot(self.centre, direction), per_square);
        let (outer, inner) = (s.sub(self.outer, apart), s.sub(self.inner, apart));
        let [long, short] = each!(2: [outer, inner], under => s.sqrt(s.mul(s.max(under, zero), per_square)));
        let doubt = s.mul(self.doubt, s.splat(1.625));
        let first = s.select(self.inside, short, s.sub(zero, long));
        let last = s.select(self.inside, long, s.sub(zero, short));
        let (first, last) = (s.sub(s.add(middle, first), doubt), s.add(s.add(middle, last), doubt));
        let (certain, ahead) = (self.inside | self.outside, s.lt(zero, first));
        // Comparisons are written so that a NaN anywhere is a doubt.
        let missed = s.lt(outer, zero) | (s.lt(last, zero) & certain);
        let [low, high] = each!(2: [last, first], t => s.div(one, t));
        Covered {
            candidates: !missed,
            sure: s.lt(zero, inner) & ahead & certain,
            low: s.select(certain, s.mul(low, s.splat(1.0 - SHARE)), zero),
            high: s.select(ahead & certain, s.mul(high, s.splat(1.0 + SHARE)), s.splat(f32::INFINITY)),
        }
    }

    /// Squares of the distances at which rays pass the centres, times those of the directions' lengths.
    #[inline(always)]
    pub(super) fn across<S: Simd<F = F>>(&self, s: S, [dx, dy, dz]: [F; 3]) -> F {
        let [x, y, z] = self.centre;
        let across = [
            s.sub(s.mul(y, dz), s.mul(z, dy)),
            s.sub(s.mul(z, dx), s.mul(x, dz)),
            s.sub(s.mul(x, dy), s.mul(y, dx)),
        ];
        s.dot(across, across)
    }
}

impl<F: Copy> Balls<F> {
    /// As seen from points, one in each lane.
    #[inline(always)]
    pub(super) fn seen_from<S: Simd<F = F>>(&self, s: S, point: [F; 3]) -> Outline<F> {
        let centre = each!(3: [0, 1, 2], axis => s.sub(self.centre[axis], point[axis]));
        Outline::new(s, centre, self.radius)
    }
}

/// `2^-20`.
pub(super) const SHARE: f32 = 1.0 / 1_048_576.0;
