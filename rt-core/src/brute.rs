//! The oracle: every triangle and sphere of an image, one after the other, with the plain test.
//!
//! Kernels must agree with it bit for bit. It is for tests, and for embedders who want to check a kernel of
//! their own.

use crate::cluster::{Cluster, Nearest};
use crate::grid::{ClusterRef, LeafContent, SpheresRef};
use crate::grid_ray::GridRay;
use crate::kinds::AllKinds;
use crate::memory::SceneMemory;
use crate::ray::{Hit, Ray};
use crate::sphere::SphereCluster;
use crate::view::{Damaged, SceneView};

/// The nearest hit of a ray, found without the grid.
///
/// # Errors
/// [`Damaged`] when the leaves name clusters that cannot be read.
pub fn nearest<M: SceneMemory>(scene: &SceneView<M>, ray: &Ray) -> Result<Option<Hit>, Damaged> {
    let Some(ray) = GridRay::from_world(ray, scene.header()) else { return Ok(None) };
    let mut nearest = Nearest::none(ray.t_max());
    for index in 0..scene.header().leaves {
        match scene.leaf(index)?.content().ok_or(Damaged::Leaf(index))? {
            LeafContent::Cluster(place) => test_triangles(scene, &place, &ray, &mut nearest)?,
            LeafContent::Spheres(place) => test_spheres(scene, &place, &ray, &mut nearest)?,
            LeafContent::List { .. } => {}
        }
    }
    Ok(ray.hit::<AllKinds>(&nearest))
}

fn test_triangles<M: SceneMemory>(
    scene: &SceneView<M>,
    place: &ClusterRef,
    ray: &GridRay,
    nearest: &mut Nearest,
) -> Result<(), Damaged> {
    let record = scene.cluster(place)?;
    let cluster = Cluster::new(&record, place).ok_or(Damaged::Cluster { offset: place.offset })?;
    let ray = ray.woop();
    for triangle in 0..usize::from(place.triangles) {
        let corners = cluster.triangle(triangle);
        if let Some(crossing) = ray.intersect(corners, nearest.crossing.t) {
            nearest.offer(crossing, cluster.primitive(triangle), corners);
        }
    }
    Ok(())
}

fn test_spheres<M: SceneMemory>(
    scene: &SceneView<M>,
    place: &SpheresRef,
    ray: &GridRay,
    nearest: &mut Nearest,
) -> Result<(), Damaged> {
    let record = scene.spheres(place)?;
    let cluster = SphereCluster::new(&record, place).ok_or(Damaged::Cluster { offset: place.offset })?;
    for index in 0..usize::from(place.count) {
        let sphere = cluster.sphere(index);
        if let Some(crossing) = ray.sphere_ray().intersect(&sphere, nearest.crossing.t) {
            nearest.offer(crossing, cluster.primitive(index), sphere);
        }
    }
    Ok(())
}

/// Whether a ray hits anything, found without the grid.
///
/// # Errors
/// As [`nearest`].
pub fn any<M: SceneMemory>(scene: &SceneView<M>, ray: &Ray) -> Result<bool, Damaged> {
    Ok(nearest(scene, ray)?.is_some())
}
