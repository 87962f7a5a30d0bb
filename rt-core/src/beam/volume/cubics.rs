//! The values along sixteen rays in voxel cells, and their roots.
//!
//! [`Cubic`], lane by lane, for those that change once between inside and outside: nearly all that change at all.

use crate::cubic::{CLOSE, Cubic, NEWTON_STEPS, Solver};
use crate::simd::{Mask, Simd, each};

/// Bernstein coefficients, from entries to exits.
pub(super) struct Cubics<F>([F; 4]);

/// How often coefficients change between inside and outside.
pub(super) struct Changes {
    pub(super) once: Mask,
    pub(super) more: Mask,
}

impl Changes {
    pub(super) const fn any(&self) -> Mask {
        self.once | self.more
    }
}

impl<F: Copy> Cubics<F> {
    /// The cubics between places of cells with these samples, the isovalue subtracted.
    #[inline(always)]
    pub(super) fn new<S: Simd<F = F>>(s: S, samples: &[F; 8], from: &[F; 3], to: &[F; 3]) -> Self {
        let ends = each!(3: [0, 1, 2], axis => {
            each!(2: [from[axis], to[axis]], at => (at, s.sub(s.splat(1.0), at)))
        });
        let [x, y, z] = ends;
        // Along x at both places, then along y, then along z, as `Cubic::new` does.
        let [first, second] = each!(2: x, x => {
            let along_x = each!(4: [0, 2, 4, 6], i => between(s, samples[i], samples[i + 1], x));
            each!(2: y, y => {
                [between(s, along_x[0], along_x[1], y), between(s, along_x[2], along_x[3], y)]
            })
        });
        let [a, b, c, d] = each!(4: [first[0], first[1], second[0], second[1]], face => {
            each!(2: z, z => between(s, face[0], face[1], z))
        });
        let third = s.splat(1.0 / 3.0);
        Self([
            a[0],
            s.mul(s.add(s.add(c[0], b[0]), a[1]), third),
            s.mul(s.add(s.add(d[0], c[1]), b[1]), third),
            d[1],
        ])
    }

    /// How often they change; those that are NaN do not.
    #[inline(always)]
    pub(super) fn changes<S: Simd<F = F>>(&self, s: S) -> Changes {
        let [a, b, c, d] = self.0;
        let sum = s.add(s.add(s.add(a, b), c), d);
        let is_number = s.le(sum, sum);
        let [a, b, c, d] = each!(4: self.0, coefficient => s.le(s.splat(0.0), coefficient));
        let (first, second, third) = (a ^ b, b ^ c, c ^ d);
        let more = first & second | second & third | third & first;
        Changes { once: (first | second | third) & !more & is_number, more: more & is_number }
    }

    /// The root of those of `lanes`, which change once.
    #[inline(always)]
    pub(super) fn roots<S: Simd<F = F>>(&self, s: S, lanes: Mask, solver: Solver) -> F {
        if solver == Solver::MarmittNewton {
            return self.newton(s, lanes);
        }
        let coefficients = each!(4: self.0, coefficient => s.array(coefficient));
        let mut roots = s.array(s.splat(0.0));
        for (lane, root) in roots.iter_mut().enumerate().filter(|(lane, _)| lanes >> lane & 1 != 0) {
            let cubic = Cubic([0, 1, 2, 3].map(|i: usize| coefficients[i][lane]));
            *root = cubic.first_root(solver).unwrap_or(0.0);
        }
        s.load(&roots)
    }

    /// Newton steps between bounds that close in.
    #[inline(always)]
    fn newton<S: Simd<F = F>>(&self, s: S, lanes: Mask) -> F {
        let [zero, half, one, two] = each!(4: [0.0, 0.5, 1.0, 2.0], value => s.splat(value));
        let [at_low, .., at_high] = self.0;
        let (mut low, mut high, mut step) = (zero, one, one);
        let is_low_inside = s.le(zero, at_low);
        let secant = s.mul(one, s.div(at_low, s.sub(at_low, at_high)));
        let mut root = s.min(s.max(s.add(low, secant), low), high);
        let mut open = lanes;
        for _ in 0..NEWTON_STEPS {
            let (value, slope) = self.value(s, root);
            let is_like_low = !(s.le(zero, value) ^ is_low_inside);
            low = s.select(is_like_low, root, low);
            high = s.select(is_like_low, high, root);
            let next = s.sub(root, s.div(value, slope));
            let crosses = is_low_inside & s.lt(slope, zero) | !is_low_inside & s.lt(zero, slope);
            let moved = s.abs(s.sub(next, root));
            open &= !(crosses & s.le(moved, s.splat(CLOSE)));
            if open == 0 {
                break;
            }
            let is_between = s.lt(low, next) & s.lt(next, high);
            let inside = crosses & is_between & s.le(s.mul(moved, two), step);
            let next = s.select(inside, next, s.mul(s.add(low, high), half));
            step = s.abs(s.sub(next, root));
            root = s.select(open, next, root);
        }
        root
    }

    /// Values and derivatives.
    #[inline(always)]
    fn value<S: Simd<F = F>>(&self, s: S, at: F) -> (F, F) {
        let at = (at, s.sub(s.splat(1.0), at));
        let [a, b, c, d] = self.0;
        let (a, b, c) = (between(s, a, b, at), between(s, b, c, at), between(s, c, d, at));
        let (a, b) = (between(s, a, b, at), between(s, b, c, at));
        (between(s, a, b, at), s.mul(s.splat(3.0), s.sub(b, a)))
    }
}

/// [`between`](crate::cubic::between), by a weight and what it lacks to 1.
#[inline(always)]
pub(super) fn between<S: Simd>(s: S, a: S::F, b: S::F, (weight, rest): (S::F, S::F)) -> S::F {
    s.add(s.mul(a, rest), s.mul(b, weight))
}
