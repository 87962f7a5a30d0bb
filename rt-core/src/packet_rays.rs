//! Sixteen rays at once, and what they may enter: the culling of a [packet](crate::packet_walk).
//!
//! Like that of [one ray](crate::grid_ray), it errs towards entering, by the same allowances: the steps that round are
//! fewer than those counted in [`walk`](crate::walk).

use glam::{Vec3, Vec4};

use crate::grid::FLIP_AXIS;
use crate::grid_ray::{COORDINATES, GridRay, of_quarters};
use crate::simd::{LANES, Mask, Simd, each};

/// What culling needs of sixteen rays: numbers by axis, each an array over the rays.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PacketRays {
    axes: [AxisRays; 3],
    spans: [Span; 3],
    /// Axes along which the packet as a whole runs backwards, as bits of a cell index.
    flip: u32,
}

/// Sixteen rays along one axis.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct AxisRays {
    origin: [f32; LANES],
    inverse: [f32; LANES],
    cell_pad: [f32; LANES],
    box_pad: [f32; LANES],
}

/// Bounds of all rays along one axis.
///
/// Where rays run both ways, the inverses are 0 and the padding is infinite: nothing is culled along that axis.
#[derive(Clone, Copy, Debug)]
struct Span {
    /// The origin from which a face at which rays enter is nearest.
    origin_near: f32,
    /// The origin from which a face at which rays leave is farthest.
    origin_far: f32,
    inverse_low: f32,
    inverse_high: f32,
    /// Largest padding of cells.
    pad: f32,
    /// 1 where rays run backwards, else 0.
    backwards: f32,
    /// -1 where rays run backwards, else 1.
    forwards: f32,
}

/// How boxes are padded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Padding {
    /// By slack and allowance.
    Cell,
    /// By the allowance.
    Box,
}

impl PacketRays {
    /// The rays of the packet, in their lanes; what the other lanes hold is copied from a ray.
    pub(crate) fn new(rays: &[GridRay; LANES]) -> Self {
        let axes = [0, 1, 2].map(|axis| AxisRays::new(rays, axis));
        let spans = [0, 1, 2].map(|axis| axes[axis].span());
        let flip_of = |axis: usize| if spans[axis].backwards > 0.0 { FLIP_AXIS[axis] } else { 0 };
        Self { axes, spans, flip: flip_of(0) | flip_of(1) | flip_of(2) }
    }

    /// Axes along which the packet as a whole runs backwards, as bits of a cell index.
    pub(crate) const fn flip(&self) -> u32 {
        self.flip
    }

    /// The cells of the branch at `corner` that any of the rays may enter before `t_max`, flipped; and some more.
    ///
    /// Rounding is monotone and every step is as for one ray, so what is computed from bounds bounds what would be
    /// computed for each.
    #[inline(always)]
    pub(crate) fn cells_entered<S: Simd>(&self, s: S, corner: Vec4, cell: f32, t_max: f32) -> u64 {
        let [x_span, y_span, z_span] = &self.spans;
        let x = x_span.slab(s, &COORDINATES[0], corner.x, cell);
        let (enter, exit) = (s.max(x[0], s.splat(0.0)), s.min(x[1], s.splat(t_max)));
        let y = each!(2: [1, 2], row => y_span.slab(s, &COORDINATES[row], corner.y, cell));
        let z = each!(2: [3, 4], row => z_span.slab(s, &COORDINATES[row], corner.z, cell));
        let enter = each!(2: y, [from, _] => s.max(enter, from));
        let exit = each!(2: y, [_, to] => s.min(exit, to));
        of_quarters([
            s.le(s.max(enter[0], z[0][0]), s.min(exit[0], z[0][1])),
            s.le(s.max(enter[1], z[0][0]), s.min(exit[1], z[0][1])),
            s.le(s.max(enter[0], z[1][0]), s.min(exit[0], z[1][1])),
            s.le(s.max(enter[1], z[1][0]), s.min(exit[1], z[1][1])),
        ])
    }

    /// The rays that enter the box between `low` and `high`, counted from `corner`, before their `t_max`.
    #[inline(always)]
    pub(crate) fn entering<S: Simd>(
        &self,
        s: S,
        corner: Vec4,
        (low, high): (Vec3, Vec3),
        padding: Padding,
        t_max: &[f32; LANES],
    ) -> Mask {
        let slabs = each!(3: [0, 1, 2], axis => {
            let rays = &self.axes[axis];
            let corner = s.sub(s.splat(corner[axis]), s.load(&rays.origin));
            let inverse = s.load(&rays.inverse);
            let a = s.mul(s.add(corner, s.splat(low[axis])), inverse);
            let b = s.mul(s.add(corner, s.splat(high[axis])), inverse);
            let pad = s.load(if matches!(padding, Padding::Cell) { &rays.cell_pad } else { &rays.box_pad });
            [s.sub(s.min(a, b), pad), s.add(s.max(a, b), pad)]
        });
        let enter = s.max(s.max3(each!(3: slabs, [enter, _] => enter)), s.splat(0.0));
        let exit = s.min(s.min3(each!(3: slabs, [_, exit] => exit)), s.load(t_max));
        s.le(enter, exit)
    }
}

impl AxisRays {
    fn new(rays: &[GridRay; LANES], axis: usize) -> Self {
        let zero = [0.0; LANES];
        let mut along = Self { origin: zero, inverse: zero, cell_pad: zero, box_pad: zero };
        for (lane, ray) in rays.iter().enumerate() {
            let culling = ray.culling();
            along.origin[lane] = culling.origin[axis];
            along.inverse[lane] = culling.inverse[axis];
            along.cell_pad[lane] = culling.cell_pad[axis];
            along.box_pad[lane] = culling.box_pad[axis];
        }
        along
    }

    fn span(&self) -> Span {
        let least = |lanes: &[f32; LANES]| lanes.iter().copied().fold(f32::INFINITY, f32::min);
        let most = |lanes: &[f32; LANES]| lanes.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let (origin_low, origin_high) = (least(&self.origin), most(&self.origin));
        let (inverse_low, inverse_high) = (least(&self.inverse), most(&self.inverse));
        let runs_backwards = self.inverse[0] < 0.0;
        let (origin_near, origin_far) =
            if runs_backwards { (origin_low, origin_high) } else { (origin_high, origin_low) };
        let (backwards, forwards) = if runs_backwards { (1.0, -1.0) } else { (0.0, 1.0) };
        let span = Span {
            origin_near,
            origin_far,
            inverse_low,
            inverse_high,
            pad: most(&self.cell_pad),
            backwards,
            forwards,
        };
        let runs_both_ways = inverse_low < 0.0 && inverse_high > 0.0;
        if runs_both_ways {
            Span { inverse_low: 0.0, inverse_high: 0.0, pad: f32::INFINITY, ..span }
        } else {
            span
        }
    }
}

impl Span {
    /// When the first ray may enter and the last may leave the slabs between padded faces of cells with these
    /// coordinates, of the branch at `corner`.
    #[inline(always)]
    fn slab<S: Simd>(&self, s: S, coordinates: &[f32; LANES], corner: f32, cell: f32) -> [S::F; 2] {
        // Cells count from the corner where the rays come in; all faces are exact.
        let first = corner + self.backwards * (cell * 4.0);
        let step = self.forwards * cell;
        let near = s.add(s.mul(s.load(coordinates), s.splat(step)), s.splat(first));
        let far = s.add(near, s.splat(step));
        let (low, high, pad) = (s.splat(self.inverse_low), s.splat(self.inverse_high), s.splat(self.pad));
        let near = s.sub(near, s.splat(self.origin_near));
        let far = s.sub(far, s.splat(self.origin_far));
        let enter = s.min(s.mul(near, low), s.mul(near, high));
        let exit = s.max(s.mul(far, low), s.mul(far, high));
        [s.sub(enter, pad), s.add(exit, pad)]
    }
}
