//! Why a model cannot be built.

use core::fmt;

/// Why no grid can be built over a model.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum BuildError {
    /// There are no triangles and no spheres.
    NoTriangles,
    /// Every triangle has two corners at the same point, and every sphere has a radius of 0 (or one that is
    /// lost beside the scene's size), so no ray can hit anything.
    AllCollapsed {
        /// Number of triangles.
        triangles: usize,
        /// Number of spheres.
        spheres: usize,
    },
    /// The centre or radius of a sphere is NaN or infinite, or its surface lies beyond what single precision can
    /// hold.
    SphereNotFinite {
        /// Number of the sphere, from 0.
        sphere: usize,
    },
    /// A sphere's radius is below 0.
    NegativeRadius {
        /// Number of the sphere, from 0.
        sphere: usize,
        /// The radius.
        radius: f32,
    },
    /// The view is not a box with finite corners in order.
    View,
    /// A triangle names a vertex that does not exist.
    NoSuchVertex {
        /// Number of the triangle, from 0.
        triangle: usize,
        /// The vertex it names.
        vertex: u32,
        /// Number of vertices there are.
        vertices: usize,
    },
    /// A coordinate is NaN or infinite.
    NotFinite {
        /// Number of the vertex, from 0.
        vertex: usize,
    },
    /// The largest coordinate is beyond what the image can scale: 2^101 or more, or below 2^-100.
    OutOfRange {
        /// The largest absolute coordinate.
        largest: f32,
    },
    /// More triangles and spheres than 32-bit numbers can name.
    TooManyTriangles {
        /// Number of triangles and spheres, copies in several cells included.
        count: u64,
    },
}

impl fmt::Display for BuildError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoTriangles => write!(f, "the mesh has no triangles, so there is nothing to render"),
            Self::AllCollapsed { triangles, spheres: 0 } => {
                write!(
                    f,
                    "none of the {triangles} triangles has an area: each has two corners at the same point"
                )
            }
            Self::AllCollapsed { triangles, spheres } => {
                write!(
                    f,
                    "none of the {triangles} triangles has an area and none of the {spheres} spheres a radius"
                )
            }
            Self::SphereNotFinite { sphere } => {
                write!(
                    f,
                    "sphere {sphere} has a centre or radius that is not a finite number, or is too large"
                )
            }
            Self::NegativeRadius { sphere, radius } => {
                write!(f, "sphere {sphere} has the radius {radius}, which is below 0")
            }
            Self::View => write!(f, "the view is not a box with finite corners in order"),
            Self::NoSuchVertex { triangle, vertex, vertices } => {
                write!(f, "triangle {triangle} names vertex {vertex}, but there are only {vertices}")
            }
            Self::NotFinite { vertex } => {
                write!(f, "vertex {vertex} has a coordinate that is not a finite number")
            }
            Self::OutOfRange { largest } => {
                write!(f, "the largest coordinate is {largest:e}; scale the mesh to between 1e-30 and 1e30")
            }
            Self::TooManyTriangles { count } => {
                write!(f, "{count} triangles and spheres are more than an image can number")
            }
        }
    }
}

impl core::error::Error for BuildError {}
