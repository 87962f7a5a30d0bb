//! The pixels of a tile, each looking for its nearest triangle.

use bytemuck::Zeroable;
use glam::Vec3;

use super::boxes::SeenBox;
use super::edges::Covered;
use super::far_triangles::FarSeen;
use super::pixel_tests::Lists;
use super::projection::Projection;
use super::spheres::{Mailbox, spheres_of};
use super::surface::directions;
use super::triangles::{Bounds, Corners, Triangles};
use super::walk::Targets;
use super::winners::Winners;
use crate::blocks::{BLOCKS, first_pixel};
use crate::camera::Camera;
use crate::cluster::{Cluster, Nearest};
use crate::grid::ClusterRef;
use crate::kinds::Kinds;
use crate::memory::SceneMemory;
use crate::ray::Primitive;
use crate::simd::{LANES, Mask, Simd, each};
use crate::sphere::{SphereCluster, SphereRay};
use crate::surface::Surface;
use crate::tile::{Tile, TileView};
use crate::triangle_woop::{Crossing, WoopRay};
use crate::view::{Damaged, SceneView};

/// The pixels of a tile.
pub(super) struct Pixels<'a, M, K> {
    scene: &'a SceneView<M>,
    pub(super) camera: &'a Camera,
    pub(super) eye: Vec3,
    pub(super) tile: Tile,
    pub(super) blocks: [Block; BLOCKS],
    /// Pixels that have hit something, pixels that there are.
    pub(super) hit: [Mask; BLOCKS],
    pub(super) present: [Mask; BLOCKS],
    pub(super) winners: Winners,
    /// For each block: what has a smaller inverse depth does not matter.
    pub(super) waiting: [f32; BLOCKS],
    /// The least of these.
    pub(super) least: f32,
    /// Full blocks of which `waiting` is out of date.
    stale: u64,
    /// Relative uncertainty of inverse depths.
    depth_epsilon: f32,
    pub(super) lists: Lists,
    /// What went wrong when a triangle was looked up again.
    damaged: Option<Damaged>,
    /// Spheres that every pixel was held against.
    pub(super) seen: Mailbox<K>,
    /// The same of triangles that reach far out.
    pub(super) far_seen: FarSeen,
}

/// What sixteen pixels have found; nothing yet when all is 0.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
pub(super) struct Block {
    /// Least and greatest inverse depth of the nearest hit so far; 0 where there is none.
    pub(super) low: [f32; LANES],
    pub(super) high: [f32; LANES],
    /// Places of the nearest triangles among the winners.
    pub(super) place: [u32; LANES],
}

impl<'a, M: SceneMemory, K: Kinds> Pixels<'a, M, K> {
    #[inline(always)]
    pub(super) fn new(view: &'a TileView<'_, M>, tile: Tile, depth_epsilon: f32) -> Self {
        let mut present = [Mask::MAX; BLOCKS];
        if tile.pixels() < BLOCKS * LANES {
            present.iter_mut().enumerate().for_each(|(block, present)| *present = present_in(tile, block));
        }
        let waiting = present.map(|present| if present == 0 { f32::INFINITY } else { 0.0 });
        Self {
            scene: view.scene,
            camera: &view.frame.camera,
            eye: view.eye,
            tile,
            blocks: [Block::zeroed(); BLOCKS],
            hit: [0; BLOCKS],
            present,
            winners: Winners::new(),
            waiting,
            least: 0.0,
            stale: 0,
            depth_epsilon,
            lists: Lists::new(),
            damaged: None,
            seen: Mailbox::new(),
            far_seen: FarSeen::new(),
        }
    }

    /// Whether any pixel hits anything.
    ///
    /// # Errors
    /// What went wrong on the way.
    pub(super) fn found_anything(&self) -> Result<bool, Damaged> {
        self.damaged.map_or_else(|| Ok(self.hit.iter().any(|&hit| hit != 0)), Err)
    }

    /// The pixels of a block that show a sphere.
    #[inline(always)]
    pub(super) fn showing_spheres(&self, block: usize) -> Mask {
        match (K::TRIANGLES, K::SPHERES) {
            (true, true) => {
                let lanes = self.blocks[block].place.iter().enumerate().fold(0, |lanes, (lane, &place)| {
                    lanes | Mask::from(spheres_of::<K>(self.winners.get(place).0).is_some()) << lane
                });
                lanes & self.hit[block]
            }
            (_, true) => self.hit[block],
            _ => 0,
        }
    }

    /// The spheres that pixels of a block show: centres by axis, and radii; zeros in other lanes.
    ///
    /// # Errors
    /// [`Damaged`], as [`corners`](Self::corners).
    #[inline(always)]
    pub(super) fn spheres<S: Simd>(&self, s: S, block: usize, lanes: Mask) -> Result<[S::F; 4], Damaged> {
        let places = &self.blocks[block].place;
        let names = s.to_int(s.load(&places.map(|place| Corners::of(place).name() as f32)));
        let mut spheres = [s.splat(0.0); 4];
        let mut left = lanes;
        while left != 0 {
            let place = places[left.trailing_zeros() as usize];
            let mut same = 0;
            for (lane, other) in places.iter().enumerate() {
                same |= Mask::from(other / Corners::COUNT == place / Corners::COUNT) << lane;
            }
            let (of, _) = self.winners.get(place);
            let of = spheres_of::<K>(of).ok_or(Damaged::Cluster { offset: of.offset })?;
            let record = self.scene.spheres(&of)?;
            let cluster = SphereCluster::new(&record, &of).ok_or(Damaged::Cluster { offset: of.offset })?;
            for (lane, from) in spheres.iter_mut().zip(cluster.lanes()) {
                let halves = each!(2: [0, LANES], half => s.load_le(&from[from.len().min(half)..from.len().min(half + LANES)]));
                *lane = s.select(same & left, s.pick_of_two(halves, names), *lane);
            }
            left &= !same;
        }
        Ok(spheres)
    }

    /// The corners of the triangles that these pixels of a block show, by corner and axis; zeros in other lanes.
    ///
    /// # Errors
    /// [`Damaged`], when a record read before can no longer be read.
    #[inline(always)]
    pub(super) fn corners<S: Simd>(
        &self,
        s: S,
        block: usize,
        lanes: Mask,
    ) -> Result<[[S::F; 3]; 3], Damaged> {
        let places = &self.blocks[block].place;
        let names = s.to_int(s.load(&places.map(|place| Corners::of(place).name() as f32)));
        let mut corners = [[s.splat(0.0); 3]; 3];
        let mut left = lanes;
        while left != 0 {
            // All pixels that show this cluster, while its record is at hand.
            let place = places[left.trailing_zeros() as usize];
            let mut lanes = 0;
            for (lane, other) in places.iter().enumerate() {
                lanes |= Mask::from(other / Corners::COUNT == place / Corners::COUNT) << lane;
            }
            let (of, _) = self.winners.get(place);
            let record = self.scene.cluster(of)?;
            let cluster = Cluster::new(&record, of).ok_or(Damaged::Cluster { offset: of.offset })?;
            let axes = each!(3: cluster.axes(), axis => [
                s.load_le(&axis[..axis.len().min(LANES)]),
                s.load_le(&axis[axis.len().min(LANES)..]),
            ]);
            let vertices = [names, s.shift_right::<5>(names), s.shift_right::<10>(names)];
            for (corner, vertex) in corners.iter_mut().zip(vertices) {
                for (lane, axis) in corner.iter_mut().zip(axes) {
                    *lane = s.select(lanes & left, s.pick_of_two(axis, vertex), *lane);
                }
            }
            left &= !lanes;
        }
        Ok(corners)
    }

    /// Takes up the next cluster.
    #[inline(always)]
    pub(super) fn begin(&mut self, cluster: &ClusterRef) {
        let (blocks, hit) = (&mut self.blocks, &self.hit);
        self.winners.begin(cluster, || {
            blocks.iter_mut().zip(hit).flat_map(|(block, hit)| {
                let places = block.place.iter_mut().enumerate();
                places.filter(move |(lane, _)| hit >> lane & 1 != 0).map(|(_, place)| place)
            })
        });
    }

    #[inline(always)]
    fn waiting_lanes<S: Simd>(&self, s: S) -> [S::F; 4] {
        let (quarters, _) = self.waiting.as_chunks::<LANES>();
        each!(4: [0, 1, 2, 3], quarter => s.load(&quarters[quarter]))
    }

    /// Whether nothing within these bounds can cover a pixel.
    #[inline(always)]
    pub(super) fn is_outside(&self, bounds: &Bounds) -> bool {
        let end = [self.tile.width, self.tile.height].map(|length| length as f32 - 1.0);
        bounds.right < 0.0 || bounds.bottom < 0.0 || bounds.left > end[0] || bounds.top > end[1]
    }

    /// The ray of a pixel.
    #[inline]
    fn ray(&self, block: usize, lane: usize) -> WoopRay {
        WoopRay::new(self.eye, self.direction(block, lane))
    }

    /// The direction of a pixel's ray.
    #[inline]
    fn direction(&self, block: usize, lane: usize) -> Vec3 {
        let (x, y) = first_pixel(block);
        let (x, y) = (self.tile.x + (x + lane % 4) as u32, self.tile.y + (y + lane / 4) as u32);
        self.camera.direction(self.camera.row(y), x)
    }

    /// Where a pixel's ray meets a surface.
    #[inline]
    fn crossing(&self, (block, lane): (usize, usize), surface: &Surface) -> Option<Crossing> {
        match surface {
            Surface::Triangle(corners) if K::TRIANGLES => {
                self.ray(block, lane).intersect(*corners, f32::INFINITY)
            }
            Surface::Sphere(sphere) if K::SPHERES => {
                SphereRay::new(self.eye, self.direction(block, lane)).intersect(sphere, f32::INFINITY)
            }
            _ => None,
        }
    }

    /// Lets the pixel's ray decide whether it hits a triangle of the cluster under test, and which of two is nearer.
    #[inline(never)]
    pub(super) fn decide(&mut self, (block, lane): (usize, usize), cluster: &Cluster<'_>, named: Corners) {
        self.decide_between((block, lane), Surface::Triangle(named.points(cluster)), named);
    }

    /// The same for a triangle or sphere.
    #[inline(never)]
    pub(super) fn decide_between(&mut self, (block, lane): (usize, usize), surface: Surface, named: Corners) {
        let shown = match self.shown(block, lane) {
            Ok(shown) => shown,
            Err(damaged) => return self.damaged = Some(damaged),
        };
        // Often it is another copy of what the pixel shows.
        if shown.is_some_and(|shown| shown == surface) {
            return;
        }
        let Some(crossing) = self.crossing((block, lane), &surface) else { return };
        if let Some(shown) = shown {
            let mut nearest = Nearest::none(f32::INFINITY);
            // What has the same shape is the same to a pixel, so numbers do not matter.
            if let Some(crossing) = self.crossing((block, lane), &shown) {
                nearest.offer(crossing, Primitive(0), shown);
            }
            if crossing.t > nearest.crossing.t {
                return;
            }
            nearest.offer(crossing, Primitive(0), surface);
            if nearest.surface.is_none_or(|(_, nearest)| nearest != surface) {
                return;
            }
        }
        let inverse_depth = 1.0 / crossing.t;
        let margin = inverse_depth * self.depth_epsilon;
        self.take((block, lane), named, inverse_depth - margin, inverse_depth + margin);
    }

    /// What a pixel shows.
    fn shown(&self, block: usize, lane: usize) -> Result<Option<Surface>, Damaged> {
        if self.hit[block] >> lane & 1 == 0 {
            return Ok(None);
        }
        let (place, corners) = self.winners.get(self.blocks[block].place[lane]);
        let damaged = Damaged::Cluster { offset: place.offset };
        if let Some(place) = spheres_of::<K>(place) {
            let record = self.scene.spheres(&place)?;
            let cluster = SphereCluster::new(&record, &place).ok_or(damaged)?;
            return Ok(Some(Surface::Sphere(cluster.sphere(corners.name() as usize))));
        }
        let record = self.scene.cluster(place)?;
        let cluster = Cluster::new(&record, place).ok_or(damaged)?;
        Ok(Some(Surface::Triangle(corners.points(&cluster))))
    }

    /// Has a pixel show a triangle of the cluster under test.
    #[inline(always)]
    pub(super) fn take(&mut self, (block, lane): (usize, usize), named: Corners, low: f32, high: f32) {
        let place = self.winners.place(named);
        let found = &mut self.blocks[block];
        found.low[lane] = low;
        found.high[lane] = high;
        found.place[lane] = place;
        self.mark(block, 1 << lane);
    }

    /// Has the pixels of a block show what certainly covers them nearest. Gives those in doubt.
    #[inline(always)]
    pub(super) fn settle<S: Simd>(
        &mut self,
        s: S,
        covered: &Covered<S::F>,
        named: Corners,
        (block, within): (usize, Mask),
    ) -> Mask {
        let place = self.winners.place(named);
        let found = &mut self.blocks[block];
        let (low, high) = (s.load(&found.low), s.load(&found.high));
        let candidates = covered.candidates & s.le(low, covered.high) & within;
        let wins = candidates & covered.sure & s.lt(high, covered.low);
        s.store(s.select(wins, covered.low, low), &mut found.low);
        s.store(s.select(wins, covered.high, high), &mut found.high);
        let places = bytemuck::cast_mut::<_, [f32; LANES]>(&mut found.place);
        s.store(s.select(wins, s.splat(f32::from_bits(place)), s.load(places)), places);
        self.mark(block, wins);
        candidates & !wins
    }

    /// Notes that pixels of a block, if any, show a triangle of the cluster under test.
    #[inline(always)]
    pub(super) fn mark(&mut self, block: usize, lanes: Mask) {
        let has_won = lanes != 0;
        self.winners.has_won |= has_won;
        self.hit[block] |= lanes;
        let is_full = self.hit[block] == self.present[block];
        self.stale |= u64::from(has_won & is_full) << block;
    }
}

impl<S: Simd, M: SceneMemory, K: Kinds> Targets<S> for Pixels<'_, M, K> {
    #[inline(always)]
    fn least(&mut self, s: S) -> f32 {
        if self.stale != 0 {
            while self.stale != 0 {
                let block = self.stale.trailing_zeros() as usize;
                self.stale &= self.stale - 1;
                let lanes = self.present[block];
                let low = s.select(lanes, s.load(&self.blocks[block].low), s.splat(f32::INFINITY));
                self.waiting[block] = s.least(low);
            }
            let [a, b, c, d] = self.waiting_lanes(s);
            self.least = s.least(s.min(s.min(a, b), s.min(c, d)));
        }
        self.least
    }

    /// Whether there is a pixel within the bounds that shows nothing nearer, and whose ray meets the box.
    #[inline(always)]
    fn wants(&mut self, s: S, bounds: &Bounds, seen: Option<&SeenBox>) -> bool {
        let near = s.splat(bounds.near);
        let mut waiting = 0;
        for (quarter, blocks) in self.waiting_lanes(s).into_iter().enumerate() {
            waiting |= u64::from(s.le(blocks, near)) << (quarter * LANES);
        }
        let [left, right] = each!(2: [bounds.left, bounds.right], end => s.splat(end));
        let [top, bottom] = each!(2: [bounds.top, bounds.bottom], end => s.splat(end));
        waiting &= blocks_within(s, [left, right], [top, bottom]);
        while waiting != 0 {
            let block = waiting.trailing_zeros() as usize;
            waiting &= waiting - 1;
            let (x, y) = first_pixel(block);
            let (x, y) =
                (s.add(s.load(&COLUMNS), s.splat(x as f32)), s.add(s.load(&ROWS), s.splat(y as f32)));
            let within = s.le(left, x) & s.le(x, right) & s.le(top, y) & s.le(y, bottom);
            let low = s.load(&self.blocks[block].low);
            let mut open = within & self.present[block] & s.le(low, near);
            if let Some(seen) = seen {
                open &= seen.met_by(s, directions(s, self.camera, self.tile, block), low);
            }
            if open != 0 {
                return true;
            }
        }
        false
    }

    #[inline(always)]
    fn test(&mut self, s: S, triangles: &Triangles<'_, S>) {
        self.test_triangles(s, triangles);
    }

    #[inline(always)]
    fn test_spheres(&mut self, s: S, projection: &Projection, cluster: &SphereCluster<'_>) {
        self.test_cluster_of_spheres(s, projection, cluster);
    }

    fn test_far(&mut self, s: S, cluster: &Cluster<'_>) {
        self.test_far_triangles(s, cluster);
    }
}

/// The blocks that reach into a range of columns and a range of rows.
#[inline(always)]
pub(super) fn blocks_within<S: Simd>(s: S, [left, right]: [S::F; 2], [top, bottom]: [S::F; 2]) -> u64 {
    // Eight columns, then eight rows.
    let (low, high) = (s.select(0xff, left, top), s.select(0xff, right, bottom));
    let first = s.load(&FIRST_OF_BLOCKS);
    let lines = s.le(low, s.add(first, s.splat(3.0))) & s.le(first, high);
    // A row of blocks is a byte: bit `n` of the rows to byte `n`, and that filled if it is not 0.
    let rows = (u64::from(lines >> 8) * 0x0101_0101_0101_0101) & 0x8040_2010_0804_0201;
    let rows = ((rows + 0x7f7f_7f7f_7f7f_7f7f) >> 7 & 0x0101_0101_0101_0101) * 0xff;
    (u64::from(lines & 0xff) * 0x0101_0101_0101_0101) & rows
}

const FIRST_OF_BLOCKS: [f32; LANES] =
    [0.0, 4.0, 8.0, 12.0, 16.0, 20.0, 24.0, 28.0, 0.0, 4.0, 8.0, 12.0, 16.0, 20.0, 24.0, 28.0];

/// Columns and rows of the pixels of a block.
pub(super) const COLUMNS: [f32; LANES] =
    [0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0];
pub(super) const ROWS: [f32; LANES] =
    [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 3.0, 3.0, 3.0, 3.0];

/// The pixels of a block that a tile has.
#[inline(always)]
pub(super) const fn present_in(tile: Tile, block: usize) -> Mask {
    let (x, y) = first_pixel(block);
    lanes_in((0, tile.width as i32 - 1), (0, tile.height as i32 - 1), (x as i32, y as i32))
}

/// The pixels of a block that lie in a range of columns and a range of rows.
#[inline(always)]
pub(super) const fn lanes_in(columns: (i32, i32), rows: (i32, i32), (x, y): (i32, i32)) -> Mask {
    let (columns, rows) = (in_range(columns, x), in_range(rows, y));
    // Each bit of the rows four times, and the columns four times over.
    let rows = ((rows & 1) | (rows & 2) << 3 | (rows & 4) << 6 | (rows & 8) << 9) * 0xf;
    rows & (columns * 0x1111)
}

/// Four bits: which of `at..at + 4` lie in a range.
#[inline(always)]
const fn in_range((first, last): (i32, i32), at: i32) -> Mask {
    let from = if first > at { first - at } else { 0 };
    let until = if last < at + 3 { last - at } else { 3 };
    if from > 3 || until < 0 { 0 } else { (0xf << from & 0xf >> (3 - until)) as Mask }
}
