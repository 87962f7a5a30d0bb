//! What the rays of a tile find: depth, point, normal and light of sixteen pixels at a time.
//!
//! The very arithmetic of [`triangle_woop`](crate::triangle_woop) and [`shade`](crate::shade), lane by lane, for the
//! triangle that a pixel is known to show; so the bits are those of the ray kernel.

use glam::Vec3;

use super::pixels::{COLUMNS, Pixels, ROWS};
use super::sphere_surface::sphere_surface;
use crate::blocks::first_pixel;
use crate::camera::Camera;
use crate::kinds::Kinds;
use crate::memory::SceneMemory;
use crate::shade::{AMBIENT, DIFFUSE};
use crate::simd::{Mask, Simd, each};
use crate::tile::Tile;
use crate::view::Damaged;

/// Where the rays of sixteen pixels of one block meet a surface.
#[derive(Clone, Copy)]
pub(super) struct Met<F> {
    pub(super) direction: [F; 3],
    /// Depth along the camera's forward axis, in grid units.
    pub(super) t: F,
    /// Unit normal, to either side.
    pub(super) normal: [F; 3],
}

#[cfg(feature = "volumes")]
impl<F: Copy> Met<F> {
    /// Rays that have met nothing so far.
    #[inline(always)]
    pub(super) fn nothing<S: Simd<F = F>>(s: S, direction: [F; 3]) -> Self {
        Self { direction, t: s.splat(0.0), normal: [s.splat(0.0); 3] }
    }

    /// The same, where some lanes meet other things.
    #[inline(always)]
    pub(super) fn with<S: Simd<F = F>>(&self, s: S, lanes: Mask, other: &Self) -> Self {
        let normal = each!(3: [0, 1, 2], axis => s.select(lanes, other.normal[axis], self.normal[axis]));
        Self { direction: self.direction, t: s.select(lanes, other.t, self.t), normal }
    }
}

/// Sixteen pixels of one block.
pub(super) struct Surface<F> {
    /// Depth along the camera's forward axis, in grid units.
    pub(super) t: F,
    /// The point, lifted off the surface.
    pub(super) point: [F; 3],
    /// Grey when the light reaches the point.
    pub(super) grey: F,
    /// Pixels that face the light.
    pub(super) facing: Mask,
}

/// The frame in grid units.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lighting {
    pub(super) eye: Vec3,
    pub(super) light: Vec3,
    pub(super) shadow_offset: f32,
}

/// The order of the axes in which a ray's triangle test works.
#[derive(Clone, Copy)]
struct Axes([usize; 3]);

/// The corners of sixteen triangles, by corner and axis.
type Corners<F> = [[F; 3]; 3];

/// Finds where the rays of the pixels of a block that hit something meet it.
///
/// # Errors
/// [`Damaged`], as [`Pixels::corners`].
#[inline(always)]
pub(super) fn meet<S: Simd, M: SceneMemory, K: Kinds>(
    s: S,
    pixels: &Pixels<'_, M, K>,
    block: usize,
    camera: &Camera,
    tile: Tile,
) -> Result<Met<S::F>, Damaged> {
    let direction = directions(s, camera, tile, block);
    let spheres = pixels.showing_spheres(block);
    let triangles = pixels.hit[block] & !spheres;
    let (mut t, mut normal) = (s.splat(0.0), [s.splat(0.0); 3]);
    if K::TRIANGLES && (!K::SPHERES || triangles != 0) {
        let corners = pixels.corners(s, block, triangles)?;
        t = depth(s, pixels.eye, direction, &corners, triangles);
        normal = normal_of(s, &corners, direction);
    }
    if K::SPHERES && (!K::TRIANGLES || spheres != 0) {
        let found = pixels.spheres(s, block, spheres)?;
        let (t_sphere, normal_sphere) = sphere_surface(s, pixels.eye, direction, found);
        t = s.select(spheres, t_sphere, t);
        normal = each!(3: [0, 1, 2], axis => s.select(spheres, normal_sphere[axis], normal[axis]));
    }
    Ok(Met { direction, t, normal })
}

/// [`Camera::direction`] of sixteen pixels.
#[inline(always)]
pub(super) fn directions<S: Simd>(s: S, camera: &Camera, tile: Tile, block: usize) -> [S::F; 3] {
    let (x, y) = first_pixel(block);
    // Small whole numbers, so sums are exact.
    let column = s.add(s.load(&COLUMNS), s.splat((tile.x as usize + x) as f32));
    let row = s.add(s.load(&ROWS), s.splat((tile.y as usize + y) as f32));
    directions_at(s, camera, column, row)
}

/// The same for pixels of these columns and rows of the picture.
#[inline(always)]
pub(super) fn directions_at<S: Simd>(s: S, camera: &Camera, column: S::F, row: S::F) -> [S::F; 3] {
    let x = s.add(s.splat(camera.x_first), s.mul(column, s.splat(camera.x_step)));
    let y = s.add(s.splat(camera.y_first), s.mul(row, s.splat(camera.y_step)));
    each!(3: [0, 1, 2], axis => {
        let row = s.add(s.splat(camera.forward[axis]), s.mul(s.splat(camera.up[axis]), y));
        s.add(row, s.mul(s.splat(camera.right[axis]), x))
    })
}

/// The ray parameters at which sixteen rays cross their triangles.
#[inline(always)]
fn depth<S: Simd>(s: S, eye: Vec3, direction: [S::F; 3], corners: &Corners<S::F>, hit: Mask) -> S::F {
    let [x, y, z] = each!(3: direction, component => s.abs(component));
    let (x_before_y, x_before_z, y_before_z) = (s.lt(y, x), s.lt(z, x), s.lt(z, y));
    let last = [x_before_y & x_before_z, !x_before_y & y_before_z];
    let last = [last[0], last[1], !(last[0] | last[1])];
    let mut t = s.splat(0.0);
    // Nearly always all sixteen rays have the same order of axes.
    for axis in 0..3 {
        let backwards = s.lt(direction[axis], s.splat(0.0));
        for (lanes, is_swapped) in [(last[axis] & !backwards, false), (last[axis] & backwards, true)] {
            if lanes & hit != 0 {
                let (first, second) = ((axis + 1) % 3, (axis + 2) % 3);
                let axes = Axes(if is_swapped { [second, first, axis] } else { [first, second, axis] });
                t = s.select(lanes, depth_along(s, axes, eye, direction, corners), t);
            }
        }
    }
    t
}

/// The same for rays of one order of axes.
#[inline(always)]
fn depth_along<S: Simd>(
    s: S,
    Axes(axes): Axes,
    eye: Vec3,
    direction: [S::F; 3],
    corners: &Corners<S::F>,
) -> S::F {
    let [first, second, along] = each!(3: axes, axis => direction[axis]);
    let shear = [s.div(first, along), s.div(second, along), s.div(s.splat(1.0), along)];
    let origin = each!(3: axes, axis => s.splat(eye[axis]));
    let [a, b, c] = each!(3: *corners, corner => {
        let [x, y, z] = each!(3: axes, axis => corner[axis]);
        let height = s.sub(z, origin[2]);
        let x = s.sub(s.sub(x, origin[0]), s.mul(shear[0], height));
        let y = s.sub(s.sub(y, origin[1]), s.mul(shear[1], height));
        [s.widen(x), s.widen(y), s.widen(s.mul(shear[2], height))]
    });
    let [u, v, w] = [minor(s, c, b, 0, 1), minor(s, a, c, 0, 1), minor(s, b, a, 0, 1)];
    let sum = s.add_f64(s.add_f64(u, v), w);
    let t = s.add_f64(s.add_f64(s.mul_f64(u, a[2]), s.mul_f64(v, b[2])), s.mul_f64(w, c[2]));
    s.narrow(s.div_f64(t, sum))
}

/// [`crate::shade::normal`] of sixteen triangles.
#[inline(always)]
fn normal_of<S: Simd>(s: S, [a, b, c]: &Corners<S::F>, direction: [S::F; 3]) -> [S::F; 3] {
    let b = each!(3: [0, 1, 2], axis => s.sub_f64(s.widen(b[axis]), s.widen(a[axis])));
    let c = each!(3: [0, 1, 2], axis => s.sub_f64(s.widen(c[axis]), s.widen(a[axis])));
    let across = [minor(s, b, c, 1, 2), minor(s, b, c, 2, 0), minor(s, b, c, 0, 1)];
    let is_zero = each!(3: across, component => s.is_zero_f64(component));
    let normal = unit(s, across);
    let is_zero = is_zero[0] & is_zero[1] & is_zero[2];
    if is_zero == 0 {
        return normal;
    }
    let zero = s.widen(s.splat(0.0));
    let against = unit(s, each!(3: direction, component => s.sub_f64(zero, s.widen(component))));
    each!(3: [0, 1, 2], axis => s.select(is_zero, against[axis], normal[axis]))
}

/// `b_i c_j - b_j c_i`.
#[inline(always)]
fn minor<S: Simd>(s: S, b: [S::D; 3], c: [S::D; 3], i: usize, j: usize) -> S::D {
    s.sub_f64(s.mul_f64(b[i], c[j]), s.mul_f64(b[j], c[i]))
}

#[inline(always)]
pub(super) fn unit<S: Simd>(s: S, [x, y, z]: [S::D; 3]) -> [S::F; 3] {
    let square = s.add_f64(s.add_f64(s.mul_f64(x, x), s.mul_f64(y, y)), s.mul_f64(z, z));
    let per_length = s.div_f64(s.widen(s.splat(1.0)), s.sqrt_f64(square));
    each!(3: [x, y, z], component => s.narrow(s.mul_f64(component, per_length)))
}

/// [`LitPoint`](crate::shade::LitPoint) of sixteen points on surfaces of these greys.
#[inline(always)]
pub(super) fn shade<S: Simd>(s: S, met: &Met<S::F>, albedo: S::F, lighting: &Lighting) -> Surface<S::F> {
    let Met { direction, t, normal } = *met;
    let zero = s.splat(0.0);
    let turned = s.lt(zero, s.dot(normal, direction));
    let normal = each!(3: normal, component => s.select(turned, s.mul(component, s.splat(-1.0)), component));
    let (eye, light) = (s.splat3(lighting.eye), s.splat3(lighting.light));
    let offset = s.splat(lighting.shadow_offset);
    let point = each!(3: [0, 1, 2], axis => s.add(s.add(eye[axis], s.mul(direction[axis], t)), s.mul(normal[axis], offset)));
    let to_light = each!(3: [0, 1, 2], axis => s.sub(light[axis], point[axis]));
    let facing = s.dot(normal, to_light);
    let distance = s.sqrt(s.dot(to_light, to_light));
    let share = s.mul(facing, s.div(s.splat(1.0), distance));
    let grey = s.mul(albedo, s.add(s.splat(AMBIENT), s.mul(s.splat(DIFFUSE), share)));
    Surface { t, point, grey, facing: s.lt(zero, facing) }
}
