//! Sixteen lanes as two registers of AVX2.
#![allow(unsafe_code, reason = "intrinsics; every call is made through `with!`, which holds the argument")]

use core::arch::x86_64::*;

use super::{Kind, LANES, Mask, Part, Simd, Task, last_of_two, low_bits};

/// The proof that the processor has AVX2.
#[derive(Clone, Copy)]
pub(super) struct Avx2(());

/// Runs a task compiled for these instructions.
#[inline]
pub(super) fn run<T: Task>(task: T, kind: Kind) -> T::Output {
    assert!(kind == Kind::Avx2, "lanes that were found out to be there");
    // SAFETY: a `Kind` of this name stands only in a `Lanes`, which exists only where `detect` found the instructions.
    unsafe { run_there(task) }
}

#[target_feature(enable = "avx2,bmi1,popcnt")]
fn run_there<T: Task>(task: T) -> T::Output {
    task.run(Avx2(()))
}

#[target_feature(enable = "avx2,bmi1,popcnt")]
#[inline(never)]
fn run_apart<T: Part<Avx2>>(part: T, s: Avx2) -> T::Output {
    part.run(s)
}

/// An intrinsic.
macro_rules! with {
    ($call:expr) => {
        // SAFETY: an `Avx2` exists only inside `run_there`, where the processor has these instructions. Those that take
        // a pointer get one from a reference to as many bytes as they touch.
        unsafe { $call }
    };
}

/// Both halves of the lanes.
macro_rules! both {
    ($of:ident($($a:ident),*)) => { [with!($of($($a[0]),*)), with!($of($($a[1]),*))] };
}

/// The sign bits of both halves.
#[inline(always)]
#[expect(clippy::cast_sign_loss, clippy::cast_possible_truncation, reason = "eight bits each")]
fn signs([low, high]: [__m256; 2]) -> Mask {
    with!(_mm256_movemask_ps(low)) as Mask | (with!(_mm256_movemask_ps(high)) as Mask) << 8
}

/// Up to eight little-endian `f32`; lanes beyond are 0.
#[inline(always)]
fn eight(bytes: &[[u8; 4]]) -> __m256 {
    if let Some(bytes) = bytes.first_chunk::<8>() {
        return with!(_mm256_loadu_ps(bytes.as_ptr().cast()));
    }
    let mut lanes = [[0; 4]; 8];
    for (lane, bytes) in lanes.iter_mut().zip(bytes) {
        *lane = *bytes;
    }
    with!(_mm256_loadu_ps(lanes.as_ptr().cast()))
}

/// All ones where a bit of the mask is set, eight bits from `shift` on.
#[inline(always)]
fn widened(mask: Mask, shift: u32) -> __m256 {
    let all = with!(_mm256_set1_epi32(i32::from(mask >> shift & 0xff)));
    let own = with!(_mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128));
    let met = with!(_mm256_and_si256(all, own));
    let met = with!(_mm256_cmpeq_epi32(met, own));
    with!(_mm256_castsi256_ps(met))
}

/// Eight entries of a table of 32.
#[inline(always)]
fn look_up(parts: [__m256; 4], index: __m256i) -> __m256 {
    let parts = each!(4: parts, part => with!(_mm256_permutevar8x32_ps(part, index)));
    // Bits 3 and 4 of the index, brought to the sign.
    let third = with!(_mm256_slli_epi32::<28>(index));
    let fourth = with!(_mm256_slli_epi32::<27>(index));
    let third = with!(_mm256_castsi256_ps(third));
    let fourth = with!(_mm256_castsi256_ps(fourth));
    let low = with!(_mm256_blendv_ps(parts[0], parts[1], third));
    let high = with!(_mm256_blendv_ps(parts[2], parts[3], third));
    with!(_mm256_blendv_ps(low, high, fourth))
}

/// Eight lanes, those of the mask moved to the front.
#[inline(always)]
fn packed(mask: Mask, value: __m256) -> __m256 {
    let order = PACKED[usize::from(mask & 0xff)];
    let order = with!(_mm_loadl_epi64(order.as_ptr().cast()));
    let order = with!(_mm256_cvtepu8_epi32(order));
    with!(_mm256_permutevar8x32_ps(value, order))
}

/// For each eight bits, the places of those that are set, lowest first, then zeros.
const PACKED: [[u8; 8]; 256] = {
    let mut packed = [[0; 8]; 256];
    let mut mask = 0;
    while mask < 256 {
        let (mut lane, mut count) = (0, 0);
        while lane < 8 {
            if mask >> lane & 1 != 0 {
                packed[mask][count] = lane;
                count += 1;
            }
            lane += 1;
        }
        mask += 1;
    }
    packed
};

/// Two halves of an array.
#[inline(always)]
fn halves<T>(array: &[T; LANES]) -> [&[T; 8]; 2] {
    let (halves, _) = array.as_chunks();
    [&halves[0], &halves[1]]
}

impl Simd for Avx2 {
    type F = [__m256; 2];
    type I = [__m256i; 2];
    type D = [__m256d; 4];
    type M = [__m256d; 4];

    #[inline(always)]
    fn apart<T: Part<Self>>(self, part: T) -> T::Output {
        with!(run_apart(part, self))
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Self::F {
        [with!(_mm256_set1_ps(value)); 2]
    }

    #[inline(always)]
    fn load(self, from: &[f32; LANES]) -> Self::F {
        each!(2: halves(from), half => with!(_mm256_loadu_ps(half.as_ptr())))
    }

    #[inline(always)]
    fn load_le(self, from: &[[u8; 4]]) -> Self::F {
        [eight(from), eight(from.get(8..).unwrap_or_default())]
    }

    #[inline(always)]
    fn store(self, value: Self::F, to: &mut [f32; LANES]) {
        let (halves, _) = to.as_chunks_mut::<8>();
        with!(_mm256_storeu_ps(halves[0].as_mut_ptr(), value[0]));
        with!(_mm256_storeu_ps(halves[1].as_mut_ptr(), value[1]));
    }

    #[inline(always)]
    fn add(self, a: Self::F, b: Self::F) -> Self::F {
        both!(_mm256_add_ps(a, b))
    }

    #[inline(always)]
    fn sub(self, a: Self::F, b: Self::F) -> Self::F {
        both!(_mm256_sub_ps(a, b))
    }

    #[inline(always)]
    fn mul(self, a: Self::F, b: Self::F) -> Self::F {
        both!(_mm256_mul_ps(a, b))
    }

    #[inline(always)]
    fn div(self, a: Self::F, b: Self::F) -> Self::F {
        both!(_mm256_div_ps(a, b))
    }

    #[inline(always)]
    fn min(self, a: Self::F, b: Self::F) -> Self::F {
        both!(_mm256_min_ps(a, b))
    }

    #[inline(always)]
    fn max(self, a: Self::F, b: Self::F) -> Self::F {
        both!(_mm256_max_ps(a, b))
    }

    #[inline(always)]
    fn abs(self, a: Self::F) -> Self::F {
        let sign = [with!(_mm256_set1_ps(-0.0)); 2];
        both!(_mm256_andnot_ps(sign, a))
    }

    #[inline(always)]
    fn sqrt(self, a: Self::F) -> Self::F {
        both!(_mm256_sqrt_ps(a))
    }

    #[inline(always)]
    fn lt(self, a: Self::F, b: Self::F) -> Mask {
        signs([
            with!(_mm256_cmp_ps::<_CMP_LT_OQ>(a[0], b[0])),
            with!(_mm256_cmp_ps::<_CMP_LT_OQ>(a[1], b[1])),
        ])
    }

    #[inline(always)]
    fn le(self, a: Self::F, b: Self::F) -> Mask {
        signs([
            with!(_mm256_cmp_ps::<_CMP_LE_OQ>(a[0], b[0])),
            with!(_mm256_cmp_ps::<_CMP_LE_OQ>(a[1], b[1])),
        ])
    }

    #[inline(always)]
    fn select(self, mask: Mask, yes: Self::F, no: Self::F) -> Self::F {
        let bits = [widened(mask, 0), widened(mask, 8)];
        both!(_mm256_blendv_ps(no, yes, bits))
    }

    #[inline(always)]
    fn least(self, a: Self::F) -> f32 {
        let eight = with!(_mm256_min_ps(a[0], a[1]));
        let [low, high] = [with!(_mm256_castps256_ps128(eight)), with!(_mm256_extractf128_ps::<1>(eight))];
        let four = with!(_mm_min_ps(low, high));
        let high = with!(_mm_movehl_ps(four, four));
        let two = with!(_mm_min_ps(four, high));
        let second = with!(_mm_movehdup_ps(two));
        let one = with!(_mm_min_ss(two, second));
        with!(_mm_cvtss_f32(one))
    }

    #[inline(always)]
    fn gather<const N: usize>(self, table: &[f32; N], index: Self::I) -> Self::F {
        let low_bits = with!(_mm256_set1_epi32(const { low_bits(N) }));
        each!(2: index, index => {
            // So the entries lie in the table.
            let index = with!(_mm256_and_si256(index, low_bits));
            with!(_mm256_i32gather_ps::<4>(table.as_ptr(), index))
        })
    }

    #[inline(always)]
    fn gather_pairs<const N: usize>(self, table: &[f32; N], index: Self::I) -> [Self::F; 2] {
        let low_bits = with!(_mm256_set1_epi32(const { low_bits(N) }));
        let last = with!(_mm256_set1_epi32(const { last_of_two(N) }));
        let halves = each!(2: index, index => {
            // So both entries lie in the table.
            let index = with!(_mm256_and_si256(index, low_bits));
            let index = with!(_mm256_min_epi32(index, last));
            let (low, high) = (with!(_mm256_castsi256_si128(index)), with!(_mm256_extracti128_si256::<1>(index)));
            let pairs = each!(2: [low, high], quarter => {
                let pairs = with!(_mm256_i32gather_pd::<4>(table.as_ptr().cast(), quarter));
                with!(_mm256_castpd_ps(pairs))
            });
            let firsts = with!(_mm256_shuffle_ps::<0b10_00_10_00>(pairs[0], pairs[1]));
            let seconds = with!(_mm256_shuffle_ps::<0b11_01_11_01>(pairs[0], pairs[1]));
            // Quarters of registers came in turn from one and the other.
            each!(2: [firsts, seconds], lanes => {
                let lanes = with!(_mm256_castps_pd(lanes));
                let lanes = with!(_mm256_permute4x64_pd::<0b11_01_10_00>(lanes));
                with!(_mm256_castpd_ps(lanes))
            })
        });
        [[halves[0][0], halves[1][0]], [halves[0][1], halves[1][1]]]
    }

    #[inline(always)]
    fn store_packed(self, mask: Mask, value: Self::F, to: &mut [f32; LANES]) {
        let low = packed(mask, value[0]);
        let high = packed(mask >> 8, value[1]);
        let count = (mask & 0xff).count_ones() as usize;
        with!(_mm256_storeu_ps(to.as_mut_ptr(), low));
        if let Some(second) = to.get_mut(count..count + 8) {
            with!(_mm256_storeu_ps(second.as_mut_ptr(), high));
        }
    }

    #[inline(always)]
    fn pick_of_two(self, [a, b]: [Self::F; 2], index: Self::I) -> Self::F {
        let parts = [a[0], a[1], b[0], b[1]];
        [look_up(parts, index[0]), look_up(parts, index[1])]
    }

    #[inline(always)]
    fn bytes(self, from: &[u8]) -> Self::I {
        let mut padded = [0; LANES];
        let bytes = if let Some(bytes) = from.first_chunk::<LANES>() {
            bytes
        } else {
            for (lane, byte) in padded.iter_mut().zip(from) {
                *lane = *byte;
            }
            &padded
        };
        each!(2: halves(bytes), half => {
            let half = with!(_mm_loadl_epi64(half.as_ptr().cast()));
            with!(_mm256_cvtepu8_epi32(half))
        })
    }

    #[inline(always)]
    fn to_int(self, value: Self::F) -> Self::I {
        both!(_mm256_cvttps_epi32(value))
    }

    #[inline(always)]
    fn to_float(self, value: Self::I) -> Self::F {
        both!(_mm256_cvtepi32_ps(value))
    }

    #[inline(always)]
    fn store_int(self, value: Self::I, to: &mut [i32; LANES]) {
        let (halves, _) = to.as_chunks_mut::<8>();
        with!(_mm256_storeu_si256(halves[0].as_mut_ptr().cast(), value[0]));
        with!(_mm256_storeu_si256(halves[1].as_mut_ptr().cast(), value[1]));
    }

    #[inline(always)]
    fn shift_right<const BITS: u32>(self, a: Self::I) -> Self::I {
        let bits = with!(_mm_cvtsi32_si128(BITS.cast_signed()));
        [with!(_mm256_srl_epi32(a[0], bits)), with!(_mm256_srl_epi32(a[1], bits))]
    }

    #[inline(always)]
    fn widen(self, a: Self::F) -> Self::D {
        let low = each!(2: a, half => with!(_mm256_castps256_ps128(half)));
        let high = each!(2: a, half => with!(_mm256_extractf128_ps::<1>(half)));
        each!(4: [low[0], high[0], low[1], high[1]], quarter => with!(_mm256_cvtps_pd(quarter)))
    }

    #[inline(always)]
    fn narrow(self, a: Self::D) -> Self::F {
        let quarters = each!(4: a, quarter => with!(_mm256_cvtpd_ps(quarter)));
        [with!(_mm256_set_m128(quarters[1], quarters[0])), with!(_mm256_set_m128(quarters[3], quarters[2]))]
    }

    #[inline(always)]
    fn add_f64(self, a: Self::D, b: Self::D) -> Self::D {
        each!(4: [0, 1, 2, 3], quarter => with!(_mm256_add_pd(a[quarter], b[quarter])))
    }

    #[inline(always)]
    fn sub_f64(self, a: Self::D, b: Self::D) -> Self::D {
        each!(4: [0, 1, 2, 3], quarter => with!(_mm256_sub_pd(a[quarter], b[quarter])))
    }

    #[inline(always)]
    fn mul_f64(self, a: Self::D, b: Self::D) -> Self::D {
        each!(4: [0, 1, 2, 3], quarter => with!(_mm256_mul_pd(a[quarter], b[quarter])))
    }

    #[inline(always)]
    fn div_f64(self, a: Self::D, b: Self::D) -> Self::D {
        each!(4: [0, 1, 2, 3], quarter => with!(_mm256_div_pd(a[quarter], b[quarter])))
    }

    #[inline(always)]
    fn sqrt_f64(self, a: Self::D) -> Self::D {
        each!(4: a, quarter => with!(_mm256_sqrt_pd(quarter)))
    }

    #[inline(always)]
    fn eq_f64(self, a: Self::D, b: Self::D) -> Self::M {
        each!(4: [0, 1, 2, 3], quarter => with!(_mm256_cmp_pd::<_CMP_EQ_OQ>(a[quarter], b[quarter])))
    }

    #[inline(always)]
    fn splat_f64(self, value: f64) -> Self::D {
        [with!(_mm256_set1_pd(value)); 4]
    }

    #[inline(always)]
    fn load_f64(self, from: &[f64; LANES]) -> Self::D {
        let (quarters, _) = from.as_chunks::<4>();
        each!(4: [0, 1, 2, 3], quarter => with!(_mm256_loadu_pd(quarters[quarter].as_ptr())))
    }

    #[inline(always)]
    fn store_f64(self, value: Self::D, to: &mut [f64; LANES]) {
        let (quarters, _) = to.as_chunks_mut::<4>();
        for (to, quarter) in quarters.iter_mut().zip(value) {
            with!(_mm256_storeu_pd(to.as_mut_ptr(), quarter));
        }
    }

    #[inline(always)]
    fn min_f64(self, a: Self::D, b: Self::D) -> Self::D {
        each!(4: [0, 1, 2, 3], quarter => with!(_mm256_min_pd(a[quarter], b[quarter])))
    }

    #[inline(always)]
    fn max_f64(self, a: Self::D, b: Self::D) -> Self::D {
        each!(4: [0, 1, 2, 3], quarter => with!(_mm256_max_pd(a[quarter], b[quarter])))
    }

    #[inline(always)]
    fn floor_f64(self, a: Self::D) -> Self::D {
        each!(4: a, quarter => with!(_mm256_floor_pd(quarter)))
    }

    #[inline(always)]
    fn lt_f64(self, a: Self::D, b: Self::D) -> Self::M {
        each!(4: [0, 1, 2, 3], quarter => with!(_mm256_cmp_pd::<_CMP_LT_OQ>(a[quarter], b[quarter])))
    }

    #[inline(always)]
    fn le_f64(self, a: Self::D, b: Self::D) -> Self::M {
        each!(4: [0, 1, 2, 3], quarter => with!(_mm256_cmp_pd::<_CMP_LE_OQ>(a[quarter], b[quarter])))
    }

    #[inline(always)]
    fn select_f64(self, mask: Self::M, yes: Self::D, no: Self::D) -> Self::D {
        each!(4: [0, 1, 2, 3], quarter => with!(_mm256_blendv_pd(no[quarter], yes[quarter], mask[quarter])))
    }

    #[inline(always)]
    fn add_where_f64(self, mask: Self::M, a: Self::D, b: Self::D) -> Self::D {
        self.select_f64(mask, self.add_f64(a, b), a)
    }

    #[inline(always)]
    fn wide_mask(self, mask: Mask) -> Self::M {
        let own = with!(_mm256_setr_epi64x(1, 2, 4, 8));
        each!(4: [0, 4, 8, 12], shift => {
            let all = with!(_mm256_set1_epi64x(i64::from(mask >> shift & 0xf)));
            let met = with!(_mm256_and_si256(all, own));
            let met = with!(_mm256_cmpeq_epi64(met, own));
            with!(_mm256_castsi256_pd(met))
        })
    }

    #[inline(always)]
    #[expect(clippy::cast_sign_loss, clippy::cast_possible_truncation, reason = "four bits each")]
    fn narrow_mask(self, mask: Self::M) -> Mask {
        let [a, b, c, d] = each!(4: mask, quarter => with!(_mm256_movemask_pd(quarter)) as Mask);
        a | b << 4 | c << 8 | d << 12
    }

    #[inline(always)]
    fn both(self, a: Self::M, b: Self::M) -> Self::M {
        each!(4: [0, 1, 2, 3], quarter => with!(_mm256_and_pd(a[quarter], b[quarter])))
    }

    #[inline(always)]
    fn except(self, a: Self::M, b: Self::M) -> Self::M {
        each!(4: [0, 1, 2, 3], quarter => with!(_mm256_andnot_pd(b[quarter], a[quarter])))
    }

    #[inline(always)]
    fn splat_int(self, value: i32) -> Self::I {
        [with!(_mm256_set1_epi32(value)); 2]
    }

    #[inline(always)]
    fn select_int(self, mask: Mask, yes: Self::I, no: Self::I) -> Self::I {
        let bits = each!(2: [0, 8], shift => {
            let bits = widened(mask, shift);
            with!(_mm256_castps_si256(bits))
        });
        both!(_mm256_blendv_epi8(no, yes, bits))
    }

    #[inline(always)]
    fn add_where_int(self, mask: Mask, a: Self::I, b: Self::I) -> Self::I {
        self.select_int(mask, both!(_mm256_add_epi32(a, b)), a)
    }

    #[inline(always)]
    fn add_where_int_wide(self, mask: Self::M, a: Self::I, b: Self::I) -> Self::I {
        let bits = each!(2: [[mask[0], mask[1]], [mask[2], mask[3]]], half => {
            let [low, high] = each!(2: half, quarter => with!(_mm256_castpd_ps(quarter)));
            // Every other word, which leaves pairs in the order 0 2 1 3.
            let words = with!(_mm256_shuffle_ps::<0b10_00_10_00>(low, high));
            let words = with!(_mm256_castps_si256(words));
            with!(_mm256_permute4x64_epi64::<0b11_01_10_00>(words))
        });
        let added = both!(_mm256_and_si256(bits, b));
        both!(_mm256_add_epi32(a, added))
    }

    #[inline(always)]
    fn bits_of(self, table: &[u64; 8], index: Self::I) -> Mask {
        let (halves, _) = table.as_chunks::<4>();
        let words = each!(2: [0, 1], half => with!(_mm256_loadu_si256(halves[half].as_ptr().cast())));
        let all = with!(_mm256_set1_epi32(31));
        signs(each!(2: index, index => {
            let place = with!(_mm256_srli_epi32::<5>(index));
            let low = with!(_mm256_permutevar8x32_epi32(words[0], place));
            let high = with!(_mm256_permutevar8x32_epi32(words[1], place));
            // Bit 8 of the index, brought to the sign.
            let is_high = with!(_mm256_slli_epi32::<23>(index));
            let is_high = with!(_mm256_castsi256_ps(is_high));
            let (low, high) = (with!(_mm256_castsi256_ps(low)), with!(_mm256_castsi256_ps(high)));
            let word = with!(_mm256_blendv_ps(low, high, is_high));
            let word = with!(_mm256_castps_si256(word));
            // The bit wanted, brought to the sign.
            let up = with!(_mm256_andnot_si256(index, all));
            let word = with!(_mm256_sllv_epi32(word, up));
            with!(_mm256_castsi256_ps(word))
        }))
    }
}
