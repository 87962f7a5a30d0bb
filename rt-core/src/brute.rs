//! The oracle: every triangle of an image, one after the other, with the plain test.
//!
//! Kernels must agree with it bit for bit. It is for tests, and for embedders who want to check a kernel of
//! their own.

use crate::cluster::{Cluster, Nearest};
use crate::grid::LeafContent;
use crate::grid_ray::GridRay;
use crate::memory::SceneMemory;
use crate::ray::{Hit, Ray};
use crate::view::{Damaged, SceneView};

/// The nearest hit of a ray, found without the grid.
///
/// # Errors
/// [`Damaged`] when the leaves name clusters that cannot be read.
pub fn nearest<M: SceneMemory>(scene: &SceneView<M>, ray: &Ray) -> Result<Option<Hit>, Damaged> {
    let Some(ray) = GridRay::from_world(ray, scene.header()) else { return Ok(None) };
    let mut nearest = Nearest::none(ray.t_max());
    for index in 0..scene.header().leaves {
        let LeafContent::Cluster(place) = scene.leaf(index)?.content().ok_or(Damaged::Leaf(index))? else {
            continue;
        };
        let record = scene.cluster(&place)?;
        let cluster = Cluster::new(&record, &place).ok_or(Damaged::Cluster { offset: place.offset })?;
        for triangle in 0..usize::from(place.triangles) {
            let corners = cluster.triangle(triangle);
            if let Some(crossing) = ray.woop().intersect(corners, nearest.crossing.t) {
                nearest.offer(crossing, cluster.primitive(triangle), corners);
            }
        }
    }
    Ok(ray.hit(&nearest))
}

/// Whether a ray hits anything, found without the grid.
///
/// # Errors
/// As [`nearest`].
pub fn any<M: SceneMemory>(scene: &SceneView<M>, ray: &Ray) -> Result<bool, Damaged> {
    Ok(nearest(scene, ray)?.is_some())
}
