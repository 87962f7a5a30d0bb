//! Counters: what a tile brought about, and the work of the kernels behind a type that compiles away.

/// Counts the steps of a kernel, to tell *why* a ray is slow.
///
/// The methods of `()` do nothing, so a kernel called with `&mut ()` is compiled without any counting.
pub trait Count {
    /// A branch was read, of the grid or of a volume's ranges, and its 64 children were culled.
    fn branch(&mut self) {}
    /// A leaf record was read and its box tested.
    fn leaf(&mut self) {}
    /// A cluster was read, and its triangles or spheres are tested.
    fn cluster(&mut self) {}
    /// That many triangles of a cluster were tested.
    fn triangles(&mut self, _count: u32) {}
    /// That many spheres of a cluster were tested.
    fn spheres(&mut self, _count: u32) {}
    /// A brick of a volume was read.
    fn brick(&mut self) {}
    /// That many voxel cells were looked at.
    fn voxel_cells(&mut self, _count: u32) {}
    /// That many cubics were made, and their roots looked for.
    fn cubics(&mut self, _count: u32) {}
}

impl Count for () {}

/// Work of a kernel, summed over rays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorkCounts {
    /// Branches read.
    pub branches: u64,
    /// Leaf records read.
    pub leaves: u64,
    /// Clusters read.
    pub clusters: u64,
    /// Triangles tested.
    pub triangles: u64,
    /// Spheres tested.
    pub spheres: u64,
    /// Bricks read.
    pub bricks: u64,
    /// Voxel cells looked at.
    pub voxel_cells: u64,
    /// Cubics made.
    pub cubics: u64,
}

impl Count for WorkCounts {
    fn branch(&mut self) {
        self.branches += 1;
    }

    fn leaf(&mut self) {
        self.leaves += 1;
    }

    fn cluster(&mut self) {
        self.clusters += 1;
    }

    fn triangles(&mut self, count: u32) {
        self.triangles += u64::from(count);
    }

    fn spheres(&mut self, count: u32) {
        self.spheres += u64::from(count);
    }

    fn brick(&mut self) {
        self.bricks += 1;
    }

    fn voxel_cells(&mut self, count: u32) {
        self.voxel_cells += u64::from(count);
    }

    fn cubics(&mut self, count: u32) {
        self.cubics += u64::from(count);
    }
}

/// What the rays of some tiles met. Sums of tiles are sums of these.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TileCounts {
    /// Rays from the eye, one per pixel.
    pub primary: u64,
    /// Primary rays that met the scene.
    pub hits: u64,
    /// Rays towards the light; none from a point that faces away from it.
    pub shadow: u64,
    /// Shadow rays that reached the light.
    pub lit: u64,
    /// Rays that ended in a lie of the image; their pixels show the background.
    pub damaged: u64,
    /// Sum over the hits of `t`, which is the depth along the camera's forward axis.
    pub t_sum: f64,
}

impl core::ops::Add for TileCounts {
    type Output = Self;

    fn add(mut self, other: Self) -> Self {
        self += other;
        self
    }
}

impl core::ops::AddAssign for TileCounts {
    fn add_assign(&mut self, other: Self) {
        self.primary += other.primary;
        self.hits += other.hits;
        self.shadow += other.shadow;
        self.lit += other.lit;
        self.damaged += other.damaged;
        self.t_sum += other.t_sum;
    }
}
