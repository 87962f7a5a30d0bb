//! The kernels compiled once, for the memories that the programs here draw from.
//!
//! The kernels of `rt-core` are generic over the [memory](SceneMemory) that a scene lies in, and whoever names a memory has
//! them compiled, which takes minutes. A program that draws through [`Draw`] links what is compiled here.

pub mod noted;
pub mod pinned;

use rt_core::{Flat, Frame, Kernel, SceneMemory, SceneView, Tile, TileCounts};

use noted::Noted;
use pinned::Pinned;

/// A memory for which kernels are compiled here.
pub trait Draw: SceneMemory + Sized {
    /// [`rt_core::render_tile`], without counting work.
    fn render_tile(
        scene: &SceneView<Self>,
        frame: &Frame,
        tile: Tile,
        kernel: Kernel,
        pixels: &mut [u8],
    ) -> TileCounts;
}

/// Implements [`Draw`]. There is no type left open, so this is where the code comes to lie.
macro_rules! draw {
    ($($memory:ty),*) => {$(
        impl Draw for $memory {
            #[inline(never)]
            fn render_tile(
                scene: &SceneView<Self>,
                frame: &Frame,
                tile: Tile,
                kernel: Kernel,
                pixels: &mut [u8],
            ) -> TileCounts {
                rt_core::render_tile(scene, frame, tile, kernel, pixels, &mut ())
            }
        }
    )*};
}

draw!(Noted<'_, Flat<'_>>, Noted<'_, Pinned<'_>>);
#[cfg(feature = "flat")]
draw!(Flat<'_>);
