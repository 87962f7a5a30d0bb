//! What a node is told about one frame.

use core::fmt;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use crate::camera::{Aim, Camera, Orbit, OrbitPlace};
use crate::cubic::Solver;
#[cfg(doc)]
use crate::shade::ALBEDO;
use crate::triangle_test::TriangleTestKind;

/// One picture to draw: its size, camera, light, shadow rule and isosurfaces. 136 bytes of fixed layout, sent as they are.
///
/// Bytes from outside become a frame through [`read`](Self::read) only.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Frame {
    /// Number of the frame in its run.
    pub number: u32,
    /// Pixels in a row, `1..=SIZE_MAX`.
    pub width: u32,
    /// Rows, `1..=SIZE_MAX`.
    pub height: u32,
    /// Bits: [`NO_SHADOWS`](Self::NO_SHADOWS), [`MOLLER`](Self::MOLLER).
    pub flags: u32,
    /// Eye and directions of the pixels.
    pub camera: Camera,
    /// Where the point light is, in world units.
    pub light: Vec3,
    /// How far shadow rays start off the surface, in world units.
    pub shadow_offset: f32,
    /// How roots are found, by the number of the [`Solver`].
    pub solver: u32,
    /// How many of `isosurfaces` there are.
    pub isosurface_count: u32,
    /// The isosurfaces, then zeros. See [`with_isosurfaces`](Self::with_isosurfaces).
    pub isosurfaces: [Isosurface; ISOVALUES_MAX],
}

/// An isosurface of a scene's volume, as a frame shows it. Costs nothing to change from one frame to the next.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Isosurface {
    /// The value of the volume on it. Where nothing in the volume has this value, nothing is shown.
    pub value: f32,
    /// Grey when fully lit, `0..=1`; [`ALBEDO`] is that of a mesh.
    pub albedo: f32,
}

/// Why bytes were refused as a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum FrameError {
    /// Not exactly as many bytes as a frame has.
    Length {
        /// Bytes there are.
        got: usize,
    },
    /// Width or height is 0 or above [`Frame::SIZE_MAX`].
    Size {
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A number of the camera or light is NaN or infinite.
    NotFinite,
    /// Flags that this build does not know.
    Flags(u32),
    /// More isosurfaces than a frame can show.
    Isosurfaces {
        /// How many.
        got: usize,
    },
    /// An isovalue that is not finite, or a grey outside `0..=1`.
    Isosurface,
    /// The number of no solver.
    Solver(u32),
    /// Shadows are wanted, which were left out of this build.
    Shadows,
}

impl Frame {
    /// Flag: the light shines through everything, and no shadow rays are traced.
    pub const NO_SHADOWS: u32 = 1;

    /// Flag: triangles are tested by [`TriangleTestKind::Moller`]. Scenes with a volume do not look at it.
    pub const MOLLER: u32 = 1 << 1;

    /// Largest width and height.
    pub const SIZE_MAX: u32 = 16_384;

    /// Length of a frame in bytes.
    pub const BYTES: usize = size_of::<Self>();

    /// A frame of an orbit, with the orbit's light; with shadows, unless this build has none.
    ///
    /// # Errors
    /// When the size is out of range, or the place is so extreme that numbers overflow.
    pub fn on_orbit(orbit: &Orbit, place: &OrbitPlace, width: u32, height: u32) -> Result<Self, FrameError> {
        Self::seen(place.frame, orbit, orbit.camera(place, width, height), orbit.light(), [width, height])
    }

    /// A frame of an eye and a light anywhere around the scene that `orbit` is around, the light given as the points of
    /// an [`Aim`] are; with shadows, unless this build has none.
    ///
    /// # Errors
    /// When the size is out of range, or the aim is no camera or so extreme that numbers overflow.
    pub fn aimed(
        number: u32,
        orbit: &Orbit,
        aim: &Aim,
        light: [f64; 3],
        [width, height]: [u32; 2],
    ) -> Result<Self, FrameError> {
        Self::seen(number, orbit, orbit.aimed(aim, width, height), orbit.point(light), [width, height])
    }

    fn seen(
        number: u32,
        orbit: &Orbit,
        camera: Camera,
        light: Vec3,
        [width, height]: [u32; 2],
    ) -> Result<Self, FrameError> {
        let frame = Self {
            number,
            width,
            height,
            flags: if cfg!(feature = "shadows") { 0 } else { Self::NO_SHADOWS },
            camera,
            light,
            shadow_offset: orbit.shadow_offset(),
            solver: Solver::default() as u32,
            isosurface_count: 0,
            isosurfaces: [Isosurface::zeroed(); ISOVALUES_MAX],
        };
        frame.check()
    }

    /// The same frame with these isosurfaces.
    ///
    /// # Errors
    /// When there are more than [`ISOVALUES_MAX`], or a number of one makes no sense.
    pub fn with_isosurfaces(mut self, surfaces: &[Isosurface], solver: Solver) -> Result<Self, FrameError> {
        let too_many = FrameError::Isosurfaces { got: surfaces.len() };
        self.isosurfaces = [Isosurface::zeroed(); ISOVALUES_MAX];
        self.isosurfaces.get_mut(..surfaces.len()).ok_or(too_many)?.copy_from_slice(surfaces);
        self.isosurface_count = u32::try_from(surfaces.len()).map_err(|_| too_many)?;
        self.solver = solver as u32;
        self.check()
    }

    /// The same frame drawn with this triangle test.
    #[must_use]
    pub const fn with_triangle_test(self, test: TriangleTestKind) -> Self {
        let flag = if matches!(test, TriangleTestKind::Moller) { Self::MOLLER } else { 0 };
        Self { flags: self.flags & !Self::MOLLER | flag, ..self }
    }

    /// How triangles are tested.
    pub const fn triangle_test(&self) -> TriangleTestKind {
        if self.flags & Self::MOLLER == 0 { TriangleTestKind::Woop } else { TriangleTestKind::Moller }
    }

    /// The isosurfaces that are shown.
    pub fn isosurfaces(&self) -> &[Isosurface] {
        self.isosurfaces.get(..self.isosurface_count as usize).unwrap_or_default()
    }

    /// How roots are found.
    pub fn solver(&self) -> Solver {
        Solver::from_bits(self.solver).unwrap_or_default()
    }

    /// Reads and checks a frame.
    ///
    /// # Errors
    /// Says what is wrong with the bytes.
    pub fn read(bytes: &[u8]) -> Result<Self, FrameError> {
        let frame: Self =
            bytemuck::try_pod_read_unaligned(bytes).map_err(|_| FrameError::Length { got: bytes.len() })?;
        frame.check()
    }

    /// Whether points look for what stands between them and the light.
    #[inline]
    pub const fn has_shadows(&self) -> bool {
        cfg!(feature = "shadows") && self.flags & Self::NO_SHADOWS == 0
    }

    /// The bytes of the frame.
    pub fn as_bytes(&self) -> &[u8] {
        bytemuck::bytes_of(self)
    }

    fn check(self) -> Result<Self, FrameError> {
        let size = 1..=Self::SIZE_MAX;
        if !size.contains(&self.width) || !size.contains(&self.height) {
            return Err(FrameError::Size { width: self.width, height: self.height });
        }
        let Camera { eye, forward, right, up, x_first, x_step, y_first, y_step } = self.camera;
        let vectors = [eye, forward, right, up, self.light];
        let numbers = [x_first, x_step, y_first, y_step, self.shadow_offset];
        if !vectors.iter().all(|v| v.is_finite()) || !numbers.iter().all(|n| n.is_finite()) {
            return Err(FrameError::NotFinite);
        }
        if self.flags & !(Self::NO_SHADOWS | Self::MOLLER) != 0 {
            return Err(FrameError::Flags(self.flags));
        }
        if self.isosurface_count as usize > ISOVALUES_MAX {
            return Err(FrameError::Isosurfaces { got: self.isosurface_count as usize });
        }
        let is_usable = |one: &Isosurface| one.value.is_finite() && (0.0..=1.0).contains(&one.albedo);
        if !self.isosurfaces().iter().all(is_usable) {
            return Err(FrameError::Isosurface);
        }
        Solver::from_bits(self.solver).ok_or(FrameError::Solver(self.solver))?;
        if !cfg!(feature = "shadows") && self.flags & Self::NO_SHADOWS == 0 {
            return Err(FrameError::Shadows);
        }
        Ok(self)
    }
}

impl fmt::Display for FrameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length { got } => write!(f, "a frame has {} bytes, got {got}", Frame::BYTES),
            Self::Size { width, height } => {
                write!(f, "pictures are 1 to {} pixels wide and high, not {width}x{height}", Frame::SIZE_MAX)
            }
            Self::Flags(flags) => write!(f, "a frame with flags that this build does not know: {flags:#x}"),
            Self::Isosurfaces { got } => {
                write!(f, "{got} isosurfaces in a frame; it shows at most {ISOVALUES_MAX}")
            }
            Self::Isosurface => write!(f, "an isosurface has a finite value and a grey from 0 to 1"),
            Self::Solver(number) => {
                write!(f, "a frame with a solver that this build does not know: {number}")
            }
            Self::Shadows => write!(f, "a frame with shadows, which were left out of this build"),
            Self::NotFinite => write!(f, "camera or light has a coordinate that is not finite"),
        }
    }
}

impl core::error::Error for FrameError {}

/// Most isosurfaces of a frame.
pub const ISOVALUES_MAX: usize = 4;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Bounds;

    fn frame(radius: f32, width: u32) -> Result<Frame, FrameError> {
        let orbit = Orbit::around(&Bounds { low: Vec3::ZERO, high: Vec3::ONE });
        Frame::on_orbit(&orbit, &OrbitPlace { radius, elevation: 0.0, frame: 2, frames: 3 }, width, 20)
    }

    #[test]
    fn bytes_round_trip() {
        let frame = frame(1.5, 30).expect("valid");
        assert_eq!(frame.as_bytes().len(), 136);
        assert_eq!(Frame::read(frame.as_bytes()), Ok(frame));
    }

    #[test]
    fn the_triangle_test_round_trips_and_unknown_flags_are_refused() {
        let woop = frame(1.5, 30).expect("valid");
        let moller = woop.with_triangle_test(TriangleTestKind::Moller);
        for frame in [woop, moller] {
            assert_eq!(Frame::read(frame.as_bytes()), Ok(frame));
            assert_eq!(frame.triangle_test().name().parse(), Ok(frame.triangle_test()));
        }
        assert_eq!(moller.with_triangle_test(TriangleTestKind::Woop), woop);
        assert_eq!(
            (woop.triangle_test(), moller.triangle_test()),
            (TriangleTestKind::Woop, TriangleTestKind::Moller)
        );
        let unknown = Frame { flags: 1 << 7, ..woop };
        assert_eq!(Frame::read(unknown.as_bytes()), Err(FrameError::Flags(1 << 7)));
        assert!("muller".parse::<TriangleTestKind>().is_err());
    }

    #[test]
    fn isosurfaces_round_trip_and_impossible_ones_are_refused() {
        let plain = frame(1.5, 30).expect("valid");
        let one = |value, albedo| Isosurface { value, albedo };
        let with = |surfaces: &[Isosurface]| plain.with_isosurfaces(surfaces, Solver::Bisect);
        let two = with(&[one(80.5, 0.8), one(-1.0, 0.0)]).expect("valid");
        assert_eq!(Frame::read(two.as_bytes()), Ok(two));
        assert_eq!((two.isosurfaces().len(), two.solver()), (2, Solver::Bisect));
        assert_eq!(with(&[one(0.0, 0.5); 5]), Err(FrameError::Isosurfaces { got: 5 }));
        for wrong in [one(f32::NAN, 0.5), one(f32::INFINITY, 0.5), one(0.0, 1.5), one(0.0, f32::NAN)] {
            assert_eq!(with(&[wrong]), Err(FrameError::Isosurface));
        }
        let mut bytes = [0; Frame::BYTES];
        bytes.copy_from_slice(two.as_bytes());
        bytes[100] = 5;
        assert_eq!(Frame::read(&bytes), Err(FrameError::Isosurfaces { got: 5 }));
        bytes[96] = 7;
        bytes[100] = 2;
        assert_eq!(Frame::read(&bytes), Err(FrameError::Solver(7)));
    }

    #[test]
    fn impossible_frames_are_refused() {
        assert_eq!(frame(1.5, 0), Err(FrameError::Size { width: 0, height: 20 }));
        assert_eq!(frame(1.5, 16_385), Err(FrameError::Size { width: 16_385, height: 20 }));
        assert_eq!(frame(f32::MAX, 30), Err(FrameError::NotFinite));
        assert_eq!(frame(0.0, 30), Err(FrameError::NotFinite));
        assert_eq!(Frame::read(&[0; 135]), Err(FrameError::Length { got: 135 }));
    }
}
