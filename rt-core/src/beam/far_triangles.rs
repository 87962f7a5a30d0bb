//! Triangles that reach behind the eye or far out, such as a ground: they cannot be projected, or not well.
//!
//! Their edges and the eye span planes; which side of these a ray runs on tells whether it meets the triangle. In single
//! precision, sixteen rays at a time; where there is doubt, the ray decides.
//!
//! # How large the doubt is
//! Let `e = 2^-24`, `l` the distance of the farthest corner from the eye, `d` the length of the direction. A plane's
//! normal is the product of two corners; rounded it is off by `e l^2`, its product with the direction by `4 e l^2 d`. A
//! ray that decides moves corners by `6 e` of their distance from its origin: `12 e l^2 d`. Together 16, taken are `64
//! e l^2 d`; and for the product of all three corners, whose heights are off by `3 e` more, `64 e l^3`. Where rays
//! start elsewhere, at samples `d` away from the light, their corners are up to `l + d` away.
//!
//! Samples that lie on the light's side of the triangle's plane are not shadowed. Their distances from the plane are off by
//! `4 e (l + d)`, corners are moved by `9 e (l + d)`; taken are `32 e (l + d)`.

use glam::{DVec3, Vec3};

use super::pixels::{COLUMNS, Pixels, ROWS};
use super::samples::{GROUPS, Samples};
use super::triangles::Corners;
use crate::blocks::{BLOCKS, first_pixel};
use crate::cluster::Cluster;
use crate::kinds::Kinds;
use crate::memory::SceneMemory;
use crate::simd::{LANES, Mask, Simd, each};

/// A triangle as seen from a point.
struct FarTriangle {
    /// Normals of the planes that the edges span with the point, inwards.
    sides: [Vec3; 3],
    /// Normal of the triangle, away from the point, and the distance of its plane.
    normal: Vec3,
    distance: f32,
    /// Distance of the farthest corner.
    size: f32,
    /// Least and greatest inverse of the product of all three corners; `None` when the plane may contain the point.
    per_volume: Option<[f32; 2]>,
}

/// Some triangles that a tile has been through with: large ones are stored in many clusters, and once is enough.
pub(super) struct FarSeen {
    triangles: [[Vec3; 3]; SEEN],
    next: usize,
}

/// How many are kept.
const SEEN: usize = 8;

impl FarSeen {
    pub(super) const fn new() -> Self {
        Self { triangles: [[Vec3::NAN; 3]; SEEN], next: 0 }
    }

    /// Notes a triangle, and tells whether it is new.
    fn is_new(&mut self, corners: [Vec3; 3]) -> bool {
        let is_new = !self.triangles.contains(&corners);
        if is_new {
            self.triangles[self.next % SEEN] = corners;
            self.next += 1;
        }
        is_new
    }
}

impl FarTriangle {
    fn new(point: Vec3, corners: [Vec3; 3]) -> Self {
        let [a, b, c] = corners.map(|corner| corner.as_dvec3() - point.as_dvec3());
        let sides = [b.cross(c), c.cross(a), a.cross(b)];
        let volume = a.dot(sides[0]);
        let sign = if volume < 0.0 { -1.0 } else { 1.0 };
        let across = (b - a).cross(c - a) * sign;
        let length = libm::sqrt(across.length_squared());
        let normal = if length > 0.0 { across / length } else { DVec3::ZERO };
        let size = libm::sqrt(a.length_squared().max(b.length_squared()).max(c.length_squared()));
        let doubt = f64::from(DOUBT) * size * size * size;
        let volume = volume.abs();
        let is_certain = volume > doubt * 2.0 && length > 0.0;
        Self {
            sides: sides.map(|side| (side * sign).as_vec3()),
            normal: normal.as_vec3(),
            distance: normal.dot(a) as f32,
            size: size as f32,
            per_volume: is_certain
                .then(|| [1.0 / (volume + doubt), 1.0 / (volume - doubt)].map(|inverse| inverse as f32)),
        }
    }

    /// The least of the products of a direction and the three sides, and the sum of all.
    #[inline(always)]
    fn products<S: Simd>(&self, s: S, direction: [S::F; 3]) -> (S::F, S::F) {
        let [a, b, c] = each!(3: self.sides, side => s.dot(direction, s.splat3(side)));
        (s.min3([a, b, c]), s.add(s.add(a, b), c))
    }
}

impl<M: SceneMemory, K: Kinds> Pixels<'_, M, K> {
    /// Tests the triangles of a cluster that reach far out.
    pub(super) fn test_far_triangles<S: Simd>(&mut self, s: S, cluster: &Cluster<'_>) {
        self.begin(cluster.place());
        for index in 0..usize::from(cluster.place().triangles) {
            let corners = cluster.triangle(index);
            if self.far_seen.is_new(corners) {
                let far = FarTriangle::new(self.eye, corners);
                if self.is_beside(s, &far) {
                    continue;
                }
                for block in 0..BLOCKS {
                    if self.present[block] != 0 {
                        self.test_far_block(s, &far, (cluster, Corners::of_triangle(cluster, index)), block);
                    }
                }
            }
        }
    }

    /// Whether all pixels lie on the wrong side of an edge, as the outermost ones tell.
    #[inline(always)]
    fn is_beside<S: Simd>(&self, s: S, far: &FarTriangle) -> bool {
        let end = [self.tile.width, self.tile.height].map(|length| length as f32 - 1.0);
        let direction = self
            .directions(s, (s.mul(s.load(&RIGHT), s.splat(end[0])), s.mul(s.load(&LOWER), s.splat(end[1]))));
        let doubt = s.mul(length(s, direction), s.splat(DOUBT * far.size * far.size));
        let below = s.sub(s.splat(0.0), doubt);
        let [a, b, c] =
            each!(3: far.sides, side => s.lt(s.dot(direction, s.splat3(side)), below) == Mask::MAX);
        far.per_volume.is_some() && (a || b || c)
    }

    /// Tests one such triangle against the pixels of a block.
    #[inline(always)]
    fn test_far_block<S: Simd>(
        &mut self,
        s: S,
        far: &FarTriangle,
        (cluster, name): (&Cluster<'_>, Corners),
        block: usize,
    ) {
        let (x, y) = first_pixel(block);
        let (x, y) = (s.add(s.load(&COLUMNS), s.splat(x as f32)), s.add(s.load(&ROWS), s.splat(y as f32)));
        let direction = self.directions(s, (x, y));
        let (least, sum) = far.products(s, direction);
        let doubt = s.mul(length(s, direction), s.splat(DOUBT * far.size * far.size));
        // Comparisons are written so that a NaN anywhere is a doubt.
        let missed = s.lt(least, s.sub(s.splat(0.0), doubt));
        let certain = if far.per_volume.is_some() { Mask::MAX } else { 0 };
        let [per_more, per_less] = far.per_volume.unwrap_or([0.0, f32::INFINITY]);
        let doubts = s.mul(doubt, s.splat(3.0));
        let low = s.mul(s.sub(sum, doubts), s.splat(per_more * (1.0 - SHARE)));
        let high = s.mul(s.add(sum, doubts), s.splat(per_less * (1.0 + SHARE)));
        let found = &mut self.blocks[block];
        let (found_low, found_high) = (s.load(&found.low), s.load(&found.high));
        let hidden = s.lt(high, found_low) & certain;
        let candidates = !(missed & certain) & !hidden & self.present[block];
        let wins = candidates & certain & s.lt(doubt, least) & s.lt(found_high, low);
        let place = s.splat(f32::from_bits(self.winners.place(name)));
        s.store(s.select(wins, low, found_low), &mut found.low);
        s.store(s.select(wins, high, found_high), &mut found.high);
        let places = bytemuck::cast_mut::<_, [f32; LANES]>(&mut found.place);
        s.store(s.select(wins, place, s.load(places)), places);
        self.mark(block, wins);
        let mut open = candidates & !wins;
        while open != 0 {
            self.decide((block, open.trailing_zeros() as usize), cluster, name);
            open &= open - 1;
        }
    }
}

impl Samples<'_> {
    /// Tests the triangles of a cluster that reach far out.
    pub(super) fn test_far_triangles<S: Simd>(&mut self, s: S, cluster: &Cluster<'_>) {
        for index in 0..usize::from(cluster.place().triangles) {
            let corners = cluster.triangle(index);
            if self.far_seen.is_new(corners) {
                let far = FarTriangle::new(self.light, corners);
                for group in 0..GROUPS {
                    if self.open[group] != 0 {
                        self.test_far_group(s, &far, corners, group);
                    }
                }
            }
        }
    }

    /// Tests one such triangle against the samples of a group.
    #[inline(always)]
    fn test_far_group<S: Simd>(&mut self, s: S, far: &FarTriangle, corners: [Vec3; 3], group: usize) {
        let point = self.points_of_group(s, group);
        let light = s.splat3(self.light);
        let from_light = each!(3: [0, 1, 2], axis => s.sub(point[axis], light[axis]));
        let (least, _) = far.products(s, from_light);
        let away = length(s, from_light);
        let reach = s.add(away, s.splat(far.size));
        let doubt = s.mul(s.mul(reach, reach), s.mul(away, s.splat(DOUBT)));
        let margin = s.mul(reach, s.splat(DOUBT * 0.5));
        let deep = s.sub(s.dot(from_light, s.splat3(far.normal)), s.splat(far.distance));
        let zero = s.splat(0.0);
        let certain = if far.per_volume.is_some() { Mask::MAX } else { 0 };
        let missed = (s.lt(least, s.sub(zero, doubt)) | s.lt(deep, s.sub(zero, margin))) & certain;
        let hit = certain & s.lt(doubt, least) & s.lt(margin, deep);
        let mut left = self.open[group] & !missed;
        while left != 0 {
            let lane = left.trailing_zeros() as usize;
            left &= left - 1;
            if hit >> lane & 1 != 0 || self.is_shadowed((group, lane), corners) {
                self.close(s, (group, lane));
            }
        }
    }
}

/// No less than the lengths of vectors.
#[inline(always)]
fn length<S: Simd>(s: S, vector: [S::F; 3]) -> S::F {
    let [x, y, z] = each!(3: vector, value => s.abs(value));
    s.add(s.add(x, y), z)
}

/// The four corners of a tile, four times.
const RIGHT: [f32; LANES] = [0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0];
const LOWER: [f32; LANES] = [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0];

/// `64 * 2^-24`.
const DOUBT: f32 = 1.0 / 262_144.0;

/// `2^-20`.
const SHARE: f32 = 1.0 / 1_048_576.0;
