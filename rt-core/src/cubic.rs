//! The value along a ray inside one voxel cell: a cubic in Bernstein form, and ways to find its first root.
//!
//! # Why Bernstein form
//! Along a straight line a trilinear function is a cubic. Its four Bernstein coefficients are values of the trilinear
//! function itself: at the entry, at the exit, and means of three at other corners of the box between the two (its
//! *blossom*). Each is made of the eight samples by weights that are not negative, `(1 - w) a + w b`. So:
//! - samples of one sign give coefficients of that sign, exactly, whatever is rounded: a cell that is skipped for its
//!   range can only agree with its neighbours about the face they share;
//! - the first and last coefficient depend on the four samples of the face alone, bit for bit, so neighbours agree
//!   there as well;
//! - coefficients of one sign leave no root, and one change of sign leaves exactly one: nothing has to be isolated.
//!
//! Nothing cancels but what is small.
//!
//! # What is a root
//! A value that is at or above the isovalue is *inside*. A root is where the ray changes between inside and outside;
//! so a ray that leaves a plateau at the isovalue meets a surface, and one that touches it from above does not.
//! Between two places of different kind there always is one, hence no ray slips through between cells.
//!
//! # Source
//! Marmitt, Kleer, Wald, Friedrich and Slusallek, "Fast and accurate ray-voxel intersection techniques for iso-surface
//! ray tracing", VMV 2004: isolation by the extrema of the cubic, then repeated linear interpolation. Neubauer,
//! Mroz, Hauser and Wegenkittl, "Cell-based first-hit ray casting", VisSym 2002: the interpolation alone. We differ:
//! their cubics are sums of powers, which cancel; and isolation is needed here only behind two changes of sign.

use core::fmt;
use core::str::FromStr;

/// How roots are found; each has its row in the report of errors against run time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Solver {
    /// Isolation by the extrema, then Newton steps kept between bounds that close in.
    #[default]
    MarmittNewton,
    /// Isolation by the extrema, then three linear interpolations.
    Marmitt,
    /// Three linear interpolations, where entry and exit differ.
    Neubauer,
    /// One linear interpolation, where entry and exit differ.
    Linear,
    /// Isolation by the extrema, then halving.
    Bisect,
}

/// Bernstein coefficients of the value less the isovalue, from the entry to the exit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cubic(pub [f32; 4]);

impl Cubic {
    /// The cubic between two places of a cell with these samples, the isovalue subtracted; sample `x + 2 y + 4 z` is
    /// at corner `(x, y, z)`.
    #[inline]
    pub fn new(samples: [f32; 8], from: [f32; 3], to: [f32; 3]) -> Self {
        let [x, y, z] = [0, 1, 2].map(|axis| [from[axis], to[axis]]);
        // Along x at both places, then along y, then along z: corners of the box between the places.
        let along_x = x.map(|x| [0, 2, 4, 6].map(|i| between(samples[i], samples[i + 1], x)));
        let along_y = along_x.map(|e| y.map(|y| [between(e[0], e[1], y), between(e[2], e[3], y)]));
        let [[a, b], [c, d]] = along_y.map(|faces| faces.map(|f| z.map(|z| between(f[0], f[1], z))));
        // `a` and `b` are at the first x, `a` and `c` at the first y; the first of each pair is at the first z.
        let third = 1.0 / 3.0;
        Self([a[0], (c[0] + b[0] + a[1]) * third, (d[0] + c[1] + b[1]) * third, d[1]])
    }

    /// The first root, in `0..=1`.
    #[inline]
    pub fn first_root(&self, solver: Solver) -> Option<f32> {
        if self.changes() == 0 || self.is_nan() {
            return None;
        }
        let bracket = match solver.isolates() && self.changes() > 1 {
            true => self.brackets().into_iter().flatten().next()?,
            false => Bracket::of(0.0, self.0[0], 1.0, self.0[3])?,
        };
        Some(bracket.solve(self, solver))
    }

    /// All roots in order, up to three; those that do not isolate find one at most.
    pub fn roots(&self, solver: Solver) -> impl Iterator<Item = f32> + use<> {
        let cubic = *self;
        let brackets = match self.changes() {
            _ if self.is_nan() => [None; 3],
            0 => [None; 3],
            _ if solver.isolates() => self.brackets(),
            _ => [Bracket::of(0.0, self.0[0], 1.0, self.0[3]), None, None],
        };
        brackets.into_iter().flatten().map(move |bracket| bracket.solve(&cubic, solver))
    }

    /// Value and derivative, by de Casteljau's scheme.
    #[inline]
    pub(crate) fn value(&self, s: f32) -> (f32, f32) {
        let [a, b, c, d] = self.0;
        let (a, b, c) = (between(a, b, s), between(b, c, s), between(c, d, s));
        let (a, b) = (between(a, b, s), between(b, c, s));
        (between(a, b, s), 3.0 * (b - a))
    }

    /// How often the coefficients change between inside and outside.
    #[inline]
    fn changes(&self) -> u32 {
        let [a, b, c, d] = self.0.map(is_inside);
        u32::from(a != b) + u32::from(b != c) + u32::from(c != d)
    }

    #[inline]
    fn is_nan(&self) -> bool {
        let [a, b, c, d] = self.0;
        (a + b + c + d).is_nan()
    }

    /// The stretches between the ends and the extrema whose ends differ, in order.
    #[inline]
    fn brackets(&self) -> [Option<Bracket>; 3] {
        let [first, second] = self.extrema();
        let (at_first, at_second) = (self.value(first).0, self.value(second).0);
        [
            Bracket::of(0.0, self.0[0], first, at_first),
            Bracket::of(first, at_first, second, at_second),
            Bracket::of(second, at_second, 1.0, self.0[3]),
        ]
    }

    /// Where the derivative is 0, in order; one that is not between the ends is moved to one.
    #[inline]
    fn extrema(&self) -> [f32; 2] {
        // Made small first, so that squares do not overflow.
        let largest = self.0.map(f32::abs).into_iter().fold(0.0, max);
        let [a, b, c, d] = self.0.map(|x| x / largest);
        let (a, b, c) = (b - a, c - b, d - c);
        // The derivative is a (1 - s)^2 + 2 b s (1 - s) + c s^2, up to a factor.
        let under = b * b - a * c;
        if under <= 0.0 || under.is_nan() {
            return [0.0, 0.0];
        }
        let half = a - b;
        let root = libm::sqrtf(under);
        let q = if half < 0.0 { half - root } else { half + root };
        let (s, u) = (clamp(q / (half - (b - c))), clamp(a / q));
        if s < u { [s, u] } else { [u, s] }
    }
}

/// A stretch with one root, whose ends differ.
#[derive(Clone, Copy, Debug)]
struct Bracket {
    low: f32,
    at_low: f32,
    high: f32,
    at_high: f32,
}

impl Bracket {
    #[inline]
    fn of(low: f32, at_low: f32, high: f32, at_high: f32) -> Option<Self> {
        (is_inside(at_low) != is_inside(at_high)).then_some(Self { low, at_low, high, at_high })
    }

    #[inline]
    fn solve(self, cubic: &Cubic, solver: Solver) -> f32 {
        match solver {
            Solver::Linear => self.secant(),
            Solver::Neubauer | Solver::Marmitt => self.interpolate(cubic),
            Solver::MarmittNewton => self.newton(cubic),
            Solver::Bisect => self.bisect(cubic),
        }
    }

    /// Where the straight line between the ends is 0.
    #[inline]
    fn secant(&self) -> f32 {
        let step = (self.high - self.low) * (self.at_low / (self.at_low - self.at_high));
        self.keep(self.low + step)
    }

    #[inline]
    fn interpolate(mut self, cubic: &Cubic) -> f32 {
        for _ in 1..INTERPOLATIONS {
            let s = self.secant();
            self.close_in(s, cubic.value(s).0);
        }
        self.secant()
    }

    #[inline]
    fn newton(mut self, cubic: &Cubic) -> f32 {
        let (mut s, mut step) = (self.secant(), self.high - self.low);
        for _ in 0..NEWTON_STEPS {
            let (value, slope) = cubic.value(s);
            self.close_in(s, value);
            let next = s - value / slope;
            // The root is where the value crosses, which tells the slope there.
            let crosses = if is_inside(self.at_low) { slope < 0.0 } else { slope > 0.0 };
            if crosses && (next - s).abs() <= CLOSE {
                break;
            }
            // Halve where Newton has the wrong slope, leaves the bounds, or does not halve its step.
            let inside = crosses && self.low < next && next < self.high && (next - s).abs() * 2.0 <= step;
            let next = if inside { next } else { (self.low + self.high) * 0.5 };
            step = (next - s).abs();
            s = next;
        }
        s
    }

    #[inline]
    fn bisect(mut self, cubic: &Cubic) -> f32 {
        for _ in 0..HALVINGS {
            let s = (self.low + self.high) * 0.5;
            self.close_in(s, cubic.value(s).0);
        }
        (self.low + self.high) * 0.5
    }

    /// Makes `s` the end that it is like.
    #[inline]
    fn close_in(&mut self, s: f32, value: f32) {
        if is_inside(value) == is_inside(self.at_low) {
            (self.low, self.at_low) = (s, value);
        } else {
            (self.high, self.at_high) = (s, value);
        }
    }

    /// Brings a number between the ends; NaN becomes the lower.
    #[inline]
    fn keep(&self, s: f32) -> f32 {
        let s = if s > self.low { s } else { self.low };
        if s < self.high { s } else { self.high }
    }
}

impl Solver {
    /// Every solver.
    pub const ALL: [Self; 5] =
        [Self::Linear, Self::Neubauer, Self::Marmitt, Self::MarmittNewton, Self::Bisect];

    /// The name that [`FromStr`] takes.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Neubauer => "neubauer",
            Self::Marmitt => "marmitt",
            Self::MarmittNewton => "marmitt+newton",
            Self::Bisect => "bisect",
        }
    }

    /// Whether it finds roots that entry and exit do not tell of.
    #[inline]
    pub const fn isolates(self) -> bool {
        matches!(self, Self::Marmitt | Self::MarmittNewton | Self::Bisect)
    }

    /// The solver with this number in a frame.
    pub(crate) const fn from_bits(bits: u32) -> Option<Self> {
        match bits {
            0 => Some(Self::MarmittNewton),
            1 => Some(Self::Marmitt),
            2 => Some(Self::Neubauer),
            3 => Some(Self::Linear),
            4 => Some(Self::Bisect),
            _ => None,
        }
    }
}

/// There is no solver of that name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownSolver;

impl FromStr for Solver {
    type Err = UnknownSolver;

    fn from_str(name: &str) -> Result<Self, UnknownSolver> {
        Self::ALL.into_iter().find(|solver| solver.name() == name).ok_or(UnknownSolver)
    }
}

impl fmt::Display for Solver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl fmt::Display for UnknownSolver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("solvers are linear, neubauer, marmitt, marmitt+newton and bisect")
    }
}

impl core::error::Error for UnknownSolver {}

/// `(1 - w) a + w b`: between `a` and `b`, and of their sign where they have the same.
#[inline]
pub(crate) fn between(a: f32, b: f32, w: f32) -> f32 {
    a * (1.0 - w) + b * w
}

/// Whether a value less the isovalue is inside.
#[inline]
pub(crate) fn is_inside(value: f32) -> bool {
    value >= 0.0
}

#[inline]
fn max(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Brings a number into `0..=1`; NaN becomes 0.
#[inline]
fn clamp(s: f32) -> f32 {
    let s = if s > 0.0 { s } else { 0.0 };
    if s < 1.0 { s } else { 1.0 }
}

/// Linear interpolations of `neubauer` and `marmitt`.
pub(crate) const INTERPOLATIONS: u32 = 3;

/// A Newton step in this is the last: some ten-millionths of a cell.
pub(crate) const CLOSE: f32 = crate::scale::power_of_two(-22);

/// Most Newton steps of `marmitt+newton`.
pub(crate) const NEWTON_STEPS: u32 = 32;

/// Halvings of `bisect`: to the last bit of a number near 1.
pub(crate) const HALVINGS: u32 = 24;

#[cfg(test)]
mod tests {
    use super::*;

    /// The cubic through these values of a polynomial at 0, 1/3, 2/3 and 1 has these coefficients.
    fn from_roots(roots: [f64; 3], sign: f64) -> Cubic {
        // The blossom of the product of (s - r): the mean over the ways of giving three arguments to the factors.
        let factor = |argument: f64, root: usize| argument - roots[root];
        let ways = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        let blossom = |arguments: [f64; 3]| {
            let product = |way: &[usize; 3]| (0..3).map(|i| factor(arguments[i], way[i])).product::<f64>();
            ways.iter().map(product).sum::<f64>() / 6.0
        };
        let coefficients = [[0.0; 3], [0.0, 0.0, 1.0], [0.0, 1.0, 1.0], [1.0; 3]].map(blossom);
        #[expect(clippy::cast_possible_truncation, reason = "rounding is what it is for")]
        Cubic(coefficients.map(|x| (x * sign) as f32))
    }

    fn roots(cubic: &Cubic, solver: Solver) -> std::vec::Vec<f32> {
        cubic.roots(solver).collect()
    }

    #[test]
    fn three_roots_are_found_in_order() {
        for sign in [1.0, -1.0, 1.0e-30, 1.0e30] {
            let cubic = from_roots([0.2, 0.5, 0.9], sign);
            for solver in [Solver::MarmittNewton, Solver::Bisect, Solver::Marmitt] {
                let found = roots(&cubic, solver);
                let tolerance = if solver == Solver::Marmitt { 0.05 } else { 1.0e-5 };
                assert_eq!(found.len(), 3, "{solver} of {cubic:?}");
                for (found, root) in found.iter().zip([0.2, 0.5, 0.9]) {
                    assert!((found - root).abs() < tolerance, "{solver}: {found} for {root}");
                }
                assert_eq!(cubic.first_root(solver), Some(found[0]));
            }
        }
    }

    #[test]
    fn two_roots_between_equal_ends_are_found_by_those_that_isolate() {
        let cubic = from_roots([0.4, 0.6, 7.0], -1.0);
        assert!(is_inside(cubic.0[0]) && is_inside(cubic.0[3]));
        assert_eq!(roots(&cubic, Solver::MarmittNewton).len(), 2);
        assert_eq!(cubic.first_root(Solver::Neubauer), None);
        assert!((cubic.first_root(Solver::Bisect).expect("a root") - 0.4).abs() < 1.0e-6);
    }

    #[test]
    fn a_cubic_of_one_sign_has_no_root_and_one_with_different_ends_always_has() {
        for (coefficients, expected) in [
            ([0.0; 4], false),
            ([1.0e-38; 4], false),
            ([-1.0e-45; 4], false),
            ([3.0, 1.0, 0.0, 2.0], false),
            ([-0.5, -1.0, -3.0, -1.0e-30], false),
            ([-1.0, -1.0, -1.0, 0.0], true),
            ([0.0, 0.0, 0.0, -1.0e-45], true),
            ([-1.0e30, 1.0e-30, -1.0e-30, 1.0e30], true),
            ([f32::NAN, 1.0, -1.0, 1.0], false),
            ([-1.0, f32::NAN, 1.0, 1.0], false),
        ] {
            let cubic = Cubic(coefficients);
            for solver in Solver::ALL {
                let root = cubic.first_root(solver);
                assert_eq!(root.is_some(), expected, "{solver} of {coefficients:?}");
                assert!(root.is_none_or(|s| (0.0..=1.0).contains(&s)), "{solver}: {root:?}");
            }
        }
    }

    #[test]
    fn a_zero_from_which_the_value_rises_is_not_yet_the_root() {
        let leaving = Cubic([0.0, 1.0, 1.0, -1.0]);
        let entering = Cubic([-1.0, 2.0, -1.0, 0.0]);
        for solver in [Solver::MarmittNewton, Solver::Bisect] {
            let s = leaving.first_root(solver).expect("the value falls below");
            assert!((s - 0.7913).abs() < 1.0e-3, "{solver}: {s}");
            let s = entering.first_root(solver).expect("the value rises above");
            assert!(entering.value(s).0.abs() < 1.0e-6 && s < 0.5, "{solver}: {s}");
        }
    }

    #[test]
    fn a_plateau_is_left_where_it_ends() {
        let cubic = Cubic([0.0, 0.0, 0.0, -1.0]);
        for solver in Solver::ALL {
            let s = cubic.first_root(solver).expect("the end of the plateau");
            assert!(s <= 0.5, "{solver}: {s}");
        }
    }

    #[test]
    fn coefficients_keep_the_sign_of_the_samples_and_the_face() {
        let samples = [1.0e-30, 1.0e30, 2.0, 3.0e-12, 7.0, 1.0, 1.0e-30, 1.0e-30];
        let (from, to) = ([0.0, 0.25, 0.999_999_9], [1.0, 1.0e-7, 1.0]);
        for sign in [1.0, -1.0] {
            let cubic = Cubic::new(samples.map(|x: f32| x * sign), from, to);
            assert!(cubic.0.iter().all(|x| x * sign > 0.0), "{cubic:?}");
        }
        // The face x = 1 is the neighbour's face x = 0.
        let ours = [9.0, 0.1, -3.0, 0.7, 5.0, -0.3, 2.0, 0.2];
        let theirs = [0.1, 5.0, 0.7, -8.0, -0.3, 1.0, 0.2, 4.0];
        let crossing = [0.3, 0.77];
        let leaving = Cubic::new(ours, [0.1; 3], [1.0, crossing[0], crossing[1]]);
        let entering = Cubic::new(theirs, [0.0, crossing[0], crossing[1]], [0.9; 3]);
        assert_eq!(leaving.0[3].to_bits(), entering.0[0].to_bits());
    }

    #[test]
    fn the_cubic_is_the_trilinear_function_along_the_line() {
        let samples = [0.3, -0.7, 1.2, 0.1, -0.4, 0.9, -1.1, 0.6];
        let (from, to) = ([0.1, 0.9, 0.0], [0.8, 0.2, 1.0]);
        let cubic = Cubic::new(samples, from, to);
        for step in 0..=16 {
            let s = step as f32 / 16.0;
            let at = [0, 1, 2].map(|axis| between(from[axis], to[axis], s));
            let direct = Cubic::new(samples, at, at).0[0];
            assert!((cubic.value(s).0 - direct).abs() < 1.0e-6);
        }
    }

    #[test]
    fn names_are_read_back() {
        for solver in Solver::ALL {
            assert_eq!(solver.name().parse(), Ok(solver));
            assert_eq!(Solver::from_bits(solver as u32), Some(solver));
        }
        assert_eq!("newton".parse::<Solver>(), Err(UnknownSolver));
        assert_eq!(Solver::from_bits(5), None);
    }
}
