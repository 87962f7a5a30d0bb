//! What a ray hit, as the kernels keep it until the ray is done.

use glam::Vec3;

use crate::sphere::Sphere;

/// A triangle by its corners, or a sphere; in grid units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Surface {
    /// Corners of a triangle.
    Triangle([Vec3; 3]),
    /// A sphere.
    Sphere(Sphere),
}

impl Surface {
    /// Numbers whose order decides between surfaces at the same distance: triangles before spheres, then the
    /// lowest corners, or the lowest centre and the smallest radius.
    pub(crate) fn order(&self) -> (u8, [[i32; 3]; 3]) {
        let ordered_point = |point: Vec3| point.to_array().map(ordered);
        match *self {
            Self::Triangle(corners) => (0, corners.map(ordered_point)),
            Self::Sphere(Sphere { centre, radius }) => {
                (1, [ordered_point(centre), [ordered(radius), 0, 0], [0; 3]])
            }
        }
    }
}

impl From<[Vec3; 3]> for Surface {
    fn from(corners: [Vec3; 3]) -> Self {
        Self::Triangle(corners)
    }
}

impl From<Sphere> for Surface {
    fn from(sphere: Sphere) -> Self {
        Self::Sphere(sphere)
    }
}

/// Bits of a float that compare as integers the way `f32::total_cmp` does.
fn ordered(value: f32) -> i32 {
    let bits = value.to_bits().cast_signed();
    bits ^ ((bits >> 31).cast_unsigned() >> 1).cast_signed()
}
