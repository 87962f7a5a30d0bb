//! Prepares scenes: reads meshes, builds the grid over them and over spheres, and writes, opens and checks scene
//! images.
//!
//! ```
//! use rt_core::{Flat, SceneView};
//! use scene::{BuildOptions, Mesh, build};
//!
//! let tetrahedron = Mesh {
//!     positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
//!     triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
//! };
//! let scene = build(tetrahedron, &BuildOptions::default(), &|_| {})?;
//! let image = scene.to_bytes(16 << 10)?;
//! let view = SceneView::new(Flat::new(&image))?;
//! assert_eq!(view.header().triangles, 4);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]

mod bricks;
mod build;
pub mod builtin;
pub mod file;
#[cfg(any(test, feature = "fuzzing"))]
pub mod fuzzing;
mod info;
mod mesh;
mod model;
pub mod read;
pub mod volume;
mod write;

pub use bricks::{PrepareError, write_volume};
pub use build::{BuildError, BuildOptions, Progress, Scene, Stage, build};
pub use file::{OpenError, SceneFile};
pub use info::Info;
pub use mesh::Mesh;
pub use model::Model;
pub use read::{ReadError, parse_mesh, read_mesh};
pub use volume::{VolumeError, VolumeShape, VolumeSource};
pub use write::WriteError;
