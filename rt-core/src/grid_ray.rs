//! A ray in the units of the grid, and what it may enter there.
//!
//! Everything here culls, and errs towards entering; [`walk`](crate::walk) says by how much it must.

use glam::{Vec3, Vec4};

use crate::cluster::Nearest;
use crate::grid::{BoxFrame, FLIP_AXIS, GridShape, Leaf, cell_coordinates};
use crate::image::Header;
use crate::kinds::Kinds;
use crate::ray::{Hit, Primitive, Ray};
use crate::scale::{Scale, exponent_of, power_of_two};
use crate::shade;
use crate::simd::{LANES, Mask, Simd, each};
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
    cull: Culling,
    /// Axes along which the ray runs backwards, as bits of a cell index.
    flip: u32,
    t_max: f32,
    /// Exponent of the scale from grid `t` to the caller's `t`.
    caller_from_grid: i32,
}

/// What culling needs of a ray. The fourth lanes are 0.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Culling {
    pub(crate) origin: Vec4,
    /// One over the direction, tiny components replaced; and its size.
    pub(crate) inverse: Vec4,
    inverse_abs: Vec4,
    /// Axes along which the ray runs backwards: 1, else 0.
    backwards: Vec4,
    /// Padding of cells and of boxes, as lengths of `t`.
    pub(crate) cell_pad: Vec4,
    pub(crate) box_pad: Vec4,
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
    #[inline(always)]
    pub(crate) fn new(
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        scale: Scale,
        grid: &GridShape,
    ) -> Option<Self> {
        let size = Vec4::new(grid.size, grid.size, grid.size, 0.0);
        let reach = (origin - grid.origin).extend(0.0).abs() + size;
        let (farthest, longest) = (reach.max_element(), direction.extend(0.0).abs().max_element());
        // Comparisons are written so that a NaN anywhere fails them.
        let usable = reach.cmplt(Vec4::splat(REACH_MAX)).all()
            && direction.extend(0.0).abs().cmplt(Vec4::splat(f32::INFINITY)).all()
            && longest > 0.0
            && t_max > 0.0;
        if !usable {
            return None;
        }
        let normalise = Scale::new(-exponent_of(longest));
        let direction = normalise.apply_to(direction);
        let caller_from_grid = normalise.exponent() - scale.exponent();
        let tiny = Vec4::splat(power_of_two(-60));
        let along = direction.extend(1.0);
        let along = Vec4::select(along.abs().cmplt(tiny), tiny.copysign(along), along);
        let inverse = (Vec4::ONE / along).with_w(0.0);
        let inverse_abs = inverse.abs();
        let allowance = reach * power_of_two(-18) + Vec4::splat(farthest * power_of_two(-46));
        let backwards = inverse.cmplt(Vec4::ZERO);
        let negative = |axis: usize| if backwards.test(axis) { FLIP_AXIS[axis] } else { 0 };
        Some(Self {
            origin,
            direction,
            cull: Culling {
                origin: origin.extend(0.0),
                inverse,
                inverse_abs,
                backwards: Vec4::select(backwards, Vec4::ONE, Vec4::ZERO),
                cell_pad: (allowance + Vec4::splat(grid.slack)) * inverse_abs,
                box_pad: allowance * inverse_abs,
            },
            flip: negative(0) | negative(1) | negative(2),
            t_max: Scale::new(-caller_from_grid).apply(t_max),
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

    /// What culling needs of the ray.
    pub(crate) const fn culling(&self) -> &Culling {
        &self.cull
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
        Some(Hit { t: self.caller_t(t), u, v, primitive, normal })
    }

    /// A distance in the caller's units.
    #[inline]
    pub(crate) fn caller_t(&self, t: f32) -> f32 {
        Scale::new(self.caller_from_grid).apply(t)
    }

    /// The cells of the branch at `corner` that the ray enters before `t_max`, one bit each, and when it enters each.
    /// *Flipped*: counted along the ray, so that the lowest is the nearest.
    ///
    /// Vector types of four are used here and below as independent lanes, which round like scalars.
    #[inline(always)]
    pub(crate) fn cells_entered<S: Simd>(
        &self,
        s: S,
        corner: Vec4,
        cell: f32,
        t_max: f32,
    ) -> (u64, [[f32; LANES]; 4]) {
        let Culling { origin, inverse, inverse_abs, backwards, cell_pad, .. } = self.cull;
        // The corner of the branch where the ray comes in; cells count from there.
        let corner = corner + backwards * (cell * 4.0);
        let start = (corner - origin) * inverse - cell_pad;
        let step = inverse_abs * cell;
        let width = step + (cell_pad + cell_pad);
        let x = slab(s, &COORDINATES[0], start.x, step.x, width.x);
        let (enter, exit) = (s.max(x[0], s.splat(0.0)), s.min(x[1], s.splat(t_max)));
        let y = each!(2: [1, 2], row => slab(s, &COORDINATES[row], start.y, step.y, width.y));
        let z = each!(2: [3, 4], row => slab(s, &COORDINATES[row], start.z, step.z, width.z));
        let enter = each!(2: y, [from, _] => s.max(enter, from));
        let exit = each!(2: y, [_, to] => s.min(exit, to));
        let enter = each!(4: [(0, 0), (1, 0), (0, 1), (1, 1)], (y, layer) => s.max(enter[y], z[layer][0]));
        let exit = each!(4: [(0, 0), (1, 0), (0, 1), (1, 1)], (y, layer) => s.min(exit[y], z[layer][1]));
        let entered = each!(4: [0, 1, 2, 3], quarter => s.le(enter[quarter], exit[quarter]));
        (of_quarters(entered), each!(4: enter, enter => s.array(enter)))
    }

    /// Whether the ray enters the box of a leaf of the branch at `corner` before `t_max`.
    #[inline(always)]
    pub(crate) fn enters_box<S: Simd>(
        &self,
        s: S,
        corner: Vec4,
        frame: &BoxFrame,
        leaf: &Leaf,
        t_max: f32,
    ) -> bool {
        let Culling { origin, inverse, box_pad, .. } = self.cull;
        let (low, high) = frame.decode_leaf(s, leaf);
        let corner = corner - origin;
        let (a, b) = ((corner + low) * inverse, (corner + high) * inverse);
        // In the fourth lanes: 0 and `t_max`.
        let enter = a.min(b) - box_pad;
        let exit = (a.max(b) + box_pad).with_w(t_max);
        enter.max_element() <= exit.min_element()
    }
}

/// When a ray enters and leaves the slabs between two padded faces of cells with these coordinates.
#[inline(always)]
fn slab<S: Simd>(s: S, coordinates: &[f32; LANES], start: f32, step: f32, width: f32) -> [S::F; 2] {
    let enter = s.add(s.mul(s.load(coordinates), s.splat(step)), s.splat(start));
    [enter, s.add(enter, s.splat(width))]
}

/// The bits of 64 cells, sixteen at a time.
#[inline(always)]
pub(crate) fn of_quarters([a, b, c, d]: [Mask; 4]) -> u64 {
    (u64::from(a) | u64::from(b) << 16) | (u64::from(c) << 32 | u64::from(d) << 48)
}

/// Coordinates of cells in Morton order: x of each sixteen, y of the first and second, z of the first and third.
pub(crate) const COORDINATES: [[f32; LANES]; 5] =
    [coordinates(0, 0), coordinates(0, 1), coordinates(16, 1), coordinates(0, 2), coordinates(32, 2)];

/// The coordinates along `axis` of sixteen cells from `first` on.
const fn coordinates(first: u32, axis: usize) -> [f32; LANES] {
    let mut coordinates = [0.0; LANES];
    let mut lane = 0;
    while lane < 16 {
        coordinates[lane as usize] = cell_coordinates(first + lane)[axis] as f32;
        lane += 1;
    }
    coordinates
}

/// A ray whose origin is farther from the grid than this, in grid units, misses: corners can no longer be
/// told apart.
const REACH_MAX: f32 = power_of_two(60);
