//! The first frame of the measured scenes: as many hits, shadow rays and lit points as our peers count.
//!
//! The meshes are in the folder that `MEMSAVVY_DATA` names; their tests skip, and say so, when it is not set.

use std::path::PathBuf;

use rt_core::camera::OrbitPlace;
use rt_core::{Flat, Frame, Kernel, Orbit, SceneView, TileCounts, Tiles, render_tile};
use scene::{BuildOptions, Model, build, builtin, read_mesh};

/// Frame 0 at 512x512: hits, shadow rays, lit, mean t.
struct Peer {
    radius: f32,
    elevation: f64,
    hits: u64,
    shadow: u64,
    lit: u64,
    mean_t: f64,
}

const BUNNY: [Peer; 2] = [
    Peer { radius: 1.5, elevation: 0.0, hits: 44_405, shadow: 39_183, lit: 37_025, mean_t: 0.335_567_8 },
    Peer { radius: 0.75, elevation: 0.0, hits: 173_808, shadow: 160_106, lit: 152_398, mean_t: 0.146_465_1 },
];

const DRAGON: [Peer; 2] = [
    Peer { radius: 1.5, elevation: 0.0, hits: 42_863, shadow: 39_037, lit: 36_875, mean_t: 0.390_249 },
    Peer { radius: 0.75, elevation: 0.0, hits: 167_273, shadow: 154_598, lit: 146_720, mean_t: 0.189_411_4 },
];

/// Robust mode, one ray at a time.
const SPHEREFLAKE: [Peer; 2] = [
    Peer { radius: 0.75, elevation: 20.0, hits: 203_097, shadow: 192_856, lit: 151_482, mean_t: 4.942_751 },
    Peer { radius: 0.5, elevation: 20.0, hits: 243_307, shadow: 222_330, lit: 159_384, mean_t: 2.676_871 },
];

const BUDDHA: [Peer; 1] =
    [Peer { radius: 0.75, elevation: 0.0, hits: 112_147, shadow: 99_221, lit: 72_195, mean_t: 1.622_661 }];

#[test]
fn buddha_counts_as_by_the_peers() {
    compare("buddha-100k.ply", &BUDDHA);
}

#[test]
fn bunny_counts_as_by_the_peers() {
    compare("bunny.ply", &BUNNY);
}

#[test]
fn dragon_counts_as_by_the_peers() {
    compare("dragon.ply", &DRAGON);
}

#[test]
fn the_sphereflake_counts_as_by_the_peers() {
    compare_model("sphereflake", builtin::sphereflake(3), &SPHEREFLAKE);
}

fn compare(name: &str, peers: &[Peer]) {
    let Some(data) = std::env::var_os("MEMSAVVY_DATA").map(PathBuf::from) else {
        eprintln!("skipped: MEMSAVVY_DATA does not name the folder with meshes/{name}");
        return;
    };
    let mesh = read_mesh(&data.join("meshes").join(name)).expect("the mesh is in the data folder");
    compare_model(name, mesh, peers);
}

fn compare_model(name: &str, model: impl Into<Model>, peers: &[Peer]) {
    let image =
        build(model, &BuildOptions::default(), &|_| {}).expect("builds").to_bytes(16 << 10).expect("fits");
    let scene = SceneView::new(Flat::new(&image)).expect("a valid image");
    for peer in peers {
        let ours = count(&scene, peer);
        let mean_t = ours.t_sum / ours.hits as f64;
        println!("{name} radius {}: ours / peers", peer.radius);
        println!("  hits {} / {}, shadow rays {} / {}", ours.hits, peer.hits, ours.shadow, peer.shadow);
        println!("  lit {} / {}, mean t {mean_t:.7} / {:.7}", ours.lit, peer.lit, peer.mean_t);
        let close = |ours: u64, peers: u64| ours.abs_diff(peers) <= 512 * 512 / 10_000;
        assert!(close(ours.hits, peer.hits) && close(ours.shadow, peer.shadow) && close(ours.lit, peer.lit));
        assert!((mean_t / peer.mean_t - 1.0).abs() < 1.0e-5);
        assert_eq!(ours.damaged, 0);
    }
}

fn count(scene: &SceneView<Flat<'_>>, peer: &Peer) -> TileCounts {
    let orbit = Orbit::around(&scene.header().view);
    let Peer { radius, elevation, .. } = *peer;
    let place = OrbitPlace { radius, elevation, frame: 0, frames: 1 };
    let frame = Frame::on_orbit(&orbit, &place, 512, 512).expect("a valid frame");
    let tiles = Tiles::of(frame.width, frame.height);
    let mut counts = TileCounts::default();
    for tile in tiles.ids().filter_map(|id| tiles.get(id)) {
        counts += render_tile(scene, &frame, tile, Kernel::fastest(), &mut vec![0; tile.pixels()], &mut ());
    }
    counts
}
