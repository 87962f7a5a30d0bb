//! What `memsavvy info` prints.

use rt_core::image::{SEGMENTS, SegmentKind};
use rt_core::volume::Volume;
use rt_core::{Bounds, Header, SceneNeeds};

/// Facts about a scene image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Info {
    /// Triangles of the model.
    pub triangles: u64,
    /// Spheres of the model.
    pub spheres: u64,
    /// Triangles that no ray can hit, because two corners are the same point, and spheres without a radius; not
    /// stored.
    pub collapsed: u64,
    /// Triangles and spheres that repeat an earlier one; not stored.
    pub repeated: u64,
    /// Vertices of the mesh.
    pub vertices: u64,
    /// Triangles and spheres stored, copies in several clusters included.
    pub stored: u64,
    /// Stored triangles and spheres for each one that can be hit; 1 without copies.
    pub duplication: f64,
    /// Levels of branches.
    pub levels: u32,
    /// Branches of the grid.
    pub branches: u32,
    /// Leaves of the grid, lists included.
    pub leaves: u32,
    /// Clusters of triangles and of spheres.
    pub clusters: u32,
    /// Stored triangles or spheres per cluster.
    pub primitives_per_cluster: f64,
    /// Bounds of all vertices and spheres.
    pub bounds: Bounds,
    /// What cameras look at.
    pub view: Bounds,
    /// Length of a typical edge, or diameter of a typical sphere, in world units.
    pub typical_edge: f32,
    /// Page size of the image.
    pub page_bytes: u32,
    /// Length of the image.
    pub image_bytes: u64,
    /// Pages of the image.
    pub pages: u64,
    /// Length of each segment.
    pub segments: [(SegmentKind, u64); SEGMENTS],
    /// Bytes of the whole image for each triangle and sphere of the model.
    pub bytes_per_primitive: f64,
    /// What the scene uses.
    pub needs: SceneNeeds,
    /// The volume, if there is one.
    pub volume: Option<Volume>,
}

impl From<&Header> for Info {
    fn from(header: &Header) -> Self {
        let ratio = |a: u64, b: u64| a as f64 / b.max(1) as f64;
        let stored = u64::from(header.primitives);
        let primitives = header.triangles.saturating_add(header.spheres);
        Self {
            triangles: header.triangles,
            spheres: header.spheres,
            collapsed: header.collapsed,
            repeated: header.repeated,
            vertices: header.vertices,
            stored,
            duplication: ratio(
                stored,
                primitives.saturating_sub(header.collapsed.saturating_add(header.repeated)),
            ),
            levels: header.grid.levels,
            branches: header.branches,
            leaves: header.leaves,
            clusters: header.clusters,
            primitives_per_cluster: ratio(stored, header.clusters.into()),
            bounds: header.bounds,
            view: header.view,
            typical_edge: header.scale().inverse().apply(header.typical_edge),
            page_bytes: header.page_bytes,
            image_bytes: header.image_bytes,
            pages: header.image_bytes / u64::from(header.page_bytes),
            segments: header.segments.in_order().map(|(kind, segment)| (kind, segment.bytes)),
            bytes_per_primitive: ratio(header.image_bytes, primitives),
            needs: header.needs,
            volume: header.volume,
        }
    }
}
