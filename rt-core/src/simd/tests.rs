//! All lanes against the portable ones, bit for bit.

use std::vec::Vec;

use proptest::prelude::*;

use super::{LANES, Lanes, Simd, Task};

/// Every operation on the same numbers; what comes out, as bits.
struct EveryOperation {
    a: [f32; LANES],
    b: [f32; LANES],
    bytes: Vec<u8>,
    mask: u16,
}

impl Task for EveryOperation {
    type Output = Vec<u64>;

    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> Vec<u64> {
        let (a, b) = (s.load(&self.a), s.load(&self.b));
        let mut found = Vec::new();
        let mut floats = |value: S::F| {
            let mut lanes = [0.0; LANES];
            s.store(value, &mut lanes);
            // One pattern stands for every NaN; which one comes out is the processor's affair.
            found.extend(lanes.map(|lane: f32| if lane.is_nan() { 1 } else { u64::from(lane.to_bits()) }));
        };
        for value in [
            s.add(a, b),
            s.sub(a, b),
            s.mul(a, b),
            s.div(a, b),
            s.min(a, b),
            s.max(a, b),
            s.abs(a),
            s.sqrt(s.abs(b)),
        ] {
            floats(value);
        }
        floats(s.select(self.mask, a, b));
        let (words, _) = self.bytes.as_chunks::<4>();
        floats(s.load_le(words));
        floats(s.lookup(&[self.a, self.b], s.bytes(&self.bytes)));
        floats(s.gather(&self.a, s.bytes(&self.bytes)));
        for value in s.gather_pairs(&self.a, s.bytes(&self.bytes)) {
            floats(value);
        }
        let mut packed = [0.0; LANES];
        s.store_packed(self.mask, a, &mut packed);
        packed[self.mask.count_ones() as usize..].fill(0.0);
        floats(s.load(&packed));
        floats(s.load_spread(self.mask, &self.a, b));
        let (wide_a, wide_b) = (s.widen(a), s.widen(b));
        let mut packed = [0.0; LANES];
        s.store_packed_f64(self.mask, wide_a, &mut packed);
        packed[self.mask.count_ones() as usize..].fill(0.0);
        floats(s.narrow(s.load_f64(&packed)));
        floats(s.narrow(s.load_spread_f64(self.mask, &s.array_f64(wide_a), wide_b)));
        for value in [
            s.add_f64(wide_a, wide_b),
            s.sub_f64(wide_a, wide_b),
            s.mul_f64(wide_a, wide_b),
            s.div_f64(wide_a, wide_b),
            s.sqrt_f64(s.mul_f64(wide_a, wide_a)),
        ] {
            floats(s.narrow(value));
        }
        for value in [
            s.min_f64(wide_a, wide_b),
            s.max_f64(wide_a, wide_b),
            s.floor_f64(wide_a),
            s.select_f64(s.wide_mask(self.mask), wide_a, wide_b),
            s.add_where_f64(s.wide_mask(self.mask), wide_a, s.splat_f64(0.1)),
            s.load_f64(&s.array_f64(wide_b)),
        ] {
            floats(s.narrow(value));
        }
        let small = s.to_float(s.bytes(&self.bytes));
        floats(small);
        let integers = s.to_int(s.mul(small, s.splat(0.1)));
        let nine = s.to_int(s.mul(small, s.splat(2.004)));
        for value in [
            integers,
            s.shift_right::<3>(integers),
            s.select_int(self.mask, integers, s.splat_int(-7)),
            s.add_where_int(self.mask, integers, s.splat_int(-7)),
            s.add_where_int_wide(s.wide_mask(self.mask), integers, s.bytes(&self.bytes)),
            nine,
        ] {
            let lanes = s.int_array(value);
            found.extend(lanes.map(|lane| u64::from(lane.cast_unsigned())));
        }
        let table = core::array::from_fn(|i| {
            u64::from(self.a[2 * i].to_bits()) | u64::from(self.a[2 * i + 1].to_bits()) << 32
        });
        let masks = [
            s.lt(a, b),
            s.le(a, b),
            s.is_zero_f64(wide_a),
            s.narrow_mask(s.eq_f64(wide_a, wide_b)),
            s.narrow_mask(s.lt_f64(wide_a, wide_b)),
            s.narrow_mask(s.le_f64(wide_a, wide_b)),
            s.narrow_mask(s.both(s.wide_mask(self.mask), s.lt_f64(wide_a, wide_b))),
            s.narrow_mask(s.except(s.wide_mask(self.mask), s.lt_f64(wide_a, wide_b))),
            s.bits_of(&table, nine),
        ];
        found.extend(masks.map(u64::from));
        found.push(u64::from(s.least(s.abs(s.select(s.le(a, a), a, s.splat(1.0)))).to_bits()));
        found
    }
}

proptest! {
    #[test]
    fn all_lanes_give_the_same_bits(
        a in prop::array::uniform16(prop_oneof![3 => -8.0..8.0_f32, 1 => prop::num::f32::ANY]),
        b in prop::array::uniform16(prop_oneof![3 => -8.0..8.0_f32, 1 => prop::num::f32::ANY, 1 => Just(0.0_f32)]),
        bytes in prop::collection::vec(any::<u8>(), 0..70),
        mask: u16,
    ) {
        let run = |lanes: Lanes| lanes.run(EveryOperation { a, b, bytes: bytes.clone(), mask });
        for lanes in Lanes::available() {
            prop_assert_eq!(run(lanes), run(Lanes::PORTABLE), "{}", lanes);
        }
    }
}

#[test]
fn lanes_are_named() {
    for lanes in Lanes::available() {
        assert_eq!(lanes.name().parse(), Ok(lanes));
    }
    assert!("mmx".parse::<Lanes>().is_err());
    assert!(Lanes::available().any(|lanes| lanes == Lanes::widest()));
}
