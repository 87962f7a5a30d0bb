//! Exact signs of determinants of `f32` numbers.
//!
//! # Source
//! Shewchuk, "Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates", Discrete &
//! Computational Geometry 18(3), 1997: a number as a sum of `f64` that do not overlap, and a cheap filter
//! before it.

/// Sign of the determinant of the rows `direction`, `p - origin`, `q - origin`: -1, 0 or 1, exactly.
///
/// # Edge cases
/// Coordinates are finite, and products of three neither overflow `f64` nor fall below 1e-290.
pub fn side(direction: [f32; 3], p: [f32; 3], q: [f32; 3], origin: [f32; 3]) -> i32 {
    let rough = Rough::new(direction, p, q, origin);
    if rough.value.abs() > rough.error {
        return if rough.value > 0.0 { 1 } else { -1 };
    }
    let mut sum = Expansion::default();
    for (i, j, k, sign) in PERMUTATIONS {
        let d = f64::from(direction[i]) * sign;
        let (p, q) = (f64::from(p[j]), f64::from(q[k]));
        let (op, oq) = (f64::from(origin[j]), f64::from(origin[k]));
        // The products of two origins cancel over the permutations.
        for (factor, last) in [(p, q), (-p, oq), (-op, q)] {
            sum.add_product(d * factor, last);
        }
    }
    sum.sign()
}

/// A determinant in `f64`, and a bound of its error.
struct Rough {
    value: f64,
    error: f64,
}

impl Rough {
    fn new(direction: [f32; 3], p: [f32; 3], q: [f32; 3], origin: [f32; 3]) -> Self {
        let from_origin = |v: [f32; 3]| [0, 1, 2].map(|axis| f64::from(v[axis]) - f64::from(origin[axis]));
        let (d, p, q) = (direction.map(f64::from), from_origin(p), from_origin(q));
        let terms = PERMUTATIONS.map(|(i, j, k, sign)| sign * d[i] * p[j] * q[k]);
        let size: f64 = terms.iter().map(|term| term.abs()).sum();
        // A term rounds four times, and their sum five.
        Self { value: terms.iter().sum(), error: size * (10.0 * f64::EPSILON) }
    }
}

/// A number as the exact sum of `f64`, smallest first.
#[derive(Default)]
struct Expansion(Vec<f64>);

impl Expansion {
    /// Adds `a * b`, exactly.
    fn add_product(&mut self, a: f64, b: f64) {
        let product = a * b;
        self.add(a.mul_add(b, -product));
        self.add(product);
    }

    /// Shewchuk's GROW-EXPANSION, zeros dropped.
    fn add(&mut self, value: f64) {
        let mut carry = value;
        let parts = core::mem::take(&mut self.0);
        for part in parts {
            let sum = carry + part;
            let virtual_part = sum - carry;
            let error = (carry - (sum - virtual_part)) + (part - virtual_part);
            if error != 0.0 {
                self.0.push(error);
            }
            carry = sum;
        }
        if carry != 0.0 {
            self.0.push(carry);
        }
    }

    /// The sign is that of the largest part.
    fn sign(&self) -> i32 {
        self.0.last().map_or(0, |&largest| if largest > 0.0 { 1 } else { -1 })
    }
}

const PERMUTATIONS: [(usize, usize, usize, f64); 6] =
    [(0, 1, 2, 1.0), (1, 2, 0, 1.0), (2, 0, 1, 1.0), (0, 2, 1, -1.0), (1, 0, 2, -1.0), (2, 1, 0, -1.0)];
