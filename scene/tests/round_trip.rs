//! Images: the same pictures for every page size, the same bytes for any number of threads, all triangles in
//! them, and files that are not whole are refused.

use std::fs;
use std::path::PathBuf;

use rt_core::camera::OrbitPlace;
use rt_core::cluster::{Cluster, cluster_bytes};
use rt_core::grid::LeafContent;
use rt_core::sphere::{Sphere, SphereCluster, spheres_bytes};
use rt_core::{Flat, Frame, Kernel, Orbit, Primitive, SceneView, Tiles, render_tile};
use scene::file::view_of;
use scene::{BuildOptions, Mesh, Model, OpenError, SceneFile, build, builtin};

fn image(model: &(impl Into<Model> + Clone), page_bytes: u32) -> Vec<u8> {
    build(model.clone(), &BuildOptions::default(), &|_| {})
        .expect("builds")
        .to_bytes(page_bytes)
        .expect("fits")
}

fn picture(scene: &SceneView<Flat<'_>>, frame: u32) -> Vec<u8> {
    let orbit = Orbit::around(&scene.header().view);
    let place = OrbitPlace { radius: 0.9, elevation: 20.0, frame, frames: 5 };
    let frame = Frame::on_orbit(&orbit, &place, 150, 100).expect("a valid frame");
    let tiles = Tiles::of(frame.width, frame.height);
    let mut bytes = Vec::new();
    for tile in tiles.ids().filter_map(|id| tiles.get(id)) {
        let mut pixels = vec![0; tile.pixels()];
        let counts = render_tile(scene, &frame, tile, Kernel::fastest(), &mut pixels, &mut ());
        assert_eq!((counts.primary, counts.damaged), (tile.pixels() as u64, 0));
        bytes.extend(pixels);
    }
    bytes
}

#[test]
fn every_page_size_gives_the_same_pictures_and_the_same_order() {
    page_sizes_do_not_show(&builtin::knot(30_000).into());
    page_sizes_do_not_show(&builtin::sphereflake(4));
    page_sizes_do_not_show(&builtin::sphereflake(4).spheres.into());
}

fn page_sizes_do_not_show(model: &Model) {
    let images = [4 << 10, 16 << 10, 64 << 10, 2 << 20].map(|page_bytes| image(model, page_bytes));
    let scenes = images.each_ref().map(|bytes| view_of(bytes).expect("a sound image"));
    for frame in 0..3 {
        let pictures = scenes.map(|scene| picture(&scene, frame));
        assert!(pictures[0].iter().any(|&byte| byte > 100), "there is something to see");
        assert!(pictures.iter().all(|picture| *picture == pictures[0]));
    }
    let ids = |scene: &SceneView<Flat<'_>>| {
        (0..scene.header().primitives).map(|i| scene.original_id(Primitive(i))).collect::<Vec<_>>()
    };
    assert!(scenes.iter().all(|scene| ids(scene) == ids(&scenes[0])));
}

#[test]
fn the_scale_of_a_scene_does_not_show() {
    let mut mesh = builtin::knot(5000);
    // What is tiny beside the rest would become denormal.
    mesh.positions.iter_mut().flatten().filter(|x| x.abs() < 1.0e-6).for_each(|x| *x = 0.0);
    let at_unit_size = image(&mesh, 4096);
    let expected = picture(&view_of(&at_unit_size).expect("a sound image"), 1);
    for exponent in [-100, -60, 60, 98] {
        let scaled = |p: &[f32; 3]| p.map(|x| x * 2.0_f32.powi(exponent));
        let positions = mesh.positions.iter().map(scaled).collect();
        let image = image(&Mesh { positions, triangles: mesh.triangles.clone() }, 4096);
        let picture = picture(&view_of(&image).expect("a sound image"), 1);
        assert!(picture == expected, "2^{exponent} times as large, the picture is another");
    }
}

#[test]
fn the_scale_of_spheres_does_not_show() {
    let model = builtin::sphereflake(3);
    let expected = picture(&view_of(&image(&model, 4096)).expect("a sound image"), 1);
    for exponent in [-60, 60] {
        let scale = 2.0_f32.powi(exponent);
        let mut scaled = model.clone();
        scaled.mesh.positions.iter_mut().flatten().for_each(|x| *x *= scale);
        for Sphere { centre, radius } in &mut scaled.spheres {
            (*centre, *radius) = (*centre * scale, *radius * scale);
        }
        let view = model.view.expect("has one");
        scaled.view = Some(rt_core::Bounds { low: view.low * scale, high: view.high * scale });
        let picture = picture(&view_of(&image(&scaled, 4096)).expect("a sound image"), 1);
        assert!(picture == expected, "2^{exponent} times as large, the picture is another");
    }
}

#[test]
fn no_record_crosses_a_page() {
    no_record_of_crosses_a_page(&builtin::knot(30_000).into());
    no_record_of_crosses_a_page(&builtin::sphereflake(4));
}

fn no_record_of_crosses_a_page(model: &Model) {
    let bytes = image(model, 4096);
    let scene = view_of(&bytes).expect("a sound image");
    let header = scene.header();
    assert_eq!(header.image_bytes, bytes.len() as u64);
    for index in 0..header.leaves {
        let (offset, length) = match scene.leaf(index).expect("a leaf").content().expect("a sound leaf") {
            LeafContent::Cluster(place) => (place.offset, cluster_bytes(place.vertices, place.triangles)),
            LeafContent::Spheres(place) => (place.offset, spheres_bytes(place.count)),
            LeafContent::List { .. } => continue,
        };
        let start = header.segments.clusters.offset + offset;
        let last = start + length as u64 - 1;
        assert_eq!((start % 16, start / 4096), (0, last / 4096), "leaf {index}");
    }
}

#[test]
fn every_sphere_of_the_model_is_in_the_image() {
    let mut model = builtin::sphereflake(4);
    let (first, count) = (model.spheres[7], model.spheres.len());
    model.spheres.extend([first, Sphere { radius: 0.0, ..first }]);
    let bytes = image(&model, 4096);
    let scene = view_of(&bytes).expect("a sound image");
    let scale = scene.header().scale();
    let mut found = vec![false; count + 2];
    for index in 0..scene.header().leaves {
        let content = scene.leaf(index).expect("a leaf").content().expect("a sound leaf");
        let LeafContent::Spheres(place) = content else { continue };
        let record = scene.spheres(&place).expect("a cluster");
        let cluster = SphereCluster::new(record, &place).expect("a whole record");
        for index in 0..usize::from(place.count) {
            let id = scene.original_id(cluster.primitive(index)).expect("an id") as usize;
            let Sphere { centre, radius } = model.spheres[id - model.mesh.triangles.len()];
            let stored = Sphere { centre: scale.apply_to(centre), radius: scale.apply(radius) };
            assert_eq!(cluster.sphere(index), stored, "sphere {id}");
            found[id - model.mesh.triangles.len()] = true;
        }
    }
    assert!(found[..count].iter().all(|found| *found) && found[count..] == [false; 2]);
    let header = scene.header();
    assert_eq!((header.spheres, header.repeated, header.collapsed), (count as u64 + 2, 1, 1));
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    // A mesh with everything: many small triangles, some huge ones, repeated and collapsed ones.
    let mut mesh = builtin::knot(60_000);
    let vertices = u32::try_from(mesh.positions.len()).expect("a small mesh");
    mesh.triangles.extend((0..300).map(|i| [i * 7, i * 31 + 5, vertices - 1 - i * 50]));
    mesh.triangles.extend([[1, 2, 3]; 5]);
    mesh.triangles.push([4, 4, 5]);
    // And spheres on it.
    let spheres = builtin::sphereflake(4).spheres;
    let model = Model { mesh, spheres, view: None };
    let with_threads = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| image(&model, 4096))
    };
    let one = with_threads(1);
    assert_eq!(view_of(&one).expect("a sound image").header().collapsed, 1);
    for threads in [2, 3, 8] {
        assert!(with_threads(threads) == one, "{threads} threads build another image");
    }
}

#[test]
fn every_triangle_of_the_mesh_is_in_the_image_with_its_corners() {
    let mut mesh = builtin::knot(5000);
    let (first, last) = (mesh.triangles[0], *mesh.triangles.last().expect("a triangle"));
    mesh.triangles.extend([first, [last[1], last[2], last[0]], [7, 8, 7]]);
    let bytes = image(&mesh, 4096);
    let scene = view_of(&bytes).expect("a sound image");
    let scale = scene.header().scale();
    let mut found = vec![false; mesh.triangles.len()];
    for index in 0..scene.header().leaves {
        let content = scene.leaf(index).expect("a leaf").content().expect("a sound leaf");
        let LeafContent::Cluster(place) = content else { continue };
        let record = scene.cluster(&place).expect("a cluster");
        let cluster = Cluster::new(record, &place).expect("a whole record");
        for triangle in 0..usize::from(place.triangles) {
            let id = scene.original_id(cluster.primitive(triangle)).expect("an id") as usize;
            let corners = mesh.triangles[id].map(|v| scale.apply_to(mesh.positions[v as usize].into()));
            assert_eq!(cluster.triangle(triangle), corners, "triangle {id}");
            found[id] = true;
        }
    }
    let missing: Vec<usize> = (0..found.len()).filter(|&id| !found[id]).collect();
    let repeated_and_collapsed = [mesh.triangles.len() - 3, mesh.triangles.len() - 1];
    assert_eq!(missing, repeated_and_collapsed);
    assert_eq!((scene.header().repeated, scene.header().collapsed), (1, 1));
}

/// A file that is removed in the end.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str, bytes: &[u8]) -> Self {
        let path = std::env::temp_dir().join(format!("memsavvy-{}-{name}.msv", std::process::id()));
        fs::write(&path, bytes).expect("a writable folder");
        Self(path)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}

#[test]
fn a_written_file_opens_and_reads_back() {
    let scene = build(builtin::knot(3000), &BuildOptions::default(), &|_| {}).expect("builds");
    let scratch = Scratch::new("whole", b"");
    let mut file = fs::File::create(&scratch.0).expect("a writable folder");
    let header = scene.write(8192, &mut file, &|_| {}).expect("written");
    assert_eq!(scene.header(8192).expect("fits").image_bytes, header.image_bytes);
    assert!(SceneFile::is_one(&scratch.0).expect("readable"));
    let mut opened = SceneFile::open(&scratch.0).expect("a sound file");
    assert_eq!(*opened.header(), header);
    let bytes = opened.read_all().expect("readable");
    assert!(bytes == scene.to_bytes(8192).expect("fits"));
    assert_eq!(opened.info().pages * 8192, header.image_bytes);
    // Behind the end of the image there are zeros, for runs with larger pages.
    let mut tail = [1; 100];
    opened.read_at(header.image_bytes - 40, &mut tail).expect("readable");
    assert_eq!((&tail[..40], &tail[40..]), (&bytes[bytes.len() - 40..], &[0; 60][..]));
    opened.read_at(header.image_bytes + 8192, &mut tail).expect("readable");
    assert_eq!(tail, [0; 100]);
}

#[test]
fn broken_files_are_refused_with_one_line() {
    let whole = image(&builtin::knot(3000), 4096);
    let refused = |name: &str, bytes: &[u8]| {
        let error = SceneFile::open(&Scratch::new(name, bytes).0).expect_err("a broken file");
        let text = error.to_string();
        assert!(!text.contains('\n'), "{text:?}");
        text
    };
    assert_eq!(refused("empty", b""), "cut short: 0 bytes, the header alone has 1024");
    assert!(refused("foreign", &[7; 5000]).starts_with("not a scene image"));
    assert!(refused("unfinished", &vec![0; whole.len()]).starts_with("not a scene image"));
    for length in [100, 1023, 1024, 4096, whole.len() / 2, whole.len() - 1] {
        assert!(refused("cut", &whole[..length]).starts_with("cut short"), "at {length}");
    }
    assert!(refused("long", &[whole.as_slice(), b"x"].concat()).starts_with("not a whole scene image"));
    let header = *view_of(&whole).expect("a sound image").header();
    // A mesh has no segments of a volume.
    for (kind, segment) in header.segments.in_order().into_iter().filter(|(_, segment)| segment.bytes > 0) {
        let mut bytes = whole.clone();
        let last = usize::try_from(segment.offset + segment.bytes - 1).expect("a small file");
        bytes[last] ^= 1;
        assert!(matches!(view_of(&bytes), Err(OpenError::Checksum(damaged)) if damaged == kind));
        assert_eq!(refused("corrupt", &bytes), format!("corrupt: the {kind} do not match their checksum"));
    }
    assert!(matches!(SceneFile::open(&PathBuf::from("/nowhere/at.msv")), Err(OpenError::Io(_))));
}
