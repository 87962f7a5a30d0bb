//! Our side: the kernels, and drawing whole pictures with them.

use anyhow::{Result, ensure};
use kernels::Draw;
use rt_core::{Flat, Frame, SceneView, TILE_SIZE, TileCounts, Tiles};

use super::drawn::Drawn;
use super::level::Level;
use super::stopwatch;

/// A kernel of ours, as a competitor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Kernel(rt_core::Kernel);

/// The frame without shadow rays: nothing faces a light that is nowhere.
pub(crate) fn without_light(frame: &Frame) -> Frame {
    Frame { light: [f32::NAN; 3].into(), ..*frame }
}

impl Kernel {
    /// All that this processor can run.
    pub(crate) fn available() -> impl Iterator<Item = Self> {
        rt_core::Kernel::available().map(Self)
    }

    /// The one that nodes draw with when nobody says.
    pub(crate) fn fastest() -> Self {
        Self(rt_core::Kernel::fastest())
    }

    /// The one that follows one ray at a time, with the widest vectors.
    pub(crate) fn rays() -> Self {
        Self(rt_core::Kernel::rays())
    }

    /// The kernel that follows one ray at a time, on any processor.
    #[cfg(test)]
    pub(crate) const RAYS: Self = Self(rt_core::Kernel::Rays(rt_core::Lanes::PORTABLE));

    pub(crate) fn name(self) -> &'static str {
        self.0.name()
    }

    pub(crate) fn is_ray(self) -> bool {
        matches!(self.0, rt_core::Kernel::Rays(_))
    }

    /// The vectors that it uses; it is compared with whoever may use as wide ones or wider.
    pub(crate) fn level(self) -> Level {
        let (rt_core::Kernel::Rays(lanes) | rt_core::Kernel::Beams(lanes)) = self.0;
        match lanes.name() {
            "avx512" => Level::Avx512,
            "avx2" => Level::Avx2,
            _ => Level::Portable,
        }
    }

    /// Draws a picture, tile by tile.
    pub(crate) fn draw(
        self,
        scene: &SceneView<Flat<'_>>,
        frame: &Frame,
        picture: &mut [u8],
    ) -> Result<Drawn> {
        let (time, counts) = stopwatch::time(|| self.draw_tiles(scene, frame, picture));
        ensure!(counts.damaged == 0, "{} rays of the kernel {} found lies", counts.damaged, self.name());
        let greys = picture.iter().map(|&grey| u64::from(grey)).sum();
        let TileCounts { primary, hits, shadow, lit, .. } = counts;
        Ok(Drawn { time, primary, hits, shadow, lit, greys })
    }

    fn draw_tiles(self, scene: &SceneView<Flat<'_>>, frame: &Frame, picture: &mut [u8]) -> TileCounts {
        let tiles = Tiles::of(frame.width, frame.height);
        let mut counts = TileCounts::default();
        let mut pixels = [0; (TILE_SIZE * TILE_SIZE) as usize];
        for tile in tiles.ids().filter_map(|id| tiles.get(id)) {
            let pixels = &mut pixels[..tile.pixels()];
            counts += Draw::render_tile(scene, frame, tile, self.0, pixels);
            for (y, row) in (tile.y..).zip(pixels.chunks_exact(tile.width as usize)) {
                let start = y as usize * frame.width as usize + tile.x as usize;
                picture[start..start + row.len()].copy_from_slice(row);
            }
        }
        counts
    }
}
