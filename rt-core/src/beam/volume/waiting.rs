//! Rays that enter a brick, waiting for lanes to become free.
//!
//! Of the sixteen rays of a packet a few may enter a brick, and those leave it one after the other. So rays of all packets
//! that enter it take whichever lane is free; each knows its number.

use super::packet::{Packet, Stretch};
use crate::simd::{LANES, Mask, Simd, each};

/// Rays that wait, fewer than two packets of them.
pub(super) struct Waiting {
    /// Origins, directions, inverses, and where the rays enter and leave.
    numbers: [[f64; 2 * LANES]; 11],
    names: [f32; 2 * LANES],
    pub(super) count: usize,
}

/// The rays in the lanes.
pub(super) struct Rays<S: Simd> {
    pub(super) packet: Packet<S>,
    /// Sixteen times the number of the packet that each is of, and its lane there.
    names: S::F,
}

/// The names of rays in their lanes.
pub(super) struct Names([i32; LANES]);

impl Waiting {
    pub(super) const fn new() -> Self {
        Self { numbers: [[0.0; 2 * LANES]; 11], names: [0.0; 2 * LANES], count: 0 }
    }

    /// Adds rays of a packet to those that wait, which are no more than a packet.
    #[inline(always)]
    pub(super) fn add<S: Simd>(&mut self, s: S, number: usize, packet: &Packet<S>, stretch: &Stretch<S::D>) {
        let at = self.count.min(LANES);
        let ([a, b, c], [d, e, f], [g, h, i]) = (packet.origin, packet.direction, packet.inverse);
        let all = [a, b, c, d, e, f, g, h, i, stretch.enter, stretch.leave];
        for (to, value) in self.numbers.iter_mut().zip(all) {
            if let Some(to) = to[at..].first_chunk_mut() {
                s.store_packed_f64(stretch.lanes, value, to);
            }
        }
        if let Some(to) = self.names[at..].first_chunk_mut() {
            let names = s.add(s.splat((number * LANES) as f32), s.load(&NAMES));
            s.store_packed(stretch.lanes, names, to);
        }
        self.count = at + stretch.lanes.count_ones() as usize;
    }

    /// Moves as many rays as there are lanes in the mask to them, and tells where they enter and leave.
    #[inline(always)]
    pub(super) fn put<S: Simd>(&mut self, s: S, lanes: Mask, rays: &mut Rays<S>) -> Stretch<S::D> {
        self.count = self.count.saturating_sub(lanes.count_ones() as usize);
        let at = self.count.min(LANES);
        let Rays { packet, names } = rays;
        let mut stretch = Stretch { enter: s.splat_f64(0.0), leave: s.splat_f64(0.0), lanes };
        let ([a, b, c], [d, e, f], [g, h, i]) =
            (&mut packet.origin, &mut packet.direction, &mut packet.inverse);
        let all = [a, b, c, d, e, f, g, h, i, &mut stretch.enter, &mut stretch.leave];
        for (to, from) in all.into_iter().zip(&self.numbers) {
            if let Some(from) = from[at..].first_chunk() {
                *to = s.load_spread_f64(lanes, from, *to);
            }
        }
        if let Some(from) = self.names[at..].first_chunk() {
            *names = s.load_spread(lanes, from, *names);
        }
        packet.forwards = each!(3: packet.inverse, inverse => s.lt_f64(s.splat_f64(0.0), inverse));
        stretch
    }
}

impl<S: Simd> Rays<S> {
    /// No rays.
    #[inline(always)]
    pub(super) fn none(s: S) -> Self {
        Self { packet: Packet::none(s), names: s.splat(0.0) }
    }

    #[inline(always)]
    pub(super) fn names(&self, s: S) -> Names {
        Names(s.int_array(s.to_int(self.names)))
    }
}

impl Names {
    /// The ray in a lane: the number of its packet, and its lane there.
    #[inline(always)]
    pub(super) const fn of(&self, lane: usize) -> (usize, usize) {
        let name = self.0[lane % LANES].cast_unsigned() as usize;
        (name / LANES, name % LANES)
    }

    /// Takes the rays of one packet out of some lanes, one at least: the packet's number, and their lanes there.
    #[inline(always)]
    pub(super) fn take_packet(&self, lanes: &mut Mask) -> (usize, Mask) {
        let (number, _) = self.of(lanes.trailing_zeros() as usize);
        let (mut left, mut own) = (*lanes, 0);
        while left != 0 {
            let lane = left.trailing_zeros() as usize;
            left &= left - 1;
            let of = self.of(lane);
            if of.0 == number {
                own |= 1 << of.1;
                *lanes &= !(1 << lane);
            }
        }
        (number, own)
    }
}

/// Numbers of the lanes.
const NAMES: [f32; LANES] =
    [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0];
