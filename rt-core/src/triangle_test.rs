//! The ray-triangle test as a choice: one trait, three variants.
//!
//! | variant | in | shared edges | what it is for |
//! |---|---|---|---|
//! | [`WoopRay`] | `f32`, decided in `f64` | watertight | the default |
//! | [`MollerRay`] | `f32` | leak | comparison with renderers that use it |
//! | [`F64Ray`](crate::triangle_f64::F64Ray) | `f64` | watertight | the reference of tests |
//!
//! The kernel is compiled once for each variant in use; the default pays nothing for the others.

use core::fmt;
use core::str::FromStr;

use glam::Vec3;

use crate::cluster::{Cluster, Nearest};
use crate::count::Count;
use crate::filter::Filter;
use crate::grid_ray::GridRay;
use crate::memory::SceneMemory;
use crate::ray::{Hit, Ray};
use crate::triangle_moller::MollerRay;
use crate::triangle_woop::{Crossing, WoopRay};
use crate::view::{Damaged, SceneView};

/// The tests that a [`Frame`](crate::Frame) can be drawn with.
///
/// The pictures differ in a few pixels. Those drawn with one test are the same bytes with any kernel and any lanes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum TriangleTestKind {
    /// [`WoopRay`]: watertight.
    #[default]
    Woop,
    /// [`MollerRay`], for comparison. Beams judge by the default test, so with this one tiles are drawn ray by ray, whatever
    /// the [`Kernel`](crate::Kernel) says.
    Moller,
}

/// A name that is none of a triangle test.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownTriangleTest;

/// A ray prepared for one way of testing triangles.
pub trait TriangleTest: Copy + fmt::Debug {
    /// Prepares a ray. Origin and direction are finite and the direction is not zero.
    fn new(origin: Vec3, direction: Vec3) -> Self;

    /// Where the ray crosses a triangle with `0 < t <= t_max`; for both sides of it.
    fn intersect(&self, corners: [Vec3; 3], t_max: f32) -> Option<Crossing>;

    /// Which of the kernels' own ways of testing sixteen triangles at once does the same as
    /// [`intersect`](Self::intersect).
    #[inline]
    fn in_lanes(&self) -> InLanes<'_> {
        InLanes::OneByOne
    }

    /// Offers every triangle of a cluster that the ray hits and `filter` accepts to `nearest`; with `ANY`,
    /// stops at the first.
    ///
    /// The default tests one triangle after the other.
    fn intersect_cluster<const ANY: bool>(
        &self,
        cluster: &Cluster<'_>,
        nearest: &mut Nearest,
        filter: &mut impl Filter,
    ) {
        for index in 0..usize::from(cluster.place().triangles) {
            let (primitive, corners) = (cluster.primitive(index), cluster.triangle(index));
            if let Some(crossing) = self.intersect(corners, nearest.crossing.t)
                && filter.accepts(&crossing, primitive, &corners.into())
            {
                nearest.offer(crossing, primitive, corners);
                if ANY {
                    return;
                }
            }
        }
    }
}

impl TriangleTestKind {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Woop, Self::Moller];

    /// The name that [`FromStr`] takes.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Woop => "woop",
            Self::Moller => "moller",
        }
    }
}

impl FromStr for TriangleTestKind {
    type Err = UnknownTriangleTest;

    fn from_str(name: &str) -> Result<Self, UnknownTriangleTest> {
        Self::ALL.into_iter().find(|test| test.name() == name).ok_or(UnknownTriangleTest)
    }
}

impl fmt::Display for TriangleTestKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl fmt::Display for UnknownTriangleTest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("triangle tests are woop and moller")
    }
}

impl core::error::Error for UnknownTriangleTest {}

impl TriangleTest for WoopRay {
    #[inline]
    fn new(origin: Vec3, direction: Vec3) -> Self {
        Self::new(origin, direction)
    }

    fn intersect(&self, corners: [Vec3; 3], t_max: f32) -> Option<Crossing> {
        self.intersect(corners, t_max)
    }

    #[inline(always)]
    fn in_lanes(&self) -> InLanes<'_> {
        InLanes::Woop(self)
    }
}

/// Ways of testing sixteen triangles at once.
#[derive(Clone, Copy, Debug)]
pub enum InLanes<'a> {
    /// Sixteen at a time by the default test.
    Woop(&'a WoopRay),
    /// Sixteen at a time by the test of Möller and Trumbore.
    Moller(&'a MollerRay),
    /// One triangle after the other.
    OneByOne,
}

/// Hits nothing: for kernels that trace no triangles.
impl TriangleTest for () {
    #[inline]
    fn new(_: Vec3, _: Vec3) -> Self {}

    #[inline]
    fn intersect(&self, _: [Vec3; 3], _: f32) -> Option<Crossing> {
        None
    }
}

impl<M: SceneMemory> SceneView<M> {
    /// The nearest hit of a ray by the triangle test `T`, spheres as ever; as [`nearest`](Self::nearest) otherwise.
    ///
    /// The grid is walked with the allowances of [`walk`](crate::walk), which are proved for
    /// [`WoopRay`] and hold for a test at least as exact. A test that errs by
    /// more may lose a hit whose `t` is wrong.
    ///
    /// ```
    /// # use rt_core::{Flat, Ray, SceneView, triangle_f64::F64Ray};
    /// # let mesh = scene::builtin::knot(1000);
    /// # let bytes = scene::build(mesh, &Default::default(), &|_| {}).unwrap().to_bytes(4096).unwrap();
    /// # let scene = SceneView::new(Flat::new(&bytes))?;
    /// let ray = Ray { origin: [3.0, 0.1, 9.0].into(), direction: [0.0, 0.0, -1.0].into(), t_max: 100.0 };
    /// let by_default = scene.nearest(&ray, &mut ())?.expect("a hit");
    /// let in_double = scene.nearest_by::<F64Ray, _>(&ray, &mut ())?.expect("a hit");
    /// assert_eq!(by_default.primitive, in_double.primitive);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`Damaged`] when the image lies or a page cannot be had.
    pub fn nearest_by<T: TriangleTest, C: Count>(
        &self,
        ray: &Ray,
        count: &mut C,
    ) -> Result<Option<Hit>, Damaged> {
        let Some(ray) = GridRay::from_world(ray, self.header()) else { return Ok(None) };
        self.nearest_with::<T, _, _>(&ray, &mut (), count)
    }

    /// Whether a ray hits anything by the triangle test `T`, spheres as ever.
    ///
    /// # Errors
    /// [`Damaged`] when the image lies or a page cannot be had.
    pub fn any_by<T: TriangleTest, C: Count>(&self, ray: &Ray, count: &mut C) -> Result<bool, Damaged> {
        let Some(ray) = GridRay::from_world(ray, self.header()) else { return Ok(false) };
        self.any_with::<T, _, _>(&ray, &mut (), count)
    }
}
