//! A cluster of triangles against sixteen rays.
//!
//! Triangles that all rays pass on one side, as bounds of the sheared corners tell, are dropped sixteen at a time. Each of
//! the others is tested against sixteen rays at once, as [`triangle_woop`](crate::triangle_woop) says: single
//! precision rejects, double precision decides, lane by lane.

use crate::cluster::{Cluster, Nearest};
use crate::grid_ray::GridRay;
use crate::packet_walk::lanes;
use crate::simd::{LANES, Mask, Part, Simd, each, first_lanes};
use crate::surface::Surface;
use crate::triangle_woop::{Sheared, cross_at};

/// Sixteen rays as the default triangle test wants them, and their bounds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WoopPacket {
    /// The axes of all rays.
    axes: [usize; 3],
    /// Numbers of the rays, in the order of `axes`.
    origin: [[f32; LANES]; 3],
    shear: [[f32; LANES]; 3],
    /// Least and greatest of each.
    origin_bounds: [[f32; 2]; 3],
    shear_bounds: [[f32; 2]; 3],
}

impl WoopPacket {
    /// Prepares rays that all run mainly along the same axis, the same way; those that are not active count towards the
    /// bounds.
    pub(crate) fn new(rays: &[GridRay; LANES]) -> Self {
        let (mut origin, mut shear) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
        let mut axes = [0, 1, 2];
        for (lane, ray) in rays.iter().enumerate() {
            let ray = ray.woop();
            axes = ray.axes;
            for axis in 0..3 {
                origin[axis][lane] = ray.origin[axis];
                shear[axis][lane] = ray.shear[axis];
            }
        }
        let bounds = |lanes: &[f32; LANES]| {
            let first = [lanes[0]; 2];
            lanes.iter().fold(first, |[least, most], &lane| [least.min(lane), most.max(lane)])
        };
        let (origin_bounds, shear_bounds) = (origin.each_ref().map(bounds), shear.each_ref().map(bounds));
        Self { axes, origin, shear, origin_bounds, shear_bounds }
    }

    /// Offers every triangle to the rays that hit it; with `ANY`, a ray that has hit something looks for no more.
    #[inline(always)]
    pub(crate) fn intersect<S: Simd, const ANY: bool>(
        &self,
        s: S,
        cluster: &Cluster<'_>,
        rays: Mask,
        nearest: &mut [Nearest; LANES],
    ) {
        s.apart(Intersect::<ANY> { packet: self, cluster, rays, nearest });
    }

    /// Bounds of the sheared vertices, over all rays: least and greatest of the first axis, then of the second.
    ///
    /// Every step is monotone, so it bounds what is computed for each ray.
    #[inline(always)]
    fn bounds<S: Simd>(&self, s: S, cluster: &Cluster<'_>) -> [[[f32; LANES]; 2]; 4] {
        let vertices = cluster.axes();
        let mut bounds = [[[0.0; LANES]; 2]; 4];
        let [x, y, z] = self.axes.map(|axis| vertices[axis].chunks(LANES));
        for (half, ((x, y), z)) in x.zip(y).zip(z).take(2).enumerate() {
            let [low, high] = self.origin_bounds[2];
            let z = s.load_le(z);
            let heights = [s.sub(z, s.splat(high)), s.sub(z, s.splat(low))];
            let each_axis = [s.load_le(x), s.load_le(y)];
            for (axis, place) in each_axis.into_iter().enumerate() {
                let [low, high] = self.origin_bounds[axis];
                let [least, most] = self.shear_bounds[axis];
                let (least, most) = (s.splat(least), s.splat(most));
                let a = each!(2: heights, height => s.mul(least, height));
                let b = each!(2: heights, height => s.mul(most, height));
                let (least, most) = (
                    s.min(s.min(a[0], a[1]), s.min(b[0], b[1])),
                    s.max(s.max(a[0], a[1]), s.max(b[0], b[1])),
                );
                s.store(s.sub(s.sub(place, s.splat(high)), most), &mut bounds[axis * 2][half]);
                s.store(s.sub(s.sub(place, s.splat(low)), least), &mut bounds[axis * 2 + 1][half]);
            }
        }
        bounds
    }

    /// A corner sheared along each of the rays; exactly as [`WoopRay::shear`](crate::triangle_woop::WoopRay::shear) does.
    #[inline(always)]
    fn shear<S: Simd>(&self, s: S, [x, y, z]: [f32; 3]) -> [S::F; 3] {
        let [from_x, from_y, from_z] = each!(3: [0, 1, 2], axis => s.load(&self.origin[axis]));
        let height = s.sub(s.splat(z), from_z);
        [
            s.sub(s.sub(s.splat(x), from_x), s.mul(s.load(&self.shear[0]), height)),
            s.sub(s.sub(s.splat(y), from_y), s.mul(s.load(&self.shear[1]), height)),
            s.mul(s.load(&self.shear[2]), height),
        ]
    }
}

/// A cluster to be tested, as a function of its own.
struct Intersect<'a, const ANY: bool> {
    packet: &'a WoopPacket,
    cluster: &'a Cluster<'a>,
    rays: Mask,
    nearest: &'a mut [Nearest; LANES],
}

impl<S: Simd, const ANY: bool> Part<S> for Intersect<'_, ANY> {
    type Output = ();

    #[inline(always)]
    fn run(self, s: S) {
        let Self { packet, cluster, mut rays, nearest } = self;
        let bounds = packet.bounds(s, cluster);
        let triangles = usize::from(cluster.place().triangles);
        for first in (0..triangles).step_by(LANES) {
            let mut met = met_by_any(s, &bounds, cluster, first) & first_lanes(triangles - first);
            while met != 0 {
                let index = first + met.trailing_zeros() as usize;
                met &= met - 1;
                let hit = offer(s, packet, cluster, index, rays, nearest);
                if ANY {
                    rays &= !hit;
                    if rays == 0 {
                        return;
                    }
                }
            }
        }
    }
}

/// Of sixteen triangles those that some ray may not pass on one side.
#[inline(always)]
fn met_by_any<S: Simd>(s: S, bounds: &[[[f32; LANES]; 2]; 4], cluster: &Cluster<'_>, first: usize) -> Mask {
    let corners = cluster.corners();
    let count = (corners[0].len() - first).min(LANES);
    let index = each!(3: corners, corners => s.bytes(&corners[first..][..count]));
    let [x_low, x_high, y_low, y_high] = each!(4: [0, 1, 2, 3], bound => {
        each!(3: index, index => s.lookup(&bounds[bound], index))
    });
    let zero = s.splat(0.0);
    let low = s.max(s.min3(x_low), s.min3(y_low));
    let high = s.min(s.max3(x_high), s.max3(y_high));
    !(s.lt(zero, low) | s.lt(high, zero))
}

/// Offers a triangle to the rays that hit it, and tells which do.
#[inline(always)]
fn offer<S: Simd>(
    s: S,
    packet: &WoopPacket,
    cluster: &Cluster<'_>,
    index: usize,
    rays: Mask,
    nearest: &mut [Nearest; LANES],
) -> Mask {
    let (triangle, axes) = (cluster.triangle(index), packet.axes);
    let corners = each!(3: triangle, corner => {
        packet.shear(s, [corner[axes[0]], corner[axes[1]], corner[axes[2]]])
    });
    let [a, b, c] = corners;
    let weights = each!(3: [(c, b), (a, c), (b, a)], (p, q) => {
        s.sub(s.mul(p[0], q[1]), s.mul(p[1], q[0]))
    });
    let zero = s.splat(0.0);
    let candidates = rays & !(s.lt(s.min3(weights), zero) & s.lt(zero, s.max3(weights)));
    if candidates == 0 {
        return 0;
    }
    let corners = each!(3: corners, corner => each!(3: corner, value => s.array(value)));
    let mut hit = 0;
    for lane in lanes(candidates) {
        let [a, b, c] = each!(3: &corners, [x, y, t] => Sheared { x: x[lane], y: y[lane], t: t[lane] });
        let nearest = &mut nearest[lane];
        if let Some(crossing) = cross_at(a, b, c, nearest.crossing.t) {
            nearest.offer(crossing, cluster.primitive(index), Surface::Triangle(triangle));
            hit |= 1 << lane;
        }
    }
    hit
}
