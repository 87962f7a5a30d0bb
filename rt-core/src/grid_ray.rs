//! A ray in the units of the grid, and what it may enter there.
//!
//! Everything here culls, and errs towards entering; [`walk`](crate::walk) says by how much it must.

use glam::{Vec3, Vec4};

use crate::cluster::Nearest;
use crate::grid::{BoxFrame, FLIP_AXIS, GridShape};
use crate::image::Header;
use crate::kinds::Kinds;
use crate::ray::{Hit, Primitive, Ray};
use crate::scale::{Scale, exponent_of, power_of_two};
use crate::shade;
use crate::sphere::SphereRay;
use crate::surface::Surface;
use crate::triangle_test::TriangleTest;
use crate::triangle_woop::{Crossing, WoopRay};

/// A ray brought into grid space: coordinates by the image's scale, the direction normalised by a power of
/// two. Both are exact.
#[derive(Clone, Copy, Debug)]
pub struct GridRay {
    origin: Vec3,
    direction: Vec3,
    /// One over the direction, tiny components replaced.
    inverse: Vec3,
    /// Padding of cells and of boxes, as lengths of `t`.
    cell_pad: Vec3,
    box_pad: Vec3,
    /// Axes along which the ray runs backwards, as bits of a cell index.
    flip: u32,
    t_max: f32,
    /// From grid `t` to the caller's `t`.
    caller_from_grid: Scale,
}

impl GridRay {
    /// Brings a ray of world units into the grid of an image; `None` when it is a stated miss (see [`Ray`]).
    #[inline]
    pub fn from_world(ray: &Ray, header: &Header) -> Option<Self> {
        let scale = header.scale();
        Self::new(scale.apply_to(ray.origin), ray.direction, ray.t_max, scale, &header.grid)
    }

    /// A ray whose origin is in grid units and whose direction and `t_max` are such that `scale` takes them
    /// there.
    #[inline]
    pub(crate) fn new(
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        scale: Scale,
        grid: &GridShape,
    ) -> Option<Self> {
        let reach = (origin - grid.origin).abs() + grid.size;
        let longest = direction.abs().max_element();
        // Comparisons are written so that a NaN anywhere fails them.
        let usable = reach.max_element() < REACH_MAX && direction.is_finite() && longest > 0.0 && t_max > 0.0;
        if !usable || !reach.is_finite() {
            return None;
        }
        let normalise = Scale::new(-exponent_of(longest));
        let direction = normalise.apply_to(direction);
        let caller_from_grid = Scale::new(normalise.exponent() - scale.exponent());
        let tiny = power_of_two(-60);
        let inverse =
            Vec3::from(direction.to_array().map(|d| 1.0 / if d.abs() < tiny { tiny.copysign(d) } else { d }));
        let allowance = reach * power_of_two(-18) + reach.max_element() * power_of_two(-46);
        let negative = |axis: usize| if inverse[axis] < 0.0 { FLIP_AXIS[axis] } else { 0 };
        Some(Self {
            origin,
            direction,
            inverse,
            cell_pad: (allowance + grid.slack) * inverse.abs(),
            box_pad: allowance * inverse.abs(),
            flip: negative(0) | negative(1) | negative(2),
            t_max: caller_from_grid.inverse().apply(t_max),
            caller_from_grid,
        })
    }

    /// The ray as the triangle test `T` wants it.
    #[inline]
    pub fn test<T: TriangleTest>(&self) -> T {
        T::new(self.origin, self.direction)
    }

    /// The ray as the default triangle test wants it.
    #[inline]
    pub fn woop(&self) -> WoopRay {
        self.test()
    }

    /// The ray as the sphere test wants it.
    #[inline]
    pub const fn sphere_ray(&self) -> SphereRay {
        SphereRay::new(self.origin, self.direction)
    }

    /// Largest `t` of interest, in grid units.
    pub const fn t_max(&self) -> f32 {
        self.t_max
    }

    /// Axes along which the ray runs backwards, as bits of a cell index.
    pub(crate) const fn flip(&self) -> u32 {
        self.flip
    }

    /// The hit in the caller's units. A hit of other kinds than `K` is none.
    #[inline]
    pub fn hit<K: Kinds>(&self, nearest: &Nearest) -> Option<Hit> {
        let (primitive, surface) = nearest.surface?;
        self.hit_at::<K>(&nearest.crossing, primitive, &surface)
    }

    /// A crossing in the caller's units. One with another kind than `K` is none.
    #[inline]
    pub(crate) fn hit_at<K: Kinds>(
        &self,
        crossing: &Crossing,
        primitive: Primitive,
        surface: &Surface,
    ) -> Option<Hit> {
        let Crossing { t, u, v } = *crossing;
        let normal = match surface {
            Surface::Triangle(corners) if K::TRIANGLES => shade::normal(*corners, self.direction),
            Surface::Sphere(sphere) if K::SPHERES => self.sphere_ray().normal(sphere),
            _ => return None,
        };
        Some(Hit { t: self.caller_from_grid.apply(t), u, v, primitive, normal })
    }

    /// The cells of the branch at `corner` that the ray enters before `t_max`, in Morton order.
    ///
    /// Vector types are used here as four independent lanes, which round like scalars.
    #[inline]
    pub(crate) fn cells_entered(&self, corner: Vec3, cell: f32, t_max: f32) -> u64 {
        let start = (corner - self.origin) * self.inverse;
        let step = self.inverse * cell;
        let slabs = |axis: usize, lanes: [f32; 4]| {
            let near_plane = Vec4::splat(start[axis]) + Vec4::from_array(lanes) * step[axis];
            let far_plane = near_plane + step[axis];
            let pad = self.cell_pad[axis];
            (near_plane.min(far_plane) - pad, near_plane.max(far_plane) + pad)
        };
        let x = [slabs(0, [0.0, 1.0, 0.0, 1.0]), slabs(0, [2.0, 3.0, 2.0, 3.0])];
        let y = [slabs(1, [0.0, 0.0, 1.0, 1.0]), slabs(1, [2.0, 2.0, 3.0, 3.0])];
        let (z_enter, z_exit) = slabs(2, [0.0, 1.0, 2.0, 3.0]);
        let (z_enter, z_exit) =
            (z_enter.max(Vec4::ZERO).to_array(), z_exit.min(Vec4::splat(t_max)).to_array());
        let mut cells = 0;
        for (high, (x, y)) in [(x[0], y[0]), (x[1], y[0]), (x[0], y[1]), (x[1], y[1])].into_iter().enumerate()
        {
            let (enter, exit) = (x.0.max(y.0), x.1.min(y.1));
            for z in 0..4 {
                let entered = enter.max(Vec4::splat(z_enter[z])).cmple(exit.min(Vec4::splat(z_exit[z])));
                cells |= u64::from(entered.bitmask()) << (8 * high + 4 * (z & 1) + 32 * (z >> 1));
            }
        }
        cells
    }

    /// Where the ray enters the padded cell with its lowest corner at `corner`.
    #[inline]
    pub(crate) fn t_enter(&self, corner: Vec3, cell: f32) -> f32 {
        let (a, b) = ((corner - self.origin) * self.inverse, (corner + cell - self.origin) * self.inverse);
        (a.min(b) - self.cell_pad).max_element()
    }

    /// Whether the ray enters a leaf's box before `t_max`; the box as stored in the frame of the branch at
    /// `corner`.
    #[inline]
    pub(crate) fn enters_box(&self, corner: Vec3, frame: &BoxFrame, bounds: [u8; 6], t_max: f32) -> bool {
        let (low, high) = frame.decode(bounds);
        let corner = corner - self.origin;
        let (a, b) = ((corner + low) * self.inverse, (corner + high) * self.inverse);
        let enter = (a.min(b) - self.box_pad).max_element().max(0.0);
        let exit = (a.max(b) + self.box_pad).min_element().min(t_max);
        enter <= exit
    }
}

/// A ray whose origin is farther from the grid than this, in grid units, misses: corners can no longer be
/// told apart.
const REACH_MAX: f32 = power_of_two(60);
