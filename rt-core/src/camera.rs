//! Pinhole camera; the orbit that our comparisons with other programs use; and cameras anywhere around a scene.
//!
//! The formulas and their order are those of our peer measurements, in `f32`, so that pictures and ray counts
//! can be compared. With `c` and `D` the centre and diagonal of the mesh's bounds, frame `i` of `F`,
//! elevation `e`, radius `R` in diagonals: `a = 2 pi i / F`, `eye = c + R D (sin a cos e, sin e, cos a cos
//! e)`, `forward = normalize(c - eye)`, `right = normalize(forward x (0, 1, 0))`, `up = right x forward`,
//! vertical field of view 45 degrees.
//!
//! An [`Aim`] may be anywhere: `eye = c + D p`, `forward = normalize(at - p)`, and `right` and `up` likewise from
//! the aim's own up, in `f64`, rounded once.

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};

use crate::image::Bounds;
use crate::scale::{Scale, exponent_of};

/// A pinhole camera: where the eye is, and the direction of each pixel's ray. World units.
///
/// The direction of pixel `(x, y)`, `y` down, is `forward + up * (y_first + y * y_step) + right * (x_first +
/// x * x_step)`. It is not normalised: `t` along it is depth along `forward`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Camera {
    /// Where all rays start.
    pub eye: Vec3,
    /// Unit vector towards the middle of the picture.
    pub forward: Vec3,
    /// Unit vector to the right.
    pub right: Vec3,
    /// Unit vector upwards.
    pub up: Vec3,
    /// Share of `right` in the first column's rays.
    pub x_first: f32,
    /// What each further column adds.
    pub x_step: f32,
    /// Share of `up` in the first row's rays.
    pub y_first: f32,
    /// What each further row adds; negative.
    pub y_step: f32,
}

impl Camera {
    /// A camera with a vertical field of view of 45 degrees, its axes forward, right and up.
    fn new(eye: Vec3, [forward, right, up]: [Vec3; 3], width: u32, height: u32) -> Self {
        let (columns, rows) = (width as f32, height as f32);
        let half_height = single(libm::tan(22.5 * core::f64::consts::PI / 180.0));
        let aspect = columns / rows;
        Self {
            eye,
            forward,
            right,
            up,
            x_first: (1.0 / columns - 1.0) * half_height * aspect,
            x_step: 2.0 / columns * half_height * aspect,
            y_first: (1.0 - 1.0 / rows) * half_height,
            y_step: -2.0 / rows * half_height,
        }
    }

    /// Direction of the rays of row `y`, before the share of `right`.
    #[inline]
    pub fn row(&self, y: u32) -> Vec3 {
        self.forward + self.up * (self.y_first + y as f32 * self.y_step)
    }

    /// Direction of the ray of column `x` in that row.
    #[inline]
    pub fn direction(&self, row: Vec3, x: u32) -> Vec3 {
        row + self.right * (self.x_first + x as f32 * self.x_step)
    }
}

/// Cameras on a sphere around a scene, all looking at its centre, and the light that goes with them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    /// Centre of the bounds, in units of `world_from_local`.
    centre: Vec3,
    /// Diagonal of the bounds, in the same units.
    diagonal: f32,
    /// The orbit is computed near unit size, so that squares of lengths neither overflow nor underflow.
    world_from_local: Scale,
}

/// Which camera of an orbit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrbitPlace {
    /// Distance of the eye from the centre, in diagonals of the bounds.
    pub radius: f32,
    /// Height of the eye, in degrees above the horizon.
    pub elevation: f64,
    /// Number of the frame.
    pub frame: u32,
    /// Frames in a full circle; 0 is taken as 1.
    pub frames: u32,
}

/// Where an eye is and what it looks at, wherever and however large the scene: points are offsets from the centre of
/// the scene's bounds, in diagonals of them. The axes are the scene's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aim {
    /// The eye.
    pub eye: [f64; 3],
    /// The point in the middle of the picture; another one than the eye.
    pub at: [f64; 3],
    /// Roughly upwards in the picture: a direction that is not the line of sight.
    pub up: [f64; 3],
}

impl Orbit {
    /// The orbit around these bounds.
    pub fn around(bounds: &Bounds) -> Self {
        let largest = bounds.low.abs().max(bounds.high.abs()).max_element();
        let local_from_world = Scale::new(-exponent_of(largest));
        let (low, high) = (local_from_world.apply_to(bounds.low), local_from_world.apply_to(bounds.high));
        Self {
            centre: (low + high) * 0.5,
            diagonal: length(high - low),
            world_from_local: local_from_world.inverse(),
        }
    }

    /// The camera at a place of the orbit, for pictures of `width` by `height` pixels.
    pub fn camera(&self, place: &OrbitPlace, width: u32, height: u32) -> Camera {
        let angle = 2.0 * core::f64::consts::PI * f64::from(place.frame) / f64::from(place.frames.max(1));
        let elevation = place.elevation * core::f64::consts::PI / 180.0;
        let (sin, cos, cos_elevation) = (libm::sin(angle), libm::cos(angle), libm::cos(elevation));
        let outwards =
            Vec3::new(single(sin * cos_elevation), single(libm::sin(elevation)), single(cos * cos_elevation));
        let eye = self.centre + outwards * (place.radius * self.diagonal);
        let forward = normalize(self.centre - eye);
        let across = cross(forward, Vec3::Y);
        // Straight above or below, the limit from the same side of the orbit.
        let right =
            if across == Vec3::ZERO { Vec3::new(single(cos), 0.0, single(-sin)) } else { normalize(across) };
        Camera::new(
            self.world_from_local.apply_to(eye),
            [forward, right, cross(right, forward)],
            width,
            height,
        )
    }

    /// The camera of an aim, for pictures of `width` by `height` pixels. Its numbers are NaN when the aim has no line of
    /// sight, or one along its up.
    pub fn aimed(&self, aim: &Aim, width: u32, height: u32) -> Camera {
        let [eye, at, up] = [aim.eye, aim.at, aim.up].map(DVec3::from_array);
        let forward = (at - eye).normalize();
        let right = forward.cross(up).normalize();
        let axes = [forward, right, right.cross(forward)].map(|axis| axis.to_array().map(single).into());
        Camera::new(self.point(aim.eye), axes, width, height)
    }

    /// A point given as an offset from the centre in diagonals. World units.
    pub fn point(&self, offset: [f64; 3]) -> Vec3 {
        let local =
            |axis: usize| single(f64::from(self.centre[axis]) + offset[axis] * f64::from(self.diagonal));
        self.world_from_local.apply_to(Vec3::new(local(0), local(1), local(2)))
    }

    /// The point light: above and to the right of the first camera, without fall-off. World units.
    pub fn light(&self) -> Vec3 {
        self.world_from_local.apply_to(self.centre + Vec3::new(1.0, 2.0, 1.5) * self.diagonal)
    }

    /// How far shadow rays start off the surface. World units.
    pub fn shadow_offset(&self) -> f32 {
        self.world_from_local.apply(1.0e-4 * self.diagonal)
    }

    /// Diagonal of the bounds. World units.
    pub fn diagonal(&self) -> f32 {
        self.world_from_local.apply(self.diagonal)
    }
}

#[expect(clippy::cast_possible_truncation, reason = "the formulas round to single precision here")]
const fn single(value: f64) -> f32 {
    value as f32
}

fn length(v: Vec3) -> f32 {
    libm::sqrtf(v.x * v.x + v.y * v.y + v.z * v.z)
}

fn normalize(v: Vec3) -> Vec3 {
    v * (1.0 / length(v))
}

fn cross(a: Vec3, b: Vec3) -> Vec3 {
    Vec3::new(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUNDS: Bounds = Bounds { low: Vec3::new(-1.0, -2.0, -3.0), high: Vec3::new(3.0, 2.0, 1.0) };

    fn place(elevation: f64, frame: u32) -> OrbitPlace {
        OrbitPlace { radius: 1.5, elevation, frame, frames: 8 }
    }

    #[test]
    fn the_first_camera_looks_along_minus_z() {
        let orbit = Orbit::around(&BOUNDS);
        let camera = orbit.camera(&place(0.0, 0), 512, 256);
        assert_eq!(orbit.diagonal(), 48.0_f32.sqrt());
        assert_eq!(camera.eye, Vec3::new(1.0, 0.0, -1.0 + 1.5 * orbit.diagonal()));
        // Normalising in single precision is off by a bit; the peers' formulas are what counts.
        for (axis, expected) in [(camera.forward, Vec3::NEG_Z), (camera.right, Vec3::X), (camera.up, Vec3::Y)]
        {
            assert!((axis - expected).abs().max_element() < 1.0e-6, "{axis}");
        }
        let corner = camera.direction(camera.row(0), 0);
        assert!(corner.x < -0.8 && corner.y > 0.4, "{corner}");
        let mirrored = camera.direction(camera.row(255), 511);
        assert!((corner.x + mirrored.x).abs() < 1.0e-6 && (corner.y + mirrored.y).abs() < 1.0e-6);
    }

    #[test]
    fn straight_above_is_a_proper_camera() {
        for frame in 0..8 {
            for elevation in [-90.0, 90.0] {
                let camera = Orbit::around(&BOUNDS).camera(&place(elevation, frame), 64, 64);
                for axis in [camera.forward, camera.right, camera.up] {
                    assert!((length(axis) - 1.0).abs() < 1.0e-6, "{camera:?}");
                }
            }
        }
    }

    #[test]
    fn an_aim_at_the_centre_is_a_place_of_the_orbit() {
        let orbit = Orbit::around(&BOUNDS);
        for frame in 0..8 {
            for degrees in [-60.0, 0.0, 35.0] {
                let (turn, tilt) =
                    (f64::from(frame) * 0.25 * core::f64::consts::PI, f64::to_radians(degrees));
                let outwards = [turn.sin() * tilt.cos(), tilt.sin(), turn.cos() * tilt.cos()];
                let aim = Aim { eye: outwards.map(|one| one * 1.5), at: [0.0; 3], up: [0.0, 1.0, 0.0] };
                let (aimed, placed) =
                    (orbit.aimed(&aim, 64, 48), orbit.camera(&place(degrees, frame), 64, 48));
                let axes = |camera: &Camera| [camera.eye, camera.forward, camera.right, camera.up];
                for (one, other) in axes(&aimed).into_iter().zip(axes(&placed)) {
                    assert!((one - other).abs().max_element() < 4.0e-6, "{aimed:?} {placed:?}");
                }
                assert_eq!((aimed.x_first, aimed.y_step), (placed.x_first, placed.y_step));
            }
        }
        assert_eq!(orbit.point([1.0, 2.0, 1.5]), orbit.light());
    }

    #[test]
    fn an_aim_along_its_up_is_no_camera() {
        let aim = Aim { eye: [0.0, 2.0, 0.0], at: [0.0; 3], up: [0.0, 1.0, 0.0] };
        let camera = Orbit::around(&BOUNDS).aimed(&aim, 64, 48);
        assert!(camera.right.is_nan() && !camera.forward.is_nan());
    }

    #[test]
    fn scaling_the_scene_scales_the_camera_exactly() {
        let small = Orbit::around(&BOUNDS);
        for exponent in [-98, -40, 60, 98] {
            let scale = Scale::new(exponent);
            let bounds = Bounds { low: scale.apply_to(BOUNDS.low), high: scale.apply_to(BOUNDS.high) };
            let large = Orbit::around(&bounds);
            let (a, b) = (small.camera(&place(20.0, 3), 40, 30), large.camera(&place(20.0, 3), 40, 30));
            assert_eq!(b, Camera { eye: scale.apply_to(a.eye), ..a });
            let aim = Aim { eye: [0.3, 0.7, -0.4], at: [0.1, 0.0, 0.0], up: [0.0, 1.0, 0.0] };
            let (a, b) = (small.aimed(&aim, 40, 30), large.aimed(&aim, 40, 30));
            assert_eq!(b, Camera { eye: scale.apply_to(a.eye), ..a });
            assert_eq!(large.light(), scale.apply_to(small.light()));
        }
    }
}
