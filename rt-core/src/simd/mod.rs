//! Sixteen lanes at a time, in three instances that give the same bits: portable, AVX2, AVX-512.
//!
//! Kernels are written once, over [`Simd`], and always think in sixteen lanes: one register of AVX-512, two of
//! AVX2, an array elsewhere. Every operation is one that IEEE 754 rounds correctly, or moves bits about; there
//! is no fused multiply-add and no approximate reciprocal. So the instances cannot differ.
//!
//! [`Lanes`] says which instance is used. It is found out once, at run time, and can be forced to less.

/// An array of what `$body` makes of each of two, three or five.
///
/// In place of `array::map`: a closure is a function of its own, compiled without the instructions of the lanes.
macro_rules! each {
    (2: $array:expr, $x:pat => $body:expr) => {{
        let [a, b] = $array;
        [
            {
                let $x = a;
                $body
            },
            {
                let $x = b;
                $body
            },
        ]
    }};
    (3: $array:expr, $x:pat => $body:expr) => {{
        let [a, b, c] = $array;
        [
            {
                let $x = a;
                $body
            },
            {
                let $x = b;
                $body
            },
            {
                let $x = c;
                $body
            },
        ]
    }};
    (4: $array:expr, $x:pat => $body:expr) => {{
        let [a, b, c, d] = $array;
        [
            {
                let $x = a;
                $body
            },
            {
                let $x = b;
                $body
            },
            {
                let $x = c;
                $body
            },
            {
                let $x = d;
                $body
            },
        ]
    }};
}
pub(crate) use each;

#[cfg(all(target_arch = "x86_64", feature = "lanes-avx2"))]
mod avx2;
#[cfg(all(target_arch = "x86_64", feature = "lanes-avx512"))]
mod avx512;
#[cfg(all(target_arch = "x86_64", any(feature = "lanes-avx2", feature = "lanes-avx512")))]
mod detect;
mod portable;
mod prefetch;
#[cfg(test)]
mod tests;

use core::fmt;
use core::str::FromStr;

use portable::Portable;
pub(crate) use prefetch::prefetch;

/// Sixteen bits, one for each lane, the lowest for the first.
pub(crate) type Mask = u16;

/// How many lanes there are.
pub(crate) const LANES: usize = 16;

/// A mask of the first `count` lanes, or of all.
#[inline(always)]
pub(crate) const fn first_lanes(count: usize) -> Mask {
    if count >= LANES { Mask::MAX } else { (1 << count) - 1 }
}

/// The bits that number the entries of a table whose length is a power of two.
const fn low_bits(length: usize) -> i32 {
    assert!(length.is_power_of_two() && length <= 1 << 30, "a table that `gather` can look into");
    #[expect(clippy::cast_possible_truncation, clippy::cast_possible_wrap, reason = "at most 2^30")]
    let bits = (length - 1) as i32;
    bits
}

/// The number of the last entry of such a table that has a next one.
const fn last_of_two(length: usize) -> i32 {
    low_bits(length) - 1
}

/// Operations on sixteen lanes. The value is the proof that the processor has them.
///
/// `min`, `max` and comparisons treat NaN as the x86 instructions do: `min` and `max` give the second operand,
/// comparisons are false.
#[cfg_attr(not(feature = "volumes"), allow(dead_code, reason = "some operations are for volumes alone"))]
pub(crate) trait Simd: Copy {
    /// Sixteen `f32`.
    type F: Copy;
    /// Sixteen 32-bit integers.
    type I: Copy;
    /// Sixteen `f64`.
    type D: Copy;
    /// A mask of sixteen `f64`, in whichever form they are compared and selected.
    type M: Copy;

    /// Runs a part of a task as a function of its own. Large bodies of code that are used together leave each other too
    /// few registers; this keeps hot loops apart.
    fn apart<T: Part<Self>>(self, part: T) -> T::Output;

    fn splat(self, value: f32) -> Self::F;
    fn load(self, from: &[f32; LANES]) -> Self::F;
    /// Up to sixteen little-endian `f32`; lanes beyond are 0.
    fn load_le(self, from: &[[u8; 4]]) -> Self::F;
    fn store(self, value: Self::F, to: &mut [f32; LANES]);
    fn add(self, a: Self::F, b: Self::F) -> Self::F;
    fn sub(self, a: Self::F, b: Self::F) -> Self::F;
    fn mul(self, a: Self::F, b: Self::F) -> Self::F;
    fn div(self, a: Self::F, b: Self::F) -> Self::F;
    fn min(self, a: Self::F, b: Self::F) -> Self::F;
    fn max(self, a: Self::F, b: Self::F) -> Self::F;
    fn abs(self, a: Self::F) -> Self::F;
    fn sqrt(self, a: Self::F) -> Self::F;
    fn lt(self, a: Self::F, b: Self::F) -> Mask;
    fn le(self, a: Self::F, b: Self::F) -> Mask;
    /// The lanes of `yes` where the mask is set, else those of `no`.
    fn select(self, mask: Mask, yes: Self::F, no: Self::F) -> Self::F;
    /// The smallest lane.
    fn least(self, a: Self::F) -> f32;
    /// For each lane, the entry of the table of 32 that the low five bits of the index name.
    fn pick_of_two(self, table: [Self::F; 2], index: Self::I) -> Self::F;
    /// For each lane, the entry of a table that the low bits of the index name; its length is a power of two.
    fn gather<const N: usize>(self, table: &[f32; N], index: Self::I) -> Self::F;
    /// The same, and the entries that follow them; for an index of the last entry, anything.
    fn gather_pairs<const N: usize>(self, table: &[f32; N], index: Self::I) -> [Self::F; 2];
    /// Moves the lanes of the mask together to the front; what is behind them is anything.
    fn store_packed(self, mask: Mask, value: Self::F, to: &mut [f32; LANES]);

    /// Fills the lanes of the mask from the front of an array, lowest first.
    #[inline(always)]
    fn load_spread(self, mask: Mask, from: &[f32; LANES], otherwise: Self::F) -> Self::F {
        let mut lanes = self.array(otherwise);
        spread(mask, from, &mut lanes);
        self.load(&lanes)
    }
    /// The same for `f64`.
    #[inline(always)]
    fn load_spread_f64(self, mask: Mask, from: &[f64; LANES], otherwise: Self::D) -> Self::D {
        let mut lanes = self.array_f64(otherwise);
        spread(mask, from, &mut lanes);
        self.load_f64(&lanes)
    }
    /// [`store_packed`](Self::store_packed) for `f64`.
    #[inline(always)]
    fn store_packed_f64(self, mask: Mask, value: Self::D, to: &mut [f64; LANES]) {
        let mut count = 0;
        for (lane, value) in self.array_f64(value).into_iter().enumerate() {
            to[count % LANES] = value;
            count += usize::from(mask >> lane & 1);
            // Only a full mask gets to the end, and only with the last lane.
            count = count.min(LANES - 1);
        }
    }

    /// Up to sixteen bytes as integers; lanes beyond are 0.
    fn bytes(self, from: &[u8]) -> Self::I;
    /// Cuts off the fraction. The values lie within ±2^30.
    fn to_int(self, value: Self::F) -> Self::I;
    fn to_float(self, value: Self::I) -> Self::F;
    fn store_int(self, value: Self::I, to: &mut [i32; LANES]);
    /// Shifts right; the values are not negative.
    fn shift_right<const BITS: u32>(self, a: Self::I) -> Self::I;

    fn widen(self, a: Self::F) -> Self::D;
    /// Rounds to single precision.
    fn narrow(self, a: Self::D) -> Self::F;
    fn add_f64(self, a: Self::D, b: Self::D) -> Self::D;
    fn sub_f64(self, a: Self::D, b: Self::D) -> Self::D;
    fn mul_f64(self, a: Self::D, b: Self::D) -> Self::D;
    fn div_f64(self, a: Self::D, b: Self::D) -> Self::D;
    fn sqrt_f64(self, a: Self::D) -> Self::D;
    fn splat_f64(self, value: f64) -> Self::D;
    fn load_f64(self, from: &[f64; LANES]) -> Self::D;
    fn store_f64(self, value: Self::D, to: &mut [f64; LANES]);
    fn min_f64(self, a: Self::D, b: Self::D) -> Self::D;
    fn max_f64(self, a: Self::D, b: Self::D) -> Self::D;
    /// Rounds to a whole number, downwards.
    fn floor_f64(self, a: Self::D) -> Self::D;
    fn eq_f64(self, a: Self::D, b: Self::D) -> Self::M;
    fn lt_f64(self, a: Self::D, b: Self::D) -> Self::M;
    fn le_f64(self, a: Self::D, b: Self::D) -> Self::M;
    fn select_f64(self, mask: Self::M, yes: Self::D, no: Self::D) -> Self::D;
    /// The sum where the mask is set, else `a`.
    fn add_where_f64(self, mask: Self::M, a: Self::D, b: Self::D) -> Self::D;
    fn wide_mask(self, mask: Mask) -> Self::M;
    fn narrow_mask(self, mask: Self::M) -> Mask;
    /// Where both masks are set.
    fn both(self, a: Self::M, b: Self::M) -> Self::M;
    /// Where the first is set and the second is not.
    fn except(self, a: Self::M, b: Self::M) -> Self::M;

    fn splat_int(self, value: i32) -> Self::I;
    fn select_int(self, mask: Mask, yes: Self::I, no: Self::I) -> Self::I;
    /// The sum where the mask is set, else `a`.
    fn add_where_int(self, mask: Mask, a: Self::I, b: Self::I) -> Self::I;
    /// The same by a mask of sixteen `f64`.
    fn add_where_int_wide(self, mask: Self::M, a: Self::I, b: Self::I) -> Self::I;
    /// The lanes whose bit is set: that of 512 which the low nine bits of the index name.
    fn bits_of(self, table: &[u64; 8], index: Self::I) -> Mask;

    /// [`pick_of_two`](Self::pick_of_two) from memory.
    #[inline(always)]
    fn lookup(self, table: &[[f32; LANES]; 2], index: Self::I) -> Self::F {
        self.pick_of_two([self.load(&table[0]), self.load(&table[1])], index)
    }

    /// `a x + b y + c z`, added in this order.
    #[inline(always)]
    fn dot(self, [a, b, c]: [Self::F; 3], [x, y, z]: [Self::F; 3]) -> Self::F {
        self.add(self.add(self.mul(a, x), self.mul(b, y)), self.mul(c, z))
    }

    #[inline(always)]
    fn array(self, value: Self::F) -> [f32; LANES] {
        let mut lanes = [0.0; LANES];
        self.store(value, &mut lanes);
        lanes
    }

    /// Lanes that are 0, of either sign.
    #[inline(always)]
    fn is_zero_f64(self, a: Self::D) -> Mask {
        self.narrow_mask(self.eq_f64(a, self.splat_f64(0.0)))
    }

    #[inline(always)]
    fn array_f64(self, value: Self::D) -> [f64; LANES] {
        let mut lanes = [0.0; LANES];
        self.store_f64(value, &mut lanes);
        lanes
    }

    #[inline(always)]
    fn int_array(self, value: Self::I) -> [i32; LANES] {
        let mut lanes = [0; LANES];
        self.store_int(value, &mut lanes);
        lanes
    }

    #[inline(always)]
    fn splat3(self, value: glam::Vec3) -> [Self::F; 3] {
        [self.splat(value.x), self.splat(value.y), self.splat(value.z)]
    }

    #[inline(always)]
    fn min3(self, [a, b, c]: [Self::F; 3]) -> Self::F {
        self.min(self.min(a, b), c)
    }

    #[inline(always)]
    fn max3(self, [a, b, c]: [Self::F; 3]) -> Self::F {
        self.max(self.max(a, b), c)
    }
}

/// Fills the lanes of the mask from the front of an array, lowest first.
#[inline(always)]
fn spread<T: Copy>(mask: Mask, from: &[T; LANES], lanes: &mut [T; LANES]) {
    let mut next = 0;
    for (lane, to) in lanes.iter_mut().enumerate() {
        if mask >> lane & 1 != 0 {
            *to = from[next % LANES];
            next += 1;
        }
    }
}

/// What is to be done with sixteen lanes, whichever they are.
///
/// Implementations of `run`, and all that it calls, are inlined, so that they are compiled with the instructions
/// of the instance.
pub(crate) trait Task {
    type Output;
    fn run<S: Simd>(self, s: S) -> Self::Output;
}

/// A part of a task, for lanes that are known.
pub(crate) trait Part<S> {
    type Output;
    fn run(self, s: S) -> Self::Output;
}

/// The instance of the kernels: which instructions sixteen lanes are made of. All give the same bits.
///
/// A value exists only for instructions that this processor has.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Lanes(Kind);

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Kind {
    Portable,
    #[cfg(all(target_arch = "x86_64", feature = "lanes-avx2"))]
    Avx2,
    #[cfg(all(target_arch = "x86_64", feature = "lanes-avx512"))]
    Avx512,
}

/// Why lanes were refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum LanesError {
    /// There are no lanes of that name.
    Unknown,
    /// This processor does not have these instructions.
    Absent,
    /// The lanes were left out of this build; the feature that brings them.
    LeftOut(&'static str),
}

impl Lanes {
    /// Plain arrays, on any processor.
    pub const PORTABLE: Self = Self(Kind::Portable);

    /// The widest lanes that this processor has. Asks the processor; keep the answer.
    pub fn widest() -> Self {
        Self::available().last().unwrap_or(Self::PORTABLE)
    }

    /// All lanes that this processor has, narrowest first.
    pub fn available() -> impl Iterator<Item = Self> {
        ALL.iter().copied().filter(|lanes| lanes.is_available())
    }

    /// The name that [`FromStr`] takes.
    pub const fn name(self) -> &'static str {
        match self.0 {
            Kind::Portable => "portable",
            #[cfg(all(target_arch = "x86_64", feature = "lanes-avx2"))]
            Kind::Avx2 => "avx2",
            #[cfg(all(target_arch = "x86_64", feature = "lanes-avx512"))]
            Kind::Avx512 => "avx512",
        }
    }

    fn is_available(self) -> bool {
        match self.0 {
            Kind::Portable => true,
            #[cfg(all(target_arch = "x86_64", feature = "lanes-avx2"))]
            Kind::Avx2 => detect::has_avx2(),
            #[cfg(all(target_arch = "x86_64", feature = "lanes-avx512"))]
            Kind::Avx512 => detect::has_avx512(),
        }
    }

    /// Runs a task with these lanes.
    #[inline]
    pub(crate) fn run<T: Task>(self, task: T) -> T::Output {
        match self.0 {
            Kind::Portable => task.run(Portable),
            #[cfg(all(target_arch = "x86_64", feature = "lanes-avx2"))]
            Kind::Avx2 => avx2::run(task, self.0),
            #[cfg(all(target_arch = "x86_64", feature = "lanes-avx512"))]
            Kind::Avx512 => avx512::run(task, self.0),
        }
    }
}

const ALL: &[Lanes] = &[
    Lanes(Kind::Portable),
    #[cfg(all(target_arch = "x86_64", feature = "lanes-avx2"))]
    Lanes(Kind::Avx2),
    #[cfg(all(target_arch = "x86_64", feature = "lanes-avx512"))]
    Lanes(Kind::Avx512),
];

impl FromStr for Lanes {
    type Err = LanesError;

    fn from_str(name: &str) -> Result<Self, LanesError> {
        let missing = match name {
            "avx2" => LanesError::LeftOut("lanes-avx2"),
            "avx512" => LanesError::LeftOut("lanes-avx512"),
            _ => LanesError::Unknown,
        };
        let lanes = ALL.iter().copied().find(|lanes| lanes.name() == name).ok_or(missing)?;
        if lanes.is_available() { Ok(lanes) } else { Err(LanesError::Absent) }
    }
}

impl fmt::Display for Lanes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl fmt::Debug for Lanes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Lanes({self})")
    }
}

impl fmt::Display for LanesError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown => f.write_str("lanes are portable, avx2 or avx512"),
            Self::Absent => f.write_str("this processor does not have these instructions"),
            Self::LeftOut(feature) => {
                write!(f, "these lanes were left out of this build; enable the feature {feature}")
            }
        }
    }
}

impl core::error::Error for LanesError {}
