//! A scene image that kernels may read: bytes with a checked header.

use core::fmt;
use core::marker::PhantomData;

use crate::cluster::Nearest;
use crate::count::Count;
use crate::filter::Filter;
use crate::grid::{BRANCH_BYTES, Branch, ClusterRef, LEAF_BYTES, Leaf, SpheresRef};
use crate::grid_ray::GridRay;
use crate::image::{HEADER_BYTES, Header, HeaderError};
use crate::kinds::{ForKinds, Kinds, dispatch};
use crate::memory::SceneMemory;
use crate::needs::SceneNeeds;
use crate::ray::{Hit, Primitive, Ray};
use crate::simd::{Lanes, Simd, Task};
use crate::triangle_test::TriangleTest;
use crate::triangle_woop::WoopRay;
use crate::volume::{RANGE_BYTES, RangeBranch, TABLE_BYTES, TABLE_EDGES, Threshold, range_offset};
use crate::walk::walk_with;

/// A scene image with a checked header: what kernels trace.
///
/// Cheap to share between threads, and `Copy`, when the memory is.
#[derive(Clone, Copy, Debug)]
pub struct SceneView<M> {
    memory: M,
    header: Header,
    lanes: Lanes,
}

/// The segments of an image contradict its header or themselves, or a page could not be had. The ray was
/// given up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Damaged {
    /// A branch that does not exist or cannot be read.
    Branch(u32),
    /// A leaf that does not exist, cannot be read, or has impossible counts.
    Leaf(u32),
    /// A cluster that does not lie inside its segment or cannot be read.
    Cluster {
        /// Offset in the cluster segment.
        offset: u64,
    },
    /// A branch of the tree of ranges that does not exist or cannot be read.
    RangeBranch(u64),
    /// A brick of a volume that does not exist or cannot be read.
    Brick(u64),
    /// The table of a volume cannot be read.
    Table,
    /// Branches below the last level.
    Depth,
    /// More branches or leaves on the way of one ray than the image has: a cycle.
    Cycle,
}

impl<M: SceneMemory> SceneView<M> {
    /// Reads and checks the header of the image in `memory`. Rays will be traced with the widest lanes that the
    /// processor has; it is asked here, which takes some microseconds.
    ///
    /// # Errors
    /// As [`Header::parse`]. The segments are not looked at; verify their checksums before trusting a file.
    pub fn new(memory: M) -> Result<Self, HeaderError> {
        let available = usize::try_from(memory.length()).unwrap_or(usize::MAX).min(HEADER_BYTES);
        let truncated = HeaderError::Truncated { needed: HEADER_BYTES, got: available };
        let header = Header::parse(&memory.record(0, available).ok_or(truncated)?, memory.length())?;
        Ok(Self { memory, header, lanes: Lanes::widest() })
    }

    /// The same scene, its rays traced with other lanes. The answers are the same.
    #[must_use]
    pub fn with_lanes(self, lanes: Lanes) -> Self {
        Self { lanes, ..self }
    }

    /// The same scene as if it needed `more` as well: kernels then look for what is not there. The answers are the
    /// same; to measure what leaving out is worth.
    #[must_use]
    pub fn with_needs(self, more: SceneNeeds) -> Self {
        Self { header: Header { needs: self.header.needs.with(more), ..self.header }, ..self }
    }

    /// The lanes that rays are traced with.
    pub const fn lanes(&self) -> Lanes {
        self.lanes
    }

    /// The nearest hit of a ray, or `None` when it misses everything.
    ///
    /// The answer is that of testing every triangle and sphere of the image, whatever the ray; see
    /// [`walk`](crate::walk) for why, and [`Nearest`](crate::cluster::Nearest) for which of several at the same
    /// `t` it is.
    ///
    /// # Errors
    /// [`Damaged`] when the image lies or a page cannot be had.
    #[inline]
    pub fn nearest<C: Count>(&self, ray: &Ray, count: &mut C) -> Result<Option<Hit>, Damaged> {
        let Some(ray) = GridRay::from_world(ray, &self.header) else { return Ok(None) };
        self.nearest_with::<WoopRay, _, _>(&ray, &mut (), count)
    }

    /// Whether a ray hits anything.
    ///
    /// # Errors
    /// [`Damaged`] when the image lies or a page cannot be had.
    #[inline]
    pub fn any<C: Count>(&self, ray: &Ray, count: &mut C) -> Result<bool, Damaged> {
        let Some(ray) = GridRay::from_world(ray, &self.header) else { return Ok(false) };
        self.any_with::<WoopRay, _, _>(&ray, &mut (), count)
    }

    /// The nearest hit with a choice of triangle test and filter.
    #[inline]
    pub(crate) fn nearest_with<T: TriangleTest, F: Filter, C: Count>(
        &self,
        ray: &GridRay,
        filter: &mut F,
        count: &mut C,
    ) -> Result<Option<Hit>, Damaged> {
        let trace = Trace::<_, T, _, _, false> { scene: self, ray, filter, count, test: PhantomData };
        dispatch(self.header.needs, trace)
    }

    /// Whether there is any hit, with a choice of triangle test and filter.
    #[inline]
    pub(crate) fn any_with<T: TriangleTest, F: Filter, C: Count>(
        &self,
        ray: &GridRay,
        filter: &mut F,
        count: &mut C,
    ) -> Result<bool, Damaged> {
        let trace = Trace::<_, T, _, _, true> { scene: self, ray, filter, count, test: PhantomData };
        dispatch(self.header.needs, trace)
    }

    /// Number that a triangle or sphere had in the model, or `None` when there is no such primitive. Reads the
    /// ids segment.
    ///
    /// The triangles are numbered first, from 0; the spheres follow them, from `header.triangles` on.
    pub fn original_id(&self, Primitive(index): Primitive) -> Option<u32> {
        if index >= self.header.primitives {
            return None;
        }
        let record =
            self.memory.record(self.header.segments.ids.offset.checked_add(u64::from(index) * 4)?, 4)?;
        Some(u32::from_le_bytes((*record).try_into().ok()?))
    }

    /// The header of the image.
    pub const fn header(&self) -> &Header {
        &self.header
    }

    /// The memory that the image lies in.
    pub const fn memory(&self) -> &M {
        &self.memory
    }

    /// A copy of branch `index`.
    ///
    /// # Errors
    /// [`Damaged::Branch`].
    #[inline]
    pub fn branch(&self, index: u32) -> Result<Branch, Damaged> {
        let damaged = Damaged::Branch(index);
        if index >= self.header.branches {
            return Err(damaged);
        }
        let record = self.memory.record(self.offset_of_branch(index), BRANCH_BYTES).ok_or(damaged)?;
        bytemuck::try_pod_read_unaligned(&record).map_err(|_| damaged)
    }

    /// A copy of leaf `index`.
    ///
    /// # Errors
    /// [`Damaged::Leaf`].
    #[inline]
    pub fn leaf(&self, index: u32) -> Result<Leaf, Damaged> {
        let damaged = Damaged::Leaf(index);
        if index >= self.header.leaves {
            return Err(damaged);
        }
        let record = self.memory.record(self.offset_of_leaf(index), LEAF_BYTES).ok_or(damaged)?;
        bytemuck::try_pod_read_unaligned(&record).map_err(|_| damaged)
    }

    /// The bytes of a cluster of triangles, for [`Cluster::new`](crate::cluster::Cluster::new).
    ///
    /// # Errors
    /// [`Damaged::Cluster`].
    #[inline]
    pub fn cluster(&self, place: &ClusterRef) -> Result<M::Record<'_>, Damaged> {
        self.record_of_cluster(place.offset, crate::cluster::cluster_bytes(place.vertices, place.triangles))
    }

    /// The bytes of a cluster of spheres, for [`SphereCluster::new`](crate::sphere::SphereCluster::new).
    ///
    /// # Errors
    /// [`Damaged::Cluster`].
    #[inline]
    pub fn spheres(&self, place: &SpheresRef) -> Result<M::Record<'_>, Damaged> {
        self.record_of_cluster(place.offset, crate::sphere::spheres_bytes(place.count))
    }

    /// A copy of a branch of the tree of ranges.
    ///
    /// # Errors
    /// [`Damaged::RangeBranch`].
    #[inline]
    pub fn range_branch(&self, index: u64) -> Result<RangeBranch, Damaged> {
        let damaged = Damaged::RangeBranch(index);
        if self.header.volume.is_none_or(|volume| index >= volume.branches) {
            return Err(damaged);
        }
        let offset = self.header.segments.ranges.offset + range_offset(index);
        let record = self.memory.record(offset, RANGE_BYTES).ok_or(damaged)?;
        bytemuck::try_pod_read_unaligned(&record).map_err(|_| damaged)
    }

    /// The bytes of a brick.
    ///
    /// # Errors
    /// [`Damaged::Brick`].
    #[inline]
    pub fn brick(&self, index: u64) -> Result<M::Record<'_>, Damaged> {
        let damaged = Damaged::Brick(index);
        let volume = self.header.volume.filter(|volume| index < volume.bricks).ok_or(damaged)?;
        let offset = self.header.segments.bricks.offset + volume.brick_offset(index);
        self.memory.record(offset, volume.sample.brick_bytes()).ok_or(damaged)
    }

    /// Where a stored isovalue lies among the edges of the volume's table, which it reads.
    ///
    /// # Errors
    /// [`Damaged::Table`].
    pub fn threshold(&self, stored: f32) -> Result<Threshold, Damaged> {
        let segment = self.header.segments.table;
        if segment.bytes < TABLE_BYTES as u64 {
            return Err(Damaged::Table);
        }
        let record = self.memory.record(segment.offset, TABLE_BYTES).ok_or(Damaged::Table)?;
        let edges = record.get(..TABLE_EDGES * 4).ok_or(Damaged::Table)?.as_chunks().0;
        Ok(Threshold::among(edges.iter().map(|&edge| f32::from_le_bytes(edge)), stored))
    }

    #[inline]
    fn record_of_cluster(&self, offset: u64, length: usize) -> Result<M::Record<'_>, Damaged> {
        let damaged = Damaged::Cluster { offset };
        let segment = &self.header.segments.clusters;
        if offset + length as u64 > segment.bytes {
            return Err(damaged);
        }
        self.memory.record(segment.offset + offset, length).ok_or(damaged)
    }
}

/// A ray and how to trace it: for its nearest hit, or with `ANY` for whether there is one.
pub(crate) struct Trace<'a, M, T, F, C, const ANY: bool> {
    pub(crate) scene: &'a SceneView<M>,
    pub(crate) ray: &'a GridRay,
    pub(crate) filter: &'a mut F,
    pub(crate) count: &'a mut C,
    pub(crate) test: PhantomData<T>,
}

impl<M: SceneMemory, T: TriangleTest, F: Filter, C: Count> ForKinds for Trace<'_, M, T, F, C, false> {
    type Output = Result<Option<Hit>, Damaged>;

    #[inline]
    fn run<K: Kinds>(self) -> Self::Output {
        let ray = self.ray;
        Ok(ray.hit::<K>(&self.scene.lanes.run(OfKinds::<_, _, _, _, K, false>(self, PhantomData))?))
    }
}

impl<M: SceneMemory, T: TriangleTest, F: Filter, C: Count> ForKinds for Trace<'_, M, T, F, C, true> {
    type Output = Result<bool, Damaged>;

    #[inline]
    fn run<K: Kinds>(self) -> Self::Output {
        let nearest = self.scene.lanes.run(OfKinds::<_, _, _, _, K, true>(self, PhantomData))?;
        Ok(nearest.surface.is_some())
    }
}

/// A [`Trace`] of primitives of the kinds `K`.
pub(crate) struct OfKinds<'a, M, T, F, C, K, const ANY: bool>(
    pub(crate) Trace<'a, M, T, F, C, ANY>,
    pub(crate) PhantomData<K>,
);

impl<M, T, F, C, K, const ANY: bool> Task for OfKinds<'_, M, T, F, C, K, ANY>
where
    M: SceneMemory,
    T: TriangleTest,
    F: Filter,
    C: Count,
    K: Kinds,
{
    type Output = Result<Nearest, Damaged>;

    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> Self::Output {
        let Trace { scene, ray, filter, count, .. } = self.0;
        walk_with::<S, M, T, F, C, K, ANY>(s, scene, ray, filter, count)
    }
}

impl<M: SceneMemory> SceneView<M> {
    /// Tells the memory that a cluster will be read soon.
    #[inline]
    pub(crate) fn prefetch_cluster(&self, place: &ClusterRef) {
        let (offset, length) = self.bytes_of_cluster(place);
        self.memory.prefetch(offset, length);
    }

    /// The same for a cluster of spheres.
    #[inline]
    pub(crate) fn prefetch_spheres(&self, place: &SpheresRef) {
        let (offset, length) = self.bytes_of_spheres(place);
        self.memory.prefetch(offset, length);
    }

    /// Whether reading a branch takes no time to speak of.
    #[inline]
    pub(crate) fn has_branch_at_hand(&self, index: u32) -> bool {
        self.memory.is_at_hand(self.offset_of_branch(index), BRANCH_BYTES)
    }

    /// Whether reading a leaf takes no time to speak of.
    #[inline]
    pub(crate) fn has_leaf_at_hand(&self, index: u32) -> bool {
        self.memory.is_at_hand(self.offset_of_leaf(index), LEAF_BYTES)
    }

    /// Whether reading a cluster takes no time to speak of.
    #[inline]
    pub(crate) fn has_cluster_at_hand(&self, place: &ClusterRef) -> bool {
        let (offset, length) = self.bytes_of_cluster(place);
        self.memory.is_at_hand(offset, length)
    }

    /// The same for a cluster of spheres.
    #[inline]
    pub(crate) fn has_spheres_at_hand(&self, place: &SpheresRef) -> bool {
        let (offset, length) = self.bytes_of_spheres(place);
        self.memory.is_at_hand(offset, length)
    }

    const fn offset_of_branch(&self, index: u32) -> u64 {
        self.header.segments.branches.offset + index as u64 * BRANCH_BYTES as u64
    }

    const fn offset_of_leaf(&self, index: u32) -> u64 {
        self.header.segments.leaves.offset + index as u64 * LEAF_BYTES as u64
    }

    /// Where a cluster lies, and its length.
    const fn bytes_of_cluster(&self, place: &ClusterRef) -> (u64, usize) {
        let length = crate::cluster::cluster_bytes(place.vertices, place.triangles);
        (self.header.segments.clusters.offset.saturating_add(place.offset), length)
    }

    /// The same for a cluster of spheres.
    const fn bytes_of_spheres(&self, place: &SpheresRef) -> (u64, usize) {
        let length = crate::sphere::spheres_bytes(place.count);
        (self.header.segments.clusters.offset.saturating_add(place.offset), length)
    }
}

impl fmt::Display for Damaged {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Branch(index) => write!(f, "the scene image is damaged: branch {index} cannot be read"),
            Self::Leaf(index) => write!(f, "the scene image is damaged: leaf {index} cannot be read"),
            Self::Cluster { offset } => {
                write!(f, "the scene image is damaged: cluster at {offset} cannot be read")
            }
            Self::RangeBranch(index) => write!(f, "the scene image is damaged: range {index} cannot be read"),
            Self::Brick(index) => write!(f, "the scene image is damaged: brick {index} cannot be read"),
            Self::Table => write!(f, "the scene image is damaged: the volume's table cannot be read"),
            Self::Depth => write!(f, "the scene image is damaged: branches below the last level"),
            Self::Cycle => write!(f, "the scene image is damaged: a ray met more records than there are"),
        }
    }
}

impl core::error::Error for Damaged {}
