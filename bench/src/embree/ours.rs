//! Our side: the kernels, and drawing whole pictures with them.

use anyhow::{Result, ensure};
use rt_core::{Flat, Frame, SceneNeeds, SceneView, TILE_SIZE, TileCounts, Tiles, render_tile};
use scene::{BuildOptions, Model, build};

use super::drawn::Drawn;
use super::level::Level;
use super::stopwatch::{self, Elapsed};
use super::subject::Subject;

/// A kernel of ours, as a competitor.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kernel(rt_core::Kernel);

const PAGE_BYTES: u32 = 16 << 10;

/// Builds the image of a subject with one thread.
pub(super) fn prepare(subject: &Subject) -> Result<(Elapsed, Vec<u8>)> {
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let model = subject.model.clone();
    let (elapsed, image) = stopwatch::time(|| one.install(|| image_of(model)));
    Ok((elapsed, image?))
}

fn image_of(model: Model) -> Result<Vec<u8>> {
    Ok(build(model, &BuildOptions::default(), &|_| {})?.to_bytes(PAGE_BYTES)?)
}

/// The frame without shadow rays: nothing faces a light that is nowhere.
pub(super) fn without_light(frame: &Frame) -> Frame {
    Frame { light: [f32::NAN; 3].into(), ..*frame }
}

impl Kernel {
    /// All that this processor can run and that draw such a scene their own way: beams leave spheres to the ray
    /// kernel.
    pub(super) fn of_scene(needs: SceneNeeds) -> impl Iterator<Item = Self> {
        let spheres = needs.contains(SceneNeeds::SPHERES);
        rt_core::Kernel::available().map(Self).filter(move |kernel| kernel.is_ray() || !spheres)
    }

    /// The kernel that follows one ray at a time, on any processor.
    #[cfg(test)]
    pub(super) const RAYS: Self = Self(rt_core::Kernel::Rays(rt_core::Lanes::PORTABLE));

    pub(super) fn name(self) -> &'static str {
        self.0.name()
    }

    pub(super) fn is_ray(self) -> bool {
        matches!(self.0, rt_core::Kernel::Rays(_))
    }

    /// The vectors that it uses; it is compared with whoever may use as wide ones or wider.
    pub(super) fn level(self) -> Level {
        let (rt_core::Kernel::Rays(lanes) | rt_core::Kernel::Beams(lanes)) = self.0;
        match lanes.name() {
            "avx512" => Level::Avx512,
            "avx2" => Level::Avx2,
            _ => Level::Portable,
        }
    }

    /// Draws a picture, tile by tile.
    pub(super) fn draw(
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
            counts += render_tile(scene, frame, tile, self.0, pixels, &mut ());
            for (y, row) in (tile.y..).zip(pixels.chunks_exact(tile.width as usize)) {
                let start = y as usize * frame.width as usize + tile.x as usize;
                picture[start..start + row.len()].copy_from_slice(row);
            }
        }
        counts
    }
}
