//! Images whose segments lie: the kernel ends, within its bounds, without a panic.

use core::cell::Cell;

use crate::common::{Dice, image};
use glam::Vec3;
use proptest::prelude::*;
use rt_core::grid::{BRANCH_BYTES, Branch, LEAF_BYTES, Leaf};
use rt_core::{Damaged, Flat, Ray, SceneMemory, SceneView, WorkCounts, brute};
use scene::{BuildOptions, build, builtin};

/// An image with clusters of triangles, of spheres, and lists of both.
fn image_of_a_sphereflake() -> Vec<u8> {
    let scene = build(builtin::sphereflake(3), &BuildOptions::default(), &|_| {}).expect("builds");
    scene.to_bytes(4096).expect("fits")
}

/// Traces some rays, and checks the bounds of their work.
fn trace(bytes: &[u8]) -> usize {
    let scene = SceneView::new(Flat::new(bytes)).expect("the header is sound");
    let mut dice = Dice(11);
    let mut damaged = 0;
    for _ in 0..20 {
        let origin = dice.point() * 6.0;
        let ray = Ray { origin, direction: dice.point() * 2.0 - origin, t_max: f32::INFINITY };
        for any in [false, true] {
            let mut work = WorkCounts::default();
            damaged += usize::from(match any {
                false => scene.nearest(&ray, &mut work).is_err(),
                true => scene.any(&ray, &mut work).is_err(),
            });
            let header = scene.header();
            assert!(
                work.branches <= u64::from(header.branches) && work.leaves <= u64::from(header.leaves),
                "{work:?}"
            );
            assert!(work.triangles + work.spheres <= u64::from(header.leaves) * 64, "{work:?}");
        }
    }
    damaged
}

proptest! {
    #[test]
    fn flipped_bytes_do_no_harm(
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..200),
        spheres in any::<bool>(),
    ) {
        let mut bytes =
            if spheres { image_of_a_sphereflake() } else { image(&builtin::knot(3000), 0.5, 4096) };
        for (place, value) in flips {
            let place = 4096 + place.index(bytes.len() - 4096);
            bytes[place] = value;
        }
        trace(&bytes);
        let _ = brute::nearest(
            &SceneView::new(Flat::new(&bytes)).expect("the header is sound"),
            &Ray { origin: Vec3::splat(9.0), direction: Vec3::NEG_ONE, t_max: 9.0 },
        );
    }

    #[test]
    fn random_branches_and_leaves_do_no_harm(seed in any::<u64>(), spheres in any::<bool>()) {
        let mut bytes =
            if spheres { image_of_a_sphereflake() } else { image(&builtin::knot(3000), 0.5, 4096) };
        let end = {
            let scene = SceneView::new(Flat::new(&bytes)).expect("the header is sound");
            usize::try_from(scene.header().segments.clusters.offset).expect("a small image")
        };
        let mut dice = Dice(seed);
        for bytes in bytes[4096..end].chunks_mut(8) {
            bytes.copy_from_slice(&dice.next().to_le_bytes()[..bytes.len()]);
        }
        trace(&bytes);
    }
}

/// Where the records of a segment lie, as `(offset, count)`.
fn records(bytes: &[u8]) -> [(usize, usize); 2] {
    let scene = SceneView::new(Flat::new(bytes)).expect("the header is sound");
    let header = scene.header();
    let place = |offset: u64| usize::try_from(offset).expect("a small image");
    [
        (place(header.segments.branches.offset), header.branches as usize),
        (place(header.segments.leaves.offset), header.leaves as usize),
    ]
}

#[test]
fn branches_that_lead_back_to_the_root_end() {
    let mut bytes = image(&builtin::knot(50_000), 0.5, 4096);
    let [(branches, count), _] = records(&bytes);
    assert!(count > 100);
    for record in bytes[branches..branches + count * BRANCH_BYTES].chunks_exact_mut(BRANCH_BYTES) {
        let cycle = Branch { occupied: u64::MAX, inner: u64::MAX, child: 0, ..Branch::default() };
        record.copy_from_slice(bytemuck::bytes_of(&Branch { child: 0, ..cycle }));
    }
    assert!(trace(&bytes) > 0, "children of the root run past the last branch or level");
}

#[test]
fn lists_of_lists_end() {
    let mut bytes = image(&builtin::knot(50_000), 0.5, 4096);
    let [_, (leaves, count)] = records(&bytes);
    let all = u32::try_from(count).expect("a small image");
    for record in bytes[leaves..leaves + count * LEAF_BYTES].chunks_exact_mut(LEAF_BYTES) {
        let everything =
            Leaf { cluster: Leaf::LIST, first: all, bounds: [0, 0, 0, 255, 255, 255], ..Leaf::default() };
        record.copy_from_slice(bytemuck::bytes_of(&everything));
    }
    assert!(trace(&bytes) > 0);
}

#[test]
fn a_leaf_of_a_kind_that_the_header_does_not_name_ends_the_ray() {
    let mut bytes = image(&builtin::knot(3000), 0.5, 4096);
    let [_, (leaves, count)] = records(&bytes);
    for record in bytes[leaves..leaves + count * LEAF_BYTES].chunks_exact_mut(LEAF_BYTES) {
        let leaf: Leaf = bytemuck::pod_read_unaligned(record);
        record.copy_from_slice(bytemuck::bytes_of(&Leaf { vertices: Leaf::SPHERES, count: 20, ..leaf }));
    }
    assert!(trace(&bytes) > 10, "the instance for triangles meets spheres");
}

#[test]
fn spheres_of_any_bits_are_no_harm() {
    let mut bytes = image_of_a_sphereflake();
    let [_, (leaves, count)] = records(&bytes);
    // Every leaf a full cluster of spheres, wherever its cluster lies.
    for record in bytes[leaves..leaves + count * LEAF_BYTES].chunks_exact_mut(LEAF_BYTES) {
        let leaf: Leaf = bytemuck::pod_read_unaligned(record);
        record.copy_from_slice(bytemuck::bytes_of(&Leaf { vertices: Leaf::SPHERES, count: 32, ..leaf }));
    }
    trace(&bytes);
    let (start, end) = {
        let scene = SceneView::new(Flat::new(&bytes)).expect("the header is sound");
        let clusters = scene.header().segments.clusters;
        let place = |offset: u64| usize::try_from(offset).expect("a small image");
        (place(clusters.offset), place(clusters.offset + clusters.bytes))
    };
    for value in [f32::NAN, f32::INFINITY, f32::MAX, f32::MIN, -0.0, f32::from_bits(1), 1.0e20] {
        for (index, float) in bytes[start..end].chunks_exact_mut(4).enumerate() {
            if index % 3 > 0 {
                float.copy_from_slice(&value.to_le_bytes());
            }
        }
        trace(&bytes);
    }
}

/// Memory whose pages cannot be had after a while.
struct Failing<'a> {
    bytes: Flat<'a>,
    left: Cell<u32>,
}

impl SceneMemory for Failing<'_> {
    type Record<'b>
        = &'b [u8]
    where
        Self: 'b;

    fn record(&self, offset: u64, length: usize) -> Option<&[u8]> {
        self.left.set(self.left.get().checked_sub(1)?);
        self.bytes.record(offset, length)
    }

    fn length(&self) -> u64 {
        self.bytes.length()
    }
}

#[test]
fn a_page_that_cannot_be_had_ends_the_ray_with_its_record() {
    let bytes = image(&builtin::knot(3000), 0.5, 4096);
    let ray = Ray { origin: Vec3::new(3.0, 0.0, 9.0), direction: Vec3::NEG_Z, t_max: f32::INFINITY };
    let nearest = |records: u32| {
        let memory = Failing { bytes: Flat::new(&bytes), left: Cell::new(records + 1) };
        SceneView::new(memory).expect("the header is the first record").nearest(&ray, &mut ())
    };
    assert_eq!(nearest(0), Err(Damaged::Branch(0)));
    let needed = (0..100).find(|&records| nearest(records).is_ok()).expect("a ray needs few records");
    assert!(nearest(needed).expect("enough").is_some());
    assert!((0..needed).all(|records| nearest(records).is_err()));
}
