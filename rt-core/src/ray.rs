//! Rays and hits, in the caller's units.

use glam::Vec3;

/// A ray: the points `origin + t * direction` with `0 < t <= t_max`.
///
/// # Shape and units
/// World units. `direction` has any length; `t` counts lengths of it.
///
/// # Edge cases
/// A ray misses everything when its direction is zero, when a component of origin or direction is NaN or
/// infinite, when `t_max` is NaN or not above 0 (infinity is fine), or when its origin lies 2^60 scene sizes
/// away. A ray that starts on a triangle does not hit that triangle; one that starts on a sphere may hit its
/// other side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where the ray starts.
    pub origin: Vec3,
    /// Where it goes; need not have length 1.
    pub direction: Vec3,
    /// Largest `t` that counts, inclusive.
    pub t_max: f32,
}

/// Place of a triangle or sphere in the address order of the scene image, in `0..header.primitives`.
///
/// What is stored in several cells has several places; see [`original_id`](crate::SceneView::original_id) for
/// the number it had in the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Primitive(pub u32);

/// Where a ray meets a triangle or a sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance from the ray's origin, in lengths of its direction.
    pub t: f32,
    /// Weight of the triangle's second corner: the hit is `(1 - u - v) * a + u * b + v * c`. 0 on a sphere.
    pub u: f32,
    /// Weight of the third corner. 0 on a sphere.
    pub v: f32,
    /// The triangle or sphere, or one of the places where it is stored.
    pub primitive: Primitive,
    /// Unit normal of the triangle's plane; the corners run counter-clockwise seen from its tip. Outwards on a
    /// sphere.
    ///
    /// A triangle whose area is exactly 0 has none (rounding may still let a ray hit it): then this is
    /// against the ray.
    pub normal: Vec3,
}
