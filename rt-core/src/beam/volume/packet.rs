//! Sixteen rays that go through the cells of a volume together.
//!
//! [`VolumeRay`], lane by lane.

use super::cross::Targets;
use crate::simd::{LANES, Mask, Simd, each};
use crate::volume_ray::{TINY, VolumePlace, VolumeRay};

/// Sixteen rays in cell units; see [`volume`](crate::volume).
#[derive(Clone, Copy)]
pub(super) struct Packet<S: Simd> {
    pub(super) origin: [S::D; 3],
    pub(super) direction: [S::D; 3],
    /// One over the direction, 0 taken as [`TINY`].
    pub(super) inverse: [S::D; 3],
    /// Rays that run forwards, by axis.
    pub(super) forwards: [S::M; 3],
}

/// The packets of a tile, each made when it is first needed.
pub(super) struct Packets<'a, S: Simd> {
    packets: &'a mut [Packet<S>; PACKETS],
    place: VolumePlace,
    made: u64,
}

/// How far rays look.
#[derive(Clone, Copy)]
pub(super) struct Limit<D> {
    /// Where nothing matters any more.
    pub(super) end: D,
    /// Rays that there are, and that still look for something.
    pub(super) open: Mask,
}

/// A box of voxel cells, by the numbers of its planes.
#[derive(Clone, Copy, Debug)]
pub(super) struct CellBox {
    pub(super) low: [i32; 3],
    pub(super) high: [i32; 3],
}

/// Where rays enter and leave a box; those of `lanes` do.
pub(super) struct Stretch<D> {
    pub(super) enter: D,
    pub(super) leave: D,
    pub(super) lanes: Mask,
}

impl<S: Simd> Packet<S> {
    /// No rays.
    pub(super) fn none(s: S) -> Self {
        let zeros = [s.splat_f64(0.0); 3];
        Self { origin: zeros, direction: zeros, inverse: zeros, forwards: [s.wide_mask(0); 3] }
    }

    /// The rays of these lanes, as [`VolumePlace::ray`] makes them; `None` when one of them has no direction, or is not
    /// finite.
    #[inline(always)]
    pub(super) fn new(
        s: S,
        place: &VolumePlace,
        [origin, direction]: [[S::F; 3]; 2],
        open: Mask,
    ) -> Option<Self> {
        let (zero, infinite) = (s.splat_f64(0.0), s.splat_f64(f64::INFINITY));
        let origin = each!(3: [0, 1, 2], axis => {
            let from = s.sub_f64(s.widen(origin[axis]), s.splat_f64(place.origin[axis]));
            s.mul_f64(from, s.splat_f64(place.per_length[axis]))
        });
        let direction = each!(3: [0, 1, 2], axis => {
            s.mul_f64(s.widen(direction[axis]), s.splat_f64(place.per_length[axis]))
        });
        let (mut usable, mut is_zero) = (open, open);
        for numbers in [&origin, &direction] {
            for &number in numbers {
                let below = s.lt_f64(number, infinite);
                usable &= s.narrow_mask(s.both(below, s.lt_f64(s.sub_f64(zero, infinite), number)));
            }
        }
        let inverse = each!(3: direction, d => {
            is_zero &= s.is_zero_f64(d);
            s.div_f64(s.splat_f64(1.0), not_tiny(s, d))
        });
        if usable & !is_zero != open {
            return None;
        }
        let forwards = each!(3: inverse, inverse => s.lt_f64(zero, inverse));
        Some(Self { origin, direction, inverse, forwards })
    }

    /// One of the rays.
    pub(super) fn ray(&self, s: S, lane: usize) -> VolumeRay {
        let of = |vector: [S::D; 3]| vector.map(|axis| s.array_f64(axis)[lane % LANES]);
        VolumeRay {
            origin: of(self.origin),
            direction: of(self.direction),
            inverse: of(self.inverse),
            far_side: self.forwards.map(|lanes| i32::from(s.narrow_mask(lanes) >> (lane % LANES) & 1 != 0)),
        }
    }

    /// Where the rays are on planes of an axis.
    #[inline(always)]
    pub(super) fn planes(&self, s: S, axis: usize, k: S::D) -> S::D {
        s.mul_f64(s.sub_f64(k, self.origin[axis]), self.inverse[axis])
    }

    /// The near and far planes of a box, by axis.
    #[inline(always)]
    pub(super) fn ends(&self, s: S, cells: &CellBox) -> [[S::D; 3]; 2] {
        let low = each!(3: cells.low, k => s.splat_f64(f64::from(k)));
        let high = each!(3: cells.high, k => s.splat_f64(f64::from(k)));
        [
            each!(3: [0, 1, 2], axis => s.select_f64(self.forwards[axis], low[axis], high[axis])),
            each!(3: [0, 1, 2], axis => s.select_f64(self.forwards[axis], high[axis], low[axis])),
        ]
    }

    /// Where open rays are in a box between near and far planes.
    #[inline(always)]
    pub(super) fn stretch(&self, s: S, [near, far]: &[[S::D; 3]; 2], limit: &Limit<S::D>) -> Stretch<S::D> {
        let near = each!(3: [0, 1, 2], axis => self.planes(s, axis, near[axis]));
        let far = each!(3: [0, 1, 2], axis => self.planes(s, axis, far[axis]));
        let enter = s.max_f64(s.max_f64(near[0], near[1]), s.max_f64(near[2], s.splat_f64(0.0)));
        let leave = s.min_f64(s.min_f64(far[0], far[1]), s.min_f64(far[2], limit.end));
        Stretch { enter, leave, lanes: s.narrow_mask(s.lt_f64(enter, leave)) & limit.open }
    }
}

impl<'a, S: Simd> Packets<'a, S> {
    /// Packets of rays in the space in which a volume lies like this, none of them made.
    pub(super) const fn new(packets: &'a mut [Packet<S>; PACKETS], place: VolumePlace) -> Self {
        Self { packets, place, made: 0 }
    }

    /// A packet; `None` when one of its rays is not for beams.
    #[inline(always)]
    pub(super) fn get<T: Targets<S>>(&mut self, s: S, targets: &T, number: usize) -> Option<&Packet<S>> {
        let number = number % PACKETS;
        if self.made >> number & 1 == 0 {
            let open = targets.limit(s, number).open;
            self.packets[number] = Packet::new(s, &self.place, targets.rays(s, number), open)?;
            self.made |= 1 << number;
        }
        Some(&self.packets[number])
    }
}

/// Most packets of a tile.
pub(super) const PACKETS: usize = 64;

/// Zeros, and what is nearly zero, made [`TINY`] of the same sign.
#[inline(always)]
fn not_tiny<S: Simd>(s: S, d: S::D) -> S::D {
    let tiny = s.both(s.lt_f64(d, s.splat_f64(TINY)), s.lt_f64(s.splat_f64(-TINY), d));
    if s.narrow_mask(tiny) == 0 {
        return d;
    }
    let mut lanes = s.array_f64(d);
    for lane in &mut lanes {
        *lane = if lane.abs() < TINY { TINY.copysign(*lane) } else { *lane };
    }
    s.load_f64(&lanes)
}
