//! Built-in scenes, made by arithmetic alone, so that a first picture needs no file.

mod knot;
mod sphereflake;

use core::fmt;
use core::str::FromStr;

pub use knot::knot;
pub use sphereflake::{DEPTH_MAX, sphereflake};

use crate::model::Model;

/// A built-in scene by its name: `knot`, `knot:600000`, `sphereflake`, `sphereflake:3`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BuiltIn {
    /// The knot.
    Knot {
        /// Triangles it has at least.
        triangles: usize,
    },
    /// Spheres on spheres.
    Sphereflake {
        /// Generations of spheres after the first, up to [`DEPTH_MAX`].
        depth: u32,
    },
}

/// Why a name is not one of a built-in scene.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum BuiltInError {
    /// No built-in scene is called so; it may be a file.
    Unknown,
    /// What follows the colon is no number of triangles.
    Triangles(String),
    /// What follows the colon is no depth of a sphereflake.
    Depth(String),
}

impl BuiltIn {
    /// Makes the scene.
    ///
    /// # Panics
    /// When a knot has more vertices than 32 bits can number, or a sphereflake is deeper than [`DEPTH_MAX`].
    pub fn model(self) -> Model {
        match self {
            Self::Knot { triangles } => knot(triangles).into(),
            Self::Sphereflake { depth } => sphereflake(depth),
        }
    }
}

impl FromStr for BuiltIn {
    type Err = BuiltInError;

    fn from_str(name: &str) -> Result<Self, BuiltInError> {
        let (kind, number) = name.split_once(':').map_or((name, None), |(kind, number)| (kind, Some(number)));
        match kind {
            "knot" => {
                let triangles = number.map_or(Some(KNOT_TRIANGLES), |number| number.parse().ok());
                let triangles = triangles.filter(|triangles| (1..=KNOT_TRIANGLES_MAX).contains(triangles));
                let refused = || BuiltInError::Triangles(number.unwrap_or_default().to_owned());
                triangles.map(|triangles| Self::Knot { triangles }).ok_or_else(refused)
            }
            "sphereflake" => {
                let depth = number.map_or(Some(SPHEREFLAKE_DEPTH), |number| number.parse().ok());
                let refused = || BuiltInError::Depth(number.unwrap_or_default().to_owned());
                let depth = depth.filter(|depth| *depth <= DEPTH_MAX);
                depth.map(|depth| Self::Sphereflake { depth }).ok_or_else(refused)
            }
            _ => Err(BuiltInError::Unknown),
        }
    }
}

impl fmt::Display for BuiltIn {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Knot { .. } => write!(f, "the built-in knot"),
            Self::Sphereflake { depth } => write!(f, "the built-in sphereflake of depth {depth}"),
        }
    }
}

impl fmt::Display for BuiltInError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown => write!(f, "no built-in scene has this name; there are knot and sphereflake"),
            Self::Triangles(number) => {
                write!(f, "knot:{number}: expected a number of triangles from 1 to {KNOT_TRIANGLES_MAX}")
            }
            Self::Depth(number) => {
                write!(f, "sphereflake:{number}: expected a depth from 0 to {DEPTH_MAX}")
            }
        }
    }
}

impl core::error::Error for BuiltInError {}

/// Triangles of the knot when nobody says.
const KNOT_TRIANGLES: usize = 600_000;

/// Most triangles of a knot whose name is taken.
const KNOT_TRIANGLES_MAX: usize = 1_000_000_000;

/// Depth of the sphereflake when nobody says.
const SPHEREFLAKE_DEPTH: u32 = 3;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_and_others_left_alone() {
        let read = str::parse::<BuiltIn>;
        assert_eq!(read("knot:1000"), Ok(BuiltIn::Knot { triangles: 1000 }));
        assert_eq!(read("knot"), Ok(BuiltIn::Knot { triangles: KNOT_TRIANGLES }));
        assert_eq!(read("sphereflake:6"), Ok(BuiltIn::Sphereflake { depth: 6 }));
        assert_eq!(read("sphereflake"), Ok(BuiltIn::Sphereflake { depth: 3 }));
        for name in ["", "knot.ply", "sphereflakes", "dir/knot:3"] {
            assert_eq!(read(name), Err(BuiltInError::Unknown), "{name}");
        }
        assert_eq!(read("sphereflake:7"), Err(BuiltInError::Depth("7".to_owned())));
        assert_eq!(read("sphereflake:-1"), Err(BuiltInError::Depth("-1".to_owned())));
        assert_eq!(read("knot:many"), Err(BuiltInError::Triangles("many".to_owned())));
        assert_eq!(read("knot:0"), Err(BuiltInError::Triangles("0".to_owned())));
    }
}
