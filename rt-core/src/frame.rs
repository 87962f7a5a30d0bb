//! What a node is told about one frame.

use core::fmt;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use crate::camera::{Camera, Orbit, OrbitPlace};

/// One picture to draw: its size, camera, light and shadow rule. 96 bytes of fixed layout, sent as they are.
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
    /// Bits: what to leave out. See [`NO_SHADOWS`](Self::NO_SHADOWS).
    pub flags: u32,
    /// Eye and directions of the pixels.
    pub camera: Camera,
    /// Where the point light is, in world units.
    pub light: Vec3,
    /// How far shadow rays start off the surface, in world units.
    pub shadow_offset: f32,
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
    /// Shadows are wanted, which were left out of this build.
    Shadows,
}

impl Frame {
    /// Flag: the light shines through everything, and no shadow rays are traced.
    pub const NO_SHADOWS: u32 = 1;

    /// Largest width and height.
    pub const SIZE_MAX: u32 = 16_384;

    /// Length of a frame in bytes.
    pub const BYTES: usize = size_of::<Self>();

    /// A frame of an orbit, with the orbit's light; with shadows, unless this build has none.
    ///
    /// # Errors
    /// When the size is out of range, or the place is so extreme that numbers overflow.
    pub fn on_orbit(orbit: &Orbit, place: &OrbitPlace, width: u32, height: u32) -> Result<Self, FrameError> {
        let frame = Self {
            number: place.frame,
            width,
            height,
            flags: if cfg!(feature = "shadows") { 0 } else { Self::NO_SHADOWS },
            camera: orbit.camera(place, width, height),
            light: orbit.light(),
            shadow_offset: orbit.shadow_offset(),
        };
        frame.check()
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
        if self.flags & !Self::NO_SHADOWS != 0 {
            return Err(FrameError::Flags(self.flags));
        }
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
            Self::Shadows => write!(f, "a frame with shadows, which were left out of this build"),
            Self::NotFinite => write!(f, "camera or light has a coordinate that is not finite"),
        }
    }
}

impl core::error::Error for FrameError {}

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
        assert_eq!(frame.as_bytes().len(), 96);
        assert_eq!(Frame::read(frame.as_bytes()), Ok(frame));
    }

    #[test]
    fn impossible_frames_are_refused() {
        assert_eq!(frame(1.5, 0), Err(FrameError::Size { width: 0, height: 20 }));
        assert_eq!(frame(1.5, 16_385), Err(FrameError::Size { width: 16_385, height: 20 }));
        assert_eq!(frame(f32::MAX, 30), Err(FrameError::NotFinite));
        assert_eq!(frame(0.0, 30), Err(FrameError::NotFinite));
        assert_eq!(Frame::read(&[0; 95]), Err(FrameError::Length { got: 95 }));
    }
}
