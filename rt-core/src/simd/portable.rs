//! Sixteen lanes as arrays: the plain version, and the reference of the others.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "conversions are what is asked for; indices are masked"
)]

use glam::{BVec4A, Vec4};

use super::{LANES, Mask, Part, Simd, last_of_two, low_bits};

/// Plain arrays.
///
/// Operations that become dozens of instructions are functions: inlined, they made the plain kernels more than half of all
/// kernels' code, and that takes its time to compile.
#[derive(Clone, Copy)]
pub(super) struct Portable;

#[inline(never)]
fn run_apart<T: Part<Portable>>(part: T, s: Portable) -> T::Output {
    part.run(s)
}

#[inline(always)]
fn map<A: Copy, B: Copy, R>(a: [A; LANES], b: [B; LANES], of: impl Fn(A, B) -> R) -> [R; LANES] {
    core::array::from_fn(|lane| of(a[lane], b[lane]))
}

/// What `of` says of four lanes at a time, as a mask. Four are what every processor compares at once.
#[inline(always)]
fn mask(a: [f32; LANES], b: [f32; LANES], of: impl Fn(Vec4, Vec4) -> BVec4A) -> Mask {
    let four = |lanes: &[f32; LANES], first: usize| Vec4::from_slice(&lanes[first..first + 4]);
    [0, 4, 8, 12]
        .into_iter()
        .fold(0, |mask, first| mask | (of(four(&a, first), four(&b, first)).bitmask() as Mask) << first)
}

impl Simd for Portable {
    type F = [f32; LANES];
    type I = [i32; LANES];
    type D = [f64; LANES];
    type M = Mask;

    #[inline(always)]
    fn apart<T: Part<Self>>(self, part: T) -> T::Output {
        run_apart(part, self)
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Self::F {
        [value; LANES]
    }

    #[inline(always)]
    fn load(self, from: &[f32; LANES]) -> Self::F {
        *from
    }

    #[inline(never)]
    fn load_le(self, from: &[[u8; 4]]) -> Self::F {
        let mut lanes = [0.0; LANES];
        lanes.iter_mut().zip(from).for_each(|(lane, &bytes)| *lane = f32::from_le_bytes(bytes));
        lanes
    }

    #[inline(always)]
    fn store(self, value: Self::F, to: &mut [f32; LANES]) {
        *to = value;
    }

    #[inline(always)]
    fn add(self, a: Self::F, b: Self::F) -> Self::F {
        map(a, b, |a, b| a + b)
    }

    #[inline(always)]
    fn sub(self, a: Self::F, b: Self::F) -> Self::F {
        map(a, b, |a, b| a - b)
    }

    #[inline(always)]
    fn mul(self, a: Self::F, b: Self::F) -> Self::F {
        map(a, b, |a, b| a * b)
    }

    #[inline(always)]
    fn div(self, a: Self::F, b: Self::F) -> Self::F {
        map(a, b, |a, b| a / b)
    }

    #[inline(always)]
    fn min(self, a: Self::F, b: Self::F) -> Self::F {
        map(a, b, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    fn max(self, a: Self::F, b: Self::F) -> Self::F {
        map(a, b, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    fn abs(self, a: Self::F) -> Self::F {
        a.map(f32::abs)
    }

    #[inline(never)]
    fn sqrt(self, a: Self::F) -> Self::F {
        a.map(libm::sqrtf)
    }

    #[inline(always)]
    fn lt(self, a: Self::F, b: Self::F) -> Mask {
        mask(a, b, Vec4::cmplt)
    }

    #[inline(always)]
    fn le(self, a: Self::F, b: Self::F) -> Mask {
        mask(a, b, Vec4::cmple)
    }

    #[inline(never)]
    fn select(self, mask: Mask, yes: Self::F, no: Self::F) -> Self::F {
        core::array::from_fn(|lane| if mask >> lane & 1 != 0 { yes[lane] } else { no[lane] })
    }

    #[inline(never)]
    fn least(self, a: Self::F) -> f32 {
        a.into_iter().fold(f32::INFINITY, |least, lane| if lane < least { lane } else { least })
    }

    #[inline(never)]
    fn gather<const N: usize>(self, table: &[f32; N], index: Self::I) -> Self::F {
        index.map(|index| table[(index & const { low_bits(N) }) as usize])
    }

    #[inline(never)]
    fn gather_pairs<const N: usize>(self, table: &[f32; N], index: Self::I) -> [Self::F; 2] {
        let index = index.map(|index| (index & const { low_bits(N) }).min(const { last_of_two(N) }) as usize);
        [index.map(|index| table[index]), index.map(|index| table[index + 1])]
    }

    #[inline(never)]
    fn pick_of_two(self, table: [Self::F; 2], index: Self::I) -> Self::F {
        let table = table.as_flattened();
        index.map(|index| table[(index & 31) as usize])
    }

    #[inline(never)]
    fn store_packed(self, mask: Mask, value: Self::F, to: &mut [f32; LANES]) {
        let mut count = 0;
        for (lane, value) in value.into_iter().enumerate() {
            to[count] = value;
            count += usize::from(mask >> lane & 1);
            // Only a full mask gets to the end, and only with the last lane.
            count = count.min(LANES - 1);
        }
    }

    #[inline(never)]
    fn bytes(self, from: &[u8]) -> Self::I {
        let mut lanes = [0; LANES];
        lanes.iter_mut().zip(from).for_each(|(lane, &byte)| *lane = i32::from(byte));
        lanes
    }

    #[inline(never)]
    fn to_int(self, value: Self::F) -> Self::I {
        value.map(|value| value as i32)
    }

    #[inline(always)]
    fn to_float(self, value: Self::I) -> Self::F {
        value.map(|value| value as f32)
    }

    #[inline(always)]
    fn store_int(self, value: Self::I, to: &mut [i32; LANES]) {
        *to = value;
    }

    #[inline(always)]
    fn shift_right<const BITS: u32>(self, a: Self::I) -> Self::I {
        a.map(|a| a >> BITS)
    }

    #[inline(never)]
    fn widen(self, a: Self::F) -> Self::D {
        a.map(f64::from)
    }

    #[inline(never)]
    fn narrow(self, a: Self::D) -> Self::F {
        a.map(|a| a as f32)
    }

    // Functions of their own from here on: there is much code of sixteen lanes of 64 bits, and calling it takes little
    // more time than doing it.
    #[inline(never)]
    fn add_f64(self, a: Self::D, b: Self::D) -> Self::D {
        map(a, b, |a, b| a + b)
    }

    #[inline(never)]
    fn sub_f64(self, a: Self::D, b: Self::D) -> Self::D {
        map(a, b, |a, b| a - b)
    }

    #[inline(never)]
    fn mul_f64(self, a: Self::D, b: Self::D) -> Self::D {
        map(a, b, |a, b| a * b)
    }

    #[inline(never)]
    fn div_f64(self, a: Self::D, b: Self::D) -> Self::D {
        map(a, b, |a, b| a / b)
    }

    #[inline(never)]
    fn sqrt_f64(self, a: Self::D) -> Self::D {
        a.map(libm::sqrt)
    }

    #[inline(never)]
    fn eq_f64(self, a: Self::D, b: Self::D) -> Mask {
        (0..LANES).fold(0, |mask, lane| mask | Mask::from(a[lane] == b[lane]) << lane)
    }

    #[inline(always)]
    fn splat_f64(self, value: f64) -> Self::D {
        [value; LANES]
    }

    #[inline(always)]
    fn load_f64(self, from: &[f64; LANES]) -> Self::D {
        *from
    }

    #[inline(always)]
    fn store_f64(self, value: Self::D, to: &mut [f64; LANES]) {
        *to = value;
    }

    #[inline(never)]
    fn min_f64(self, a: Self::D, b: Self::D) -> Self::D {
        map(a, b, |a, b| if a < b { a } else { b })
    }

    #[inline(never)]
    fn max_f64(self, a: Self::D, b: Self::D) -> Self::D {
        map(a, b, |a, b| if a > b { a } else { b })
    }

    #[inline(never)]
    fn floor_f64(self, a: Self::D) -> Self::D {
        a.map(libm::floor)
    }

    #[inline(never)]
    fn lt_f64(self, a: Self::D, b: Self::D) -> Mask {
        (0..LANES).fold(0, |mask, lane| mask | Mask::from(a[lane] < b[lane]) << lane)
    }

    #[inline(never)]
    fn le_f64(self, a: Self::D, b: Self::D) -> Mask {
        (0..LANES).fold(0, |mask, lane| mask | Mask::from(a[lane] <= b[lane]) << lane)
    }

    #[inline(never)]
    fn select_f64(self, mask: Mask, yes: Self::D, no: Self::D) -> Self::D {
        core::array::from_fn(|lane| if mask >> lane & 1 != 0 { yes[lane] } else { no[lane] })
    }

    #[inline(never)]
    fn add_where_f64(self, mask: Mask, a: Self::D, b: Self::D) -> Self::D {
        self.select_f64(mask, self.add_f64(a, b), a)
    }

    #[inline(always)]
    fn splat_int(self, value: i32) -> Self::I {
        [value; LANES]
    }

    #[inline(never)]
    fn select_int(self, mask: Mask, yes: Self::I, no: Self::I) -> Self::I {
        core::array::from_fn(|lane| if mask >> lane & 1 != 0 { yes[lane] } else { no[lane] })
    }

    #[inline(never)]
    fn add_where_int(self, mask: Mask, a: Self::I, b: Self::I) -> Self::I {
        self.select_int(mask, map(a, b, i32::wrapping_add), a)
    }

    #[inline(always)]
    fn add_where_int_wide(self, mask: Mask, a: Self::I, b: Self::I) -> Self::I {
        self.add_where_int(mask, a, b)
    }

    #[inline(never)]
    fn bits_of(self, table: &[u64; 8], index: Self::I) -> Mask {
        let is_set = |index: i32| table[(index >> 6 & 7) as usize] >> (index & 63) & 1 != 0;
        (0..LANES).fold(0, |mask, lane| mask | Mask::from(is_set(index[lane])) << lane)
    }

    #[inline(always)]
    fn wide_mask(self, mask: Mask) -> Mask {
        mask
    }

    #[inline(always)]
    fn narrow_mask(self, mask: Mask) -> Mask {
        mask
    }

    #[inline(always)]
    fn both(self, a: Mask, b: Mask) -> Mask {
        a & b
    }

    #[inline(always)]
    fn except(self, a: Mask, b: Mask) -> Mask {
        a & !b
    }
}
