//! Flat shading with one point light.
//!
//! All lengths are in grid units; only ratios of them reach the pixel.

use glam::Vec3;

/// Grey of a pixel whose ray meets nothing.
pub const BACKGROUND: f32 = 0.2;
/// Share of a surface's grey that needs no light.
pub const AMBIENT: f32 = 0.1;
/// Share of a surface's grey that the light gives when it stands straight above.
pub const DIFFUSE: f32 = 0.9;
/// Grey of a fully lit surface.
pub const ALBEDO: f32 = 0.8;

/// Unit normal of a triangle, counter-clockwise; against `direction` when the triangle has no area.
///
/// Computed in `f64`, where no triangle of an image overflows or underflows, and rounded once.
pub fn normal([a, b, c]: [Vec3; 3], direction: Vec3) -> Vec3 {
    match cross(difference(b, a), difference(c, a)) {
        [0.0, 0.0, 0.0] => unit(difference(Vec3::ZERO, direction)),
        across => unit(across),
    }
}

/// A point that light may fall on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LitPoint {
    /// The point, lifted off the surface towards the viewer so that the surface does not shadow itself.
    pub point: Vec3,
    /// From the point to the light.
    pub to_light: Vec3,
    /// Cosine between the normal and `to_light`, times the length of `to_light`.
    facing: f32,
}

impl LitPoint {
    /// The point at `at` on a surface with this normal, seen along `direction`, or `None` when it faces away
    /// from the light.
    #[inline]
    pub fn new(at: Vec3, normal: Vec3, direction: Vec3, light: Vec3, offset: f32) -> Option<Self> {
        let normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
        let point = at + normal * offset;
        let to_light = light - point;
        let facing = normal.dot(to_light);
        (facing > 0.0).then_some(Self { point, to_light, facing })
    }

    /// Grey of the point when the light reaches it.
    #[inline]
    pub fn lit_grey(&self) -> f32 {
        self.lit_grey_of(ALBEDO)
    }

    /// Grey of the point on a surface of that grey when the light reaches it.
    #[inline]
    pub fn lit_grey_of(&self, albedo: f32) -> f32 {
        let distance = libm::sqrtf(self.to_light.dot(self.to_light));
        albedo * (AMBIENT + DIFFUSE * (self.facing * (1.0 / distance)))
    }
}

/// Grey of a surface that no light reaches.
pub const SHADOW: f32 = ALBEDO * AMBIENT;

/// The byte of a grey: `trunc(grey * 255 + 0.5)`, clamped to `0..=255`.
#[inline]
pub fn byte(grey: f32) -> u8 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the cast of a float truncates and saturates"
    )]
    let byte = (grey * 255.0 + 0.5) as u8;
    byte
}

pub(crate) fn difference(to: Vec3, from: Vec3) -> [f64; 3] {
    [0, 1, 2].map(|axis| f64::from(to[axis]) - f64::from(from[axis]))
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(crate) fn unit([x, y, z]: [f64; 3]) -> Vec3 {
    // Differences of coordinates are 0 or at least 2^-149, their products' squares at least 2^-596: no underflow.
    let per_length = 1.0 / libm::sqrt(x * x + y * y + z * z);
    #[expect(clippy::cast_possible_truncation, reason = "rounding to single precision is the result")]
    let unit = [x, y, z].map(|component| (component * per_length) as f32);
    Vec3::from(unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_round_half_up_and_clamp() {
        assert_eq!(byte(BACKGROUND), 51);
        assert_eq!(byte(SHADOW), 20);
        assert_eq!((byte(0.0), byte(1.0), byte(7.0), byte(-1.0), byte(f32::NAN)), (0, 255, 255, 0, 0));
    }

    #[test]
    fn the_normal_of_a_tiny_needle_is_exact() {
        let corners = [Vec3::ZERO, Vec3::new(1.0, 0.0, 0.0), Vec3::new(1.0, 1.0e-30, 0.0)];
        assert_eq!(normal(corners, Vec3::NEG_Z), Vec3::Z);
        assert_eq!(normal([Vec3::ONE; 3], Vec3::new(0.0, 0.0, -3.0)), Vec3::Z);
    }

    #[test]
    fn a_point_that_faces_away_gets_no_ray() {
        let light = Vec3::new(0.0, 0.0, 5.0);
        let seen_from_behind = LitPoint::new(Vec3::ZERO, Vec3::Z, Vec3::Z, light, 0.01);
        assert_eq!(seen_from_behind, None);
        let front = LitPoint::new(Vec3::ZERO, Vec3::NEG_Z, Vec3::NEG_Z, light, 1.0).expect("lit");
        assert_eq!((front.point.z, front.to_light.z), (1.0, 4.0));
        assert_eq!(byte(front.lit_grey()), byte(0.8));
    }
}
