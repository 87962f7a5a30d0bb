//! Asks the processor, without the standard library, what it has.
#![allow(unsafe_code, reason = "one instruction that has no safe wrapper")]

use core::arch::x86_64::{__cpuid, __cpuid_count, _xgetbv};

/// AVX2, and a system that saves its registers.
pub(super) fn has_avx2() -> bool {
    saved_registers() & YMM == YMM && features().1 & AVX2 == AVX2
}

/// AVX-512 with the parts that the kernels use, and a system that saves its registers.
#[cfg(feature = "lanes-avx512")]
pub(super) fn has_avx512() -> bool {
    has_avx2() && saved_registers() & ZMM == ZMM && features().1 & AVX512 == AVX512
}

/// Which registers the system saves when it changes threads, as bits of XCR0; 0 when it does not say.
fn saved_registers() -> u64 {
    let has_xgetbv = features().0 & OSXSAVE != 0;
    if !has_xgetbv {
        return 0;
    }
    // SAFETY: OSXSAVE says that the system has turned the instruction on.
    unsafe { _xgetbv(0) }
}

/// The feature bits of leaf 1 (ecx) and leaf 7 (ebx).
fn features() -> (u32, u32) {
    let leaves = __cpuid(0).eax;
    let seventh = if leaves >= 7 { __cpuid_count(7, 0).ebx } else { 0 };
    (__cpuid(1).ecx, seventh)
}

const OSXSAVE: u32 = 1 << 27;
const YMM: u64 = 0b110;
#[cfg(feature = "lanes-avx512")]
const ZMM: u64 = 0b1110_0110;
/// AVX2 and BMI1.
const AVX2: u32 = 1 << 5 | 1 << 3;
/// AVX-512 F, DQ, BW, VL.
#[cfg(feature = "lanes-avx512")]
const AVX512: u32 = 1 << 16 | 1 << 17 | 1 << 30 | 1 << 31;

#[cfg(all(test, feature = "lanes-avx512"))]
mod tests {
    use super::*;

    #[test]
    fn the_standard_library_says_the_same() {
        assert_eq!(
            has_avx2(),
            std::is_x86_feature_detected!("avx2") && std::is_x86_feature_detected!("bmi1")
        );
        let parts = std::is_x86_feature_detected!("avx512f")
            && std::is_x86_feature_detected!("avx512dq")
            && std::is_x86_feature_detected!("avx512bw")
            && std::is_x86_feature_detected!("avx512vl");
        assert_eq!(has_avx512(), has_avx2() && parts);
    }
}
