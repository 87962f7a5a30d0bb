//! Sixteen lanes as one register of AVX-512.
#![allow(unsafe_code, reason = "intrinsics; every call is made through `with!`, which holds the argument")]

use core::arch::x86_64::*;

use super::{Kind, LANES, Mask, Part, Simd, Task, first_lanes, last_of_two, low_bits};

/// The proof that the processor has AVX-512 F, DQ, BW and VL.
#[derive(Clone, Copy)]
pub(super) struct Avx512(());

/// Runs a task compiled for these instructions.
#[inline]
pub(super) fn run<T: Task>(task: T, kind: Kind) -> T::Output {
    assert!(kind == Kind::Avx512, "lanes that were found out to be there");
    // SAFETY: a `Kind` of this name stands only in a `Lanes`, which exists only where `detect` found the instructions.
    unsafe { run_there(task) }
}

#[target_feature(enable = "avx512f,avx512dq,avx512bw,avx512vl,avx2,bmi1,bmi2,lzcnt,popcnt")]
fn run_there<T: Task>(task: T) -> T::Output {
    task.run(Avx512(()))
}

#[target_feature(enable = "avx512f,avx512dq,avx512bw,avx512vl,avx2,bmi1,bmi2,lzcnt,popcnt")]
#[inline(never)]
fn run_apart<T: Part<Avx512>>(part: T, s: Avx512) -> T::Output {
    part.run(s)
}

/// An intrinsic.
macro_rules! with {
    ($call:expr) => {
        // SAFETY: an `Avx512` exists only inside `run_there`, where the processor has these instructions. Those that take
        // a pointer get one from a reference to as many bytes as they touch, or a mask of the bytes they may touch.
        unsafe { $call }
    };
}

/// Of sixteen numbers those for the lower lanes of a mask, and those for its upper lanes, each with what follows.
#[inline(always)]
fn eights(mask: Mask, from: &[f64; LANES]) -> [&[f64; 8]; 2] {
    let (halves, _) = from.as_chunks();
    let upper = from[(mask & 0xff).count_ones() as usize..].first_chunk();
    [&halves[0], upper.unwrap_or(&halves[1])]
}

impl Simd for Avx512 {
    type F = __m512;
    type I = __m512i;
    type D = (__m512d, __m512d);
    type M = (__mmask8, __mmask8);

    #[inline(always)]
    fn apart<T: Part<Self>>(self, part: T) -> T::Output {
        with!(run_apart(part, self))
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Self::F {
        with!(_mm512_set1_ps(value))
    }

    #[inline(always)]
    fn load(self, from: &[f32; LANES]) -> Self::F {
        with!(_mm512_loadu_ps(from.as_ptr()))
    }

    #[inline(always)]
    fn load_le(self, from: &[[u8; 4]]) -> Self::F {
        with!(_mm512_maskz_loadu_ps(first_lanes(from.len()), from.as_ptr().cast()))
    }

    #[inline(always)]
    fn store(self, value: Self::F, to: &mut [f32; LANES]) {
        with!(_mm512_storeu_ps(to.as_mut_ptr(), value))
    }

    #[inline(always)]
    fn add(self, a: Self::F, b: Self::F) -> Self::F {
        with!(_mm512_add_ps(a, b))
    }

    #[inline(always)]
    fn sub(self, a: Self::F, b: Self::F) -> Self::F {
        with!(_mm512_sub_ps(a, b))
    }

    #[inline(always)]
    fn mul(self, a: Self::F, b: Self::F) -> Self::F {
        with!(_mm512_mul_ps(a, b))
    }

    #[inline(always)]
    fn div(self, a: Self::F, b: Self::F) -> Self::F {
        with!(_mm512_div_ps(a, b))
    }

    #[inline(always)]
    fn min(self, a: Self::F, b: Self::F) -> Self::F {
        with!(_mm512_min_ps(a, b))
    }

    #[inline(always)]
    fn max(self, a: Self::F, b: Self::F) -> Self::F {
        with!(_mm512_max_ps(a, b))
    }

    #[inline(always)]
    fn abs(self, a: Self::F) -> Self::F {
        with!(_mm512_abs_ps(a))
    }

    #[inline(always)]
    fn sqrt(self, a: Self::F) -> Self::F {
        with!(_mm512_sqrt_ps(a))
    }

    #[inline(always)]
    fn lt(self, a: Self::F, b: Self::F) -> Mask {
        with!(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, b))
    }

    #[inline(always)]
    fn le(self, a: Self::F, b: Self::F) -> Mask {
        with!(_mm512_cmp_ps_mask::<_CMP_LE_OQ>(a, b))
    }

    #[inline(always)]
    fn select(self, mask: Mask, yes: Self::F, no: Self::F) -> Self::F {
        with!(_mm512_mask_blend_ps(mask, no, yes))
    }

    #[inline(always)]
    fn least(self, a: Self::F) -> f32 {
        with!(_mm512_reduce_min_ps(a))
    }

    #[inline(always)]
    fn gather<const N: usize>(self, table: &[f32; N], index: Self::I) -> Self::F {
        // So the entries lie in the table.
        let low_bits = with!(_mm512_set1_epi32(const { low_bits(N) }));
        let index = with!(_mm512_and_si512(index, low_bits));
        with!(_mm512_i32gather_ps::<4>(index, table.as_ptr()))
    }

    #[inline(always)]
    fn gather_pairs<const N: usize>(self, table: &[f32; N], index: Self::I) -> [Self::F; 2] {
        // So both entries lie in the table.
        let low_bits = with!(_mm512_set1_epi32(const { low_bits(N) }));
        let last = with!(_mm512_set1_epi32(const { last_of_two(N) }));
        let index = with!(_mm512_and_si512(index, low_bits));
        let index = with!(_mm512_min_epi32(index, last));
        let halves = [with!(_mm512_castsi512_si256(index)), with!(_mm512_extracti32x8_epi32::<1>(index))];
        let [low, high] = each!(2: halves, half => {
            let pairs = with!(_mm512_i32gather_pd::<4>(half, table.as_ptr().cast()));
            with!(_mm512_castpd_ps(pairs))
        });
        each!(2: [0, 1], first => {
            let order = with!(_mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30));
            let first = with!(_mm512_set1_epi32(first));
            let order = with!(_mm512_add_epi32(order, first));
            with!(_mm512_permutex2var_ps(low, order, high))
        })
    }

    #[inline(always)]
    fn pick_of_two(self, [low, high]: [Self::F; 2], index: Self::I) -> Self::F {
        with!(_mm512_permutex2var_ps(low, index, high))
    }

    #[inline(always)]
    fn store_packed(self, mask: Mask, value: Self::F, to: &mut [f32; LANES]) {
        self.store(with!(_mm512_maskz_compress_ps(mask, value)), to);
    }

    #[inline(always)]
    fn load_spread(self, mask: Mask, from: &[f32; LANES], otherwise: Self::F) -> Self::F {
        with!(_mm512_mask_expand_ps(otherwise, mask, self.load(from)))
    }

    #[inline(always)]
    fn load_spread_f64(self, mask: Mask, from: &[f64; LANES], otherwise: Self::D) -> Self::D {
        let ([first, second], [low, high]) = (mask.to_le_bytes(), eights(mask, from));
        let low = with!(_mm512_loadu_pd(low.as_ptr()));
        let high = with!(_mm512_loadu_pd(high.as_ptr()));
        (
            with!(_mm512_mask_expand_pd(otherwise.0, first, low)),
            with!(_mm512_mask_expand_pd(otherwise.1, second, high)),
        )
    }

    #[inline(always)]
    fn store_packed_f64(self, mask: Mask, value: Self::D, to: &mut [f64; LANES]) {
        let [first, second] = mask.to_le_bytes();
        let low = with!(_mm512_maskz_compress_pd(first, value.0));
        let high = with!(_mm512_maskz_compress_pd(second, value.1));
        with!(_mm512_storeu_pd(to.as_mut_ptr(), low));
        if let Some(to) = to[first.count_ones() as usize..].first_chunk_mut::<8>() {
            with!(_mm512_storeu_pd(to.as_mut_ptr(), high));
        }
    }

    #[inline(always)]
    fn bytes(self, from: &[u8]) -> Self::I {
        let bytes = with!(_mm_maskz_loadu_epi8(first_lanes(from.len()), from.as_ptr().cast()));
        with!(_mm512_cvtepu8_epi32(bytes))
    }

    #[inline(always)]
    fn to_int(self, value: Self::F) -> Self::I {
        with!(_mm512_cvttps_epi32(value))
    }

    #[inline(always)]
    fn to_float(self, value: Self::I) -> Self::F {
        with!(_mm512_cvtepi32_ps(value))
    }

    #[inline(always)]
    fn store_int(self, value: Self::I, to: &mut [i32; LANES]) {
        with!(_mm512_storeu_epi32(to.as_mut_ptr(), value))
    }

    #[inline(always)]
    fn shift_right<const BITS: u32>(self, a: Self::I) -> Self::I {
        with!(_mm512_srli_epi32::<BITS>(a))
    }

    #[inline(always)]
    fn widen(self, a: Self::F) -> Self::D {
        let low = with!(_mm512_castps512_ps256(a));
        let high = with!(_mm512_extractf32x8_ps::<1>(a));
        (with!(_mm512_cvtps_pd(low)), with!(_mm512_cvtps_pd(high)))
    }

    #[inline(always)]
    fn narrow(self, a: Self::D) -> Self::F {
        let low = with!(_mm512_cvtpd_ps(a.0));
        let low = with!(_mm512_castps256_ps512(low));
        let high = with!(_mm512_cvtpd_ps(a.1));
        with!(_mm512_insertf32x8::<1>(low, high))
    }

    #[inline(always)]
    fn add_f64(self, a: Self::D, b: Self::D) -> Self::D {
        (with!(_mm512_add_pd(a.0, b.0)), with!(_mm512_add_pd(a.1, b.1)))
    }

    #[inline(always)]
    fn sub_f64(self, a: Self::D, b: Self::D) -> Self::D {
        (with!(_mm512_sub_pd(a.0, b.0)), with!(_mm512_sub_pd(a.1, b.1)))
    }

    #[inline(always)]
    fn mul_f64(self, a: Self::D, b: Self::D) -> Self::D {
        (with!(_mm512_mul_pd(a.0, b.0)), with!(_mm512_mul_pd(a.1, b.1)))
    }

    #[inline(always)]
    fn div_f64(self, a: Self::D, b: Self::D) -> Self::D {
        (with!(_mm512_div_pd(a.0, b.0)), with!(_mm512_div_pd(a.1, b.1)))
    }

    #[inline(always)]
    fn sqrt_f64(self, a: Self::D) -> Self::D {
        (with!(_mm512_sqrt_pd(a.0)), with!(_mm512_sqrt_pd(a.1)))
    }

    #[inline(always)]
    fn eq_f64(self, a: Self::D, b: Self::D) -> Self::M {
        let first = with!(_mm512_cmp_pd_mask::<_CMP_EQ_OQ>(a.0, b.0));
        let second = with!(_mm512_cmp_pd_mask::<_CMP_EQ_OQ>(a.1, b.1));
        (first, second)
    }

    #[inline(always)]
    fn splat_f64(self, value: f64) -> Self::D {
        let value = with!(_mm512_set1_pd(value));
        (value, value)
    }

    #[inline(always)]
    fn load_f64(self, from: &[f64; LANES]) -> Self::D {
        let (halves, _) = from.as_chunks::<8>();
        (with!(_mm512_loadu_pd(halves[0].as_ptr())), with!(_mm512_loadu_pd(halves[1].as_ptr())))
    }

    #[inline(always)]
    fn store_f64(self, value: Self::D, to: &mut [f64; LANES]) {
        let (halves, _) = to.as_chunks_mut::<8>();
        with!(_mm512_storeu_pd(halves[0].as_mut_ptr(), value.0));
        with!(_mm512_storeu_pd(halves[1].as_mut_ptr(), value.1));
    }

    #[inline(always)]
    fn min_f64(self, a: Self::D, b: Self::D) -> Self::D {
        (with!(_mm512_min_pd(a.0, b.0)), with!(_mm512_min_pd(a.1, b.1)))
    }

    #[inline(always)]
    fn max_f64(self, a: Self::D, b: Self::D) -> Self::D {
        (with!(_mm512_max_pd(a.0, b.0)), with!(_mm512_max_pd(a.1, b.1)))
    }

    #[inline(always)]
    fn floor_f64(self, a: Self::D) -> Self::D {
        const DOWN: i32 = _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC;
        (with!(_mm512_roundscale_pd::<DOWN>(a.0)), with!(_mm512_roundscale_pd::<DOWN>(a.1)))
    }

    #[inline(always)]
    fn lt_f64(self, a: Self::D, b: Self::D) -> Self::M {
        let first = with!(_mm512_cmp_pd_mask::<_CMP_LT_OQ>(a.0, b.0));
        let second = with!(_mm512_cmp_pd_mask::<_CMP_LT_OQ>(a.1, b.1));
        (first, second)
    }

    #[inline(always)]
    fn le_f64(self, a: Self::D, b: Self::D) -> Self::M {
        let first = with!(_mm512_cmp_pd_mask::<_CMP_LE_OQ>(a.0, b.0));
        let second = with!(_mm512_cmp_pd_mask::<_CMP_LE_OQ>(a.1, b.1));
        (first, second)
    }

    #[inline(always)]
    fn select_f64(self, mask: Self::M, yes: Self::D, no: Self::D) -> Self::D {
        (with!(_mm512_mask_blend_pd(mask.0, no.0, yes.0)), with!(_mm512_mask_blend_pd(mask.1, no.1, yes.1)))
    }

    #[inline(always)]
    fn add_where_f64(self, mask: Self::M, a: Self::D, b: Self::D) -> Self::D {
        (with!(_mm512_mask_add_pd(a.0, mask.0, a.0, b.0)), with!(_mm512_mask_add_pd(a.1, mask.1, a.1, b.1)))
    }

    #[inline(always)]
    fn wide_mask(self, mask: Mask) -> Self::M {
        let [first, second] = mask.to_le_bytes();
        (first, second)
    }

    #[inline(always)]
    fn narrow_mask(self, (first, second): Self::M) -> Mask {
        Mask::from_le_bytes([first, second])
    }

    #[inline(always)]
    fn both(self, a: Self::M, b: Self::M) -> Self::M {
        (a.0 & b.0, a.1 & b.1)
    }

    #[inline(always)]
    fn except(self, a: Self::M, b: Self::M) -> Self::M {
        (a.0 & !b.0, a.1 & !b.1)
    }

    #[inline(always)]
    fn splat_int(self, value: i32) -> Self::I {
        with!(_mm512_set1_epi32(value))
    }

    #[inline(always)]
    fn select_int(self, mask: Mask, yes: Self::I, no: Self::I) -> Self::I {
        with!(_mm512_mask_blend_epi32(mask, no, yes))
    }

    #[inline(always)]
    fn add_where_int(self, mask: Mask, a: Self::I, b: Self::I) -> Self::I {
        with!(_mm512_mask_add_epi32(a, mask, a, b))
    }

    #[inline(always)]
    fn add_where_int_wide(self, (first, second): Self::M, a: Self::I, b: Self::I) -> Self::I {
        // By halves: it takes longer to put the masks together.
        let [a, b] = each!(2: [a, b], of => {
            [with!(_mm512_castsi512_si256(of)), with!(_mm512_extracti32x8_epi32::<1>(of))]
        });
        let low = with!(_mm256_mask_add_epi32(a[0], first, a[0], b[0]));
        let high = with!(_mm256_mask_add_epi32(a[1], second, a[1], b[1]));
        let low = with!(_mm512_castsi256_si512(low));
        with!(_mm512_inserti32x8::<1>(low, high))
    }

    #[inline(always)]
    fn bits_of(self, table: &[u64; 8], index: Self::I) -> Mask {
        let table = with!(_mm512_loadu_epi64(table.as_ptr().cast()));
        let place = with!(_mm512_srli_epi32::<5>(index));
        let word = with!(_mm512_permutexvar_epi32(place, table));
        let ones = with!(_mm512_set1_epi32(31));
        let bit = with!(_mm512_and_si512(index, ones));
        let word = with!(_mm512_srlv_epi32(word, bit));
        let one = with!(_mm512_set1_epi32(1));
        with!(_mm512_test_epi32_mask(word, one))
    }
}
