//! Sixteen rays at a time, in the shape that embedders with vector code hold them.
//!
//! Rays that go the same way are traced [together](crate::packet_walk); how many times faster that is
//! than one by one, `examples/packets.rs` prints.

use core::marker::PhantomData;

use glam::Vec3;

use crate::count::Count;
use crate::grid_ray::GridRay;
use crate::kinds::{ForKinds, Kinds, dispatch};
use crate::memory::SceneMemory;
use crate::packet_walk::{Packet, TOGETHER_MIN, lanes, walk_packet};
use crate::ray::{Hit, Primitive, Ray};
use crate::simd::{LANES, Simd, Task};
use crate::triangle_woop::WoopRay;
use crate::view::{Damaged, SceneView};

/// Sixteen rays, each number an array over the rays; units and edge cases as of [`Ray`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct Packet16 {
    /// Where the rays start: x, y and z of each.
    pub origin: [[f32; 16]; 3],
    /// Where they go; need not have length 1.
    pub direction: [[f32; 16]; 3],
    /// Largest `t` that counts, inclusive.
    pub t_max: [f32; 16],
}

/// The hits of a packet, each number an array over the rays; see [`Hit`].
///
/// A lane without a hit holds an infinite `t`, the primitive [`u32::MAX`], and 0 otherwise.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct Hits16 {
    /// Distances, in lengths of the rays' directions.
    pub t: [f32; 16],
    /// Weights of the triangles' second corners; 0 on spheres.
    pub u: [f32; 16],
    /// Weights of the third corners; 0 on spheres.
    pub v: [f32; 16],
    /// Unit normals: x, y and z of each.
    pub normal: [[f32; 16]; 3],
    /// Places in the image of what was hit.
    pub primitive: [u32; 16],
    /// The rays that hit something, one bit each, ray 0 the lowest.
    pub mask: u16,
}

impl Packet16 {
    /// Packs up to 16 rays, and tells which lanes they fill; the other lanes miss everything.
    pub fn pack(rays: &[Ray]) -> (Self, u16) {
        let mut packet = Self { origin: [[0.0; 16]; 3], direction: [[0.0; 16]; 3], t_max: [0.0; 16] };
        let mut active = 0;
        for (lane, ray) in rays.iter().take(16).enumerate() {
            for axis in 0..3 {
                packet.origin[axis][lane] = ray.origin[axis];
                packet.direction[axis][lane] = ray.direction[axis];
            }
            packet.t_max[lane] = ray.t_max;
            active |= 1 << lane;
        }
        (packet, active)
    }

    /// The ray of a lane; lanes count modulo 16.
    pub fn ray(&self, lane: usize) -> Ray {
        let lane = lane % 16;
        let vector = |axes: &[[f32; 16]; 3]| Vec3::new(axes[0][lane], axes[1][lane], axes[2][lane]);
        Ray { origin: vector(&self.origin), direction: vector(&self.direction), t_max: self.t_max[lane] }
    }
}

impl Packet16 {
    /// Whether the rays are worth to be taken together: there are several, and all run mainly along the same axis, the same
    /// way.
    fn goes_together(&self, active: u16) -> bool {
        let mut axes = lanes(active).map(|lane| {
            let [x, y, z] = self.direction.each_ref().map(|axis| axis[lane]);
            WoopRay::main_axis(Vec3::new(x, y, z))
        });
        active.count_ones() >= TOGETHER_MIN && axes.next().is_some_and(|first| axes.all(|axis| axis == first))
    }
}

impl Hits16 {
    /// No hit at all.
    pub const NONE: Self = Self {
        t: [f32::INFINITY; 16],
        u: [0.0; 16],
        v: [0.0; 16],
        normal: [[0.0; 16]; 3],
        primitive: [u32::MAX; 16],
        mask: 0,
    };

    /// The hit of a lane; lanes count modulo 16.
    pub fn hit(&self, lane: usize) -> Option<Hit> {
        let lane = lane % 16;
        let normal = Vec3::from(self.normal.map(|axis| axis[lane]));
        let (t, u, v, primitive) =
            (self.t[lane], self.u[lane], self.v[lane], Primitive(self.primitive[lane]));
        (self.mask >> lane & 1 == 1).then_some(Hit { t, u, v, primitive, normal })
    }

    fn set(&mut self, lane: usize, hit: &Hit) {
        let Hit { t, u, v, primitive: Primitive(primitive), normal } = *hit;
        (self.t[lane], self.u[lane], self.v[lane], self.primitive[lane]) = (t, u, v, primitive);
        for (axis, normal) in self.normal.iter_mut().zip(normal.to_array()) {
            axis[lane] = normal;
        }
        self.mask |= 1 << lane;
    }
}

impl<M: SceneMemory> SceneView<M> {
    /// The nearest hits of the rays whose bits are set in `active`; each the same, to the bit, as
    /// [`nearest`](Self::nearest) finds, but that of a triangle or sphere which is stored in several cells another place may be
    /// named. The numbers of other lanes are not looked at. What several rays read together is counted once.
    ///
    /// ```
    /// # use rt_core::{Flat, Packet16, Ray, SceneView};
    /// # let mesh = scene::builtin::knot(1000);
    /// # let bytes = scene::build(mesh, &Default::default(), &|_| {}).unwrap().to_bytes(4096).unwrap();
    /// # let scene = SceneView::new(Flat::new(&bytes))?;
    /// let origin = [3.0, 0.1, 9.0].into();
    /// let ray = |z| Ray { origin, direction: [0.0, 0.0, z].into(), t_max: f32::INFINITY };
    /// let (packet, active) = Packet16::pack(&[ray(-1.0), ray(1.0), ray(-0.5)]);
    /// assert_eq!(active, 0b111);
    /// let hits = scene.nearest16(&packet, active, &mut ())?;
    /// assert_eq!(hits.mask, 0b101);
    /// assert_eq!(hits.t[2], hits.t[0] * 2.0);
    /// assert_eq!(hits.hit(0), scene.nearest(&ray(-1.0), &mut ())?);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`Damaged`] when the image lies or a page cannot be had for one of the rays; the packet is given up.
    pub fn nearest16<C: Count>(
        &self,
        packet: &Packet16,
        active: u16,
        count: &mut C,
    ) -> Result<Hits16, Damaged> {
        if !packet.goes_together(active) {
            let mut hits = Hits16::NONE;
            for lane in lanes(active) {
                if let Some(hit) = self.nearest(&packet.ray(lane), count)? {
                    hits.set(lane, &hit);
                }
            }
            return Ok(hits);
        }
        let Some((rays, active)) = self.grid_rays(packet, active) else { return Ok(Hits16::NONE) };
        let packet = Packet::new(&rays, active);
        dispatch(self.header().needs, Trace16::<_, _, false> { scene: self, packet, count })
    }

    /// Which of the rays whose bits are set in `active` hit anything.
    ///
    /// ```
    /// # use rt_core::{Flat, Packet16, Ray, SceneView};
    /// # let mesh = scene::builtin::knot(1000);
    /// # let bytes = scene::build(mesh, &Default::default(), &|_| {}).unwrap().to_bytes(4096).unwrap();
    /// # let scene = SceneView::new(Flat::new(&bytes))?;
    /// let ray = Ray { origin: [3.0, 0.1, 9.0].into(), direction: [0.0, 0.0, -1.0].into(), t_max: 100.0 };
    /// let (packet, _) = Packet16::pack(&[ray; 16]);
    /// assert_eq!(scene.any16(&packet, 0b1000_0000_0000_0001, &mut ())?, 0b1000_0000_0000_0001);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// As [`nearest16`](Self::nearest16).
    pub fn any16<C: Count>(&self, packet: &Packet16, active: u16, count: &mut C) -> Result<u16, Damaged> {
        if !packet.goes_together(active) {
            let mut mask = 0;
            for lane in lanes(active) {
                mask |= u16::from(self.any(&packet.ray(lane), count)?) << lane;
            }
            return Ok(mask);
        }
        let Some((rays, active)) = self.grid_rays(packet, active) else { return Ok(0) };
        let packet = Packet::new(&rays, active);
        let hits = dispatch(self.header().needs, Trace16::<_, _, true> { scene: self, packet, count })?;
        Ok(hits.mask)
    }

    /// The active rays that can hit anything, in the units of the grid, and which they are; the other lanes are filled up
    /// with one of them. `None` when there is none.
    fn grid_rays(&self, packet: &Packet16, active: u16) -> Option<([GridRay; LANES], u16)> {
        let grid_ray = |lane| GridRay::from_world(&packet.ray(lane), self.header());
        let mut usable = lanes(active).filter_map(|lane| Some((lane, grid_ray(lane)?)));
        let (lane, ray) = usable.next()?;
        let (mut rays, mut found) = ([ray; LANES], 1 << lane);
        for (lane, ray) in usable {
            rays[lane] = ray;
            found |= 1 << lane;
        }
        Some((rays, found))
    }
}

/// A packet to be traced: for the nearest hits, or with `ANY` for which rays hit anything.
struct Trace16<'a, M, C, const ANY: bool> {
    scene: &'a SceneView<M>,
    packet: Packet<'a>,
    count: &'a mut C,
}

impl<M: SceneMemory, C: Count, const ANY: bool> ForKinds for Trace16<'_, M, C, ANY> {
    type Output = Result<Hits16, Damaged>;

    fn run<K: Kinds>(self) -> Self::Output {
        let Self { scene, mut packet, count } = self;
        scene.lanes().run(Walk16::<_, _, K, ANY> {
            scene,
            packet: &mut packet,
            count,
            kinds: PhantomData,
        })?;
        Ok(packet.hits::<K, ANY>())
    }
}

/// A [`Trace16`] of primitives of the kinds `K`.
struct Walk16<'a, 'b, M, C, K, const ANY: bool> {
    scene: &'a SceneView<M>,
    packet: &'a mut Packet<'b>,
    count: &'a mut C,
    kinds: PhantomData<K>,
}

impl<M: SceneMemory, C: Count, K: Kinds, const ANY: bool> Task for Walk16<'_, '_, M, C, K, ANY> {
    type Output = Result<(), Damaged>;

    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> Self::Output {
        let Self { scene, packet, count, .. } = self;
        walk_packet::<S, M, C, K, ANY>(s, scene, packet, count)
    }
}

impl Packet<'_> {
    /// What was hit, in the caller's units; with `ANY`, only by which rays.
    fn hits<K: Kinds, const ANY: bool>(&self) -> Hits16 {
        let mut hits = Hits16::NONE;
        for lane in lanes(self.active) {
            if ANY {
                hits.mask |= u16::from(self.nearest[lane].surface.is_some()) << lane;
            } else if let Some(hit) = self.rays[lane].hit::<K>(&self.nearest[lane]) {
                hits.set(lane, &hit);
            }
        }
        hits
    }
}
