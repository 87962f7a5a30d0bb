//! The rays of frame 0 are those of the renderers we compare with: same camera, same hits, same shadow rays.

use tests::{Folder, data, render};

/// Mesh, radius, hits and shadow rays of frame 0 at 512x512, as Embree counts them with the same camera, light and
/// shadow rule.
const COUNTS: [(&str, &str, u64, u64); 4] = [
    ("bunny", "1.5", 44_405, 39_183),
    ("bunny", "0.75", 173_808, 160_106),
    ("dragon", "1.5", 42_863, 39_037),
    ("dragon", "0.75", 167_273, 154_598),
];

#[test]
fn hits_and_shadow_rays_are_the_peers_but_for_one_ray_in_ten_thousand() {
    for (mesh, radius, hits, shadow_rays) in COUNTS {
        let Some(path) = data(&format!("meshes/{mesh}.ply")) else { return };
        let folder = Folder::new(&format!("counts-{mesh}-{radius}"));
        let report = render(&folder, &[path.to_str().unwrap(), "--radius", radius, "--nodes", "2"]);
        let frame = &report.frames[0];
        println!(
            "{mesh} {radius}: hits {} (peers {hits}), shadow rays {} (peers {shadow_rays})",
            frame.hits, frame.shadow_rays
        );
        let near = |ours: u64, theirs: u64| ours.abs_diff(theirs) * 10_000 <= frame.primary_rays;
        assert!(near(frame.hits, hits) && near(frame.shadow_rays, shadow_rays), "{mesh} {radius}: {frame:?}");
        assert_eq!(frame.damaged_pixels, 0);
    }
}
