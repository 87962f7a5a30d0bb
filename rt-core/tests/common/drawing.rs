//! Pictures drawn by all kernels.

use rt_core::{Frame, Kernel, Lanes, SceneView, TileCounts, Tiles, WorkCounts, render_tile};

use super::watched::Watched;

/// A tile's picture and what was counted.
pub type Drawn = (Vec<u8>, TileCounts);

/// A picture by tiles, and the work.
pub fn draw(scene: &SceneView<Watched<'_>>, frame: &Frame, kernel: Kernel) -> (Vec<Drawn>, WorkCounts) {
    let tiles = Tiles::of(frame.width, frame.height);
    let mut work = WorkCounts::default();
    let one = |id| {
        let tile = tiles.get(id).expect("below the count");
        let mut pixels = vec![0; tile.pixels()];
        let counts = render_tile(scene, frame, tile, kernel, &mut pixels, &mut work);
        (pixels, counts)
    };
    (tiles.ids().map(one).collect(), work)
}

/// Asserts that all kernels draw the same, of a scene at hand and of one that may be far away, and gives back what was
/// counted.
pub fn agree_on_pictures(scene: &SceneView<Watched<'_>>, frame: &Frame, what: &str) -> TileCounts {
    scene.memory().forget(false);
    let (by_rays, _) = draw(scene, frame, Kernel::Rays(Lanes::PORTABLE));
    for kernel in Kernel::available().filter(|kernel| *kernel != Kernel::Rays(Lanes::PORTABLE)) {
        for is_far in [false, true] {
            // Rays read what they must in any case.
            if is_far && matches!(kernel, Kernel::Rays(_)) {
                continue;
            }
            scene.memory().forget(is_far);
            for (tile, (found, expected)) in draw(scene, frame, kernel).0.iter().zip(&by_rays).enumerate() {
                let differ = (0..found.0.len()).filter(|&at| found.0[at] != expected.0[at]).count();
                assert!(
                    differ == 0 && found.1 == expected.1,
                    "{what}: tile {tile} by {kernel}, far away: {is_far}, has {differ} other pixels\n{:?}\n{:?}",
                    found.1,
                    expected.1
                );
            }
        }
    }
    by_rays.iter().fold(TileCounts::default(), |sum, (_, counts)| sum + *counts)
}
