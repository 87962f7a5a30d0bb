//! Ray tracing kernels over borrowed memory: rays, a multi-level grid, triangles, spheres, shading and tiles.
//!
//! The crate allocates nothing, does no input or output, knows no clock and keeps no globals. It reads a
//! *scene image*, the bytes that `memsavvy prepare` writes, through one small trait, [`SceneMemory`]; where
//! those bytes come from (a mapped file, pages fetched from other machines, an array in flash) is the
//! caller's affair.
//!
//! # The path of a ray
//! [`SceneView::new`] checks the header of an image once. [`SceneView::nearest`] brings a [`Ray`] into the
//! image's own units ([`scale`]), walks the grid front to back ([`walk`]), tests the triangles and spheres of the
//! clusters it meets ([`cluster`], [`triangle_woop`], [`sphere`]) and answers with a [`Hit`]. [`render_tile`] draws one
//! tile of a [`Frame`], with hard shadows: ray by ray, or as one *beam* that takes 256 rays through the grid at once.
//! A beam only proposes what each pixel may show; where its rounding leaves a doubt, the pixel's ray decides. So both
//! draw the same bytes, with any [`Lanes`], and the [`Kernel`] is a choice of speed alone. The [isosurfaces](isosurface) of
//! a [`volume`] come by the same two ways.
//!
//! # What a scene does not need
//! A scene of triangles runs no instruction for spheres or volumes, nor the other way round ([`kinds`]). The features
//! `triangles`, `spheres` and `volumes`, all on by default, remove a kind from the binary altogether; an image that needs
//! what was left out is refused by its header. Likewise `shadows`, which frames may want, and `lanes-avx2` and
//! `lanes-avx512`, without which narrower lanes give the same bits.
//!
//! A normal is computed for a hit that is asked for it, not for [`SceneView::nearest_place`]; and which
//! [geometry](SceneView::geometry_id) a primitive belongs to is looked up by who wants to know: no kernel reads ids.
//!
//! Embedders also find [any hits](SceneView::any), [packets of 16 rays](SceneView::nearest16) under a mask,
//! [filters](SceneView::nearest_filtered) that pass hits through, and [other triangle tests](triangle_test).
//!
//! # Same bits everywhere
//! Whatever decides a result uses only `+ - * /` and `sqrt` in one stated order, without fused multiply-add,
//! so every machine computes the same bits. Culling is conservative, and its decisions do not show in the result.
//!
//! # Bytes that lie
//! An image whose checksums pass may still lie. Every index read from it is checked, the work of a ray is
//! bounded by the counts in the header, and a lie ends the ray with [`Damaged`]. No input makes the crate
//! panic, loop or read out of bounds.
//!
//! # Example
//! ```
//! use rt_core::{Flat, Ray, SceneView};
//! # use scene::{BuildOptions, Mesh};
//! # let positions = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
//! # let mesh = Mesh { positions, triangles: vec![[0, 1, 2]] };
//! # let bytes = scene::build(mesh, &BuildOptions::default(), &|_| {}).unwrap().to_bytes(4096).unwrap();
//! let scene = SceneView::new(Flat::new(&bytes))?;
//! let (origin, direction) = ([0.2, 0.2, 3.0].into(), [0.0, 0.0, -1.0].into());
//! let ray = Ray { origin, direction, t_max: f32::INFINITY };
//! let hit = scene.nearest(&ray, &mut ())?.expect("the ray meets the triangle");
//! assert_eq!(hit.t, 3.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![no_std]
#![deny(unsafe_code)]

#[cfg(test)]
extern crate std;

#[cfg(target_endian = "big")]
compile_error!("a scene image is little-endian and read in place; big-endian targets are not supported");

mod beam;
mod blocks;
#[cfg(feature = "volumes")]
mod brick;
pub mod brute;
pub mod camera;
pub mod cluster;
mod count;
pub mod cubic;
pub mod filter;
mod frame;
mod geometry;
pub mod grid;
pub mod grid_ray;
mod hit_place;
pub mod image;
#[cfg(feature = "volumes")]
pub mod isosurface;
#[cfg(feature = "volumes")]
pub mod isosurface_f64;
mod kernel;
pub mod kinds;
mod memory;
mod needs;
mod packet;
mod packet_cluster;
mod packet_rays;
mod packet_walk;
mod ray;
pub mod scale;
pub mod schedule;
pub mod shade;
mod simd;
pub mod sphere;
pub mod surface;
mod tile;
pub mod triangle_f64;
pub mod triangle_moller;
pub mod triangle_test;
pub mod triangle_woop;
mod view;
pub mod volume;
#[cfg(feature = "volumes")]
mod volume_memo;
#[cfg(feature = "volumes")]
pub mod volume_ray;
#[cfg(feature = "volumes")]
mod volume_tile;
pub mod walk;

pub use camera::{Camera, Orbit};
pub use count::{Count, TileCounts, WorkCounts};
pub use cubic::Solver;
pub use frame::{Frame, FrameError, ISOVALUES_MAX, Isosurface};
pub use geometry::GeometryId;
pub use hit_place::HitPlace;
pub use image::{Bounds, Header, HeaderError};
#[cfg(feature = "volumes")]
pub use isosurface::{IsoHit, Isosurfaces};
pub use kernel::Kernel;
pub use memory::{Flat, SceneMemory};
pub use needs::SceneNeeds;
pub use packet::{Hits16, Packet16};
pub use ray::{Hit, Primitive, Ray};
pub use simd::{Lanes, LanesError};
pub use tile::{TILE_SIZE, Tile, TileId, Tiles, render_tile};
pub use triangle_test::TriangleTestKind;
pub use view::{Damaged, SceneView};
