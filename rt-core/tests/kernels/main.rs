//! Tests of the kernels, in one program: each program compiles kernels of its own, and that takes longer than to run them.

#[path = "../common/mod.rs"]
mod common;

mod beams;
mod calls;
mod double_precision;
mod isosurfaces;
mod lying_images;
mod peer_counts;
mod rays;
mod spheres;
mod triangle_tests;
mod volume_beams;
mod volume_images;
mod watertight;
