//! Volumes that experiments look at: two formulas of any size, and the scans of the data folder.

use std::io::Cursor;

use anyhow::Result;
use rt_core::camera::OrbitPlace;
use rt_core::shade::ALBEDO;
use rt_core::{Bounds, Frame, Isosurface, Orbit, Solver};
use scene::volume::{Formula, StoredType, VolumeName, VolumeSource};
use scene::write_volume;

use crate::data;
use crate::experiment::Effort;

/// A volume, and which of its isosurfaces is looked at.
#[derive(Clone, Debug)]
pub(crate) struct Subject {
    pub(crate) name: String,
    pub(crate) volume: VolumeName,
    pub(crate) isovalue: f32,
}

/// From where a volume is looked at.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Look {
    /// Width and height of the picture.
    pub(crate) size: u32,
    /// Distance of the eye, in diagonals.
    pub(crate) radius: f32,
    /// Number of the frame, and how many there are around the volume.
    pub(crate) frame: u32,
    pub(crate) frames: u32,
}

/// Scans of the data folder, with the isovalue that shows most of each.
const SCANS: [(&str, f32); 2] = [("engine", 80.5), ("bonsai", 40.5)];

/// Of images that are made here.
pub(crate) const PAGE_BYTES: u32 = 16 << 10;

impl Subject {
    pub(crate) fn gyroid(n: u64) -> Self {
        Self::analytic(Formula::Gyroid, n)
    }

    pub(crate) fn marschner_lobb(n: u64) -> Self {
        Self::analytic(Formula::MarschnerLobb, n)
    }

    /// The scans that are here; none for a quick look.
    pub(crate) fn scans(effort: Effort) -> Vec<Self> {
        let mut scans = Vec::new();
        for (name, isovalue) in SCANS.into_iter().filter(|_| !effort.is_quick()) {
            match data::volume_file(name, effort).filter(|path| path.exists()) {
                Some(path) => {
                    scans.push(Self { name: name.to_owned(), volume: VolumeName::File(path), isovalue });
                }
                None => effort.say(&format!("{name} is left out: it is not in the data folder")),
            }
        }
        scans
    }

    fn analytic(formula: Formula, n: u64) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "0 or 0.5")]
        let isovalue = formula.isovalue() as f32;
        let name = format!("{} {n}", formula.name());
        Self { name, volume: VolumeName::Analytic { formula, n }, isovalue }
    }

    pub(crate) fn open(&self) -> Result<Box<dyn VolumeSource>> {
        Ok(self.volume.clone().open()?)
    }

    /// The scene image, with samples stored as asked, or without loss.
    pub(crate) fn image(&self, stored: Option<StoredType>) -> Result<Vec<u8>> {
        let mut out = Cursor::new(Vec::new());
        write_volume(&mut *self.open()?, None, stored, PAGE_BYTES, &mut out, &|_| {})?;
        Ok(out.into_inner())
    }

    /// A frame that shows an isosurface of a volume in this box.
    pub(crate) fn frame(view: &Bounds, look: Look, isovalue: f32, solver: Solver) -> Result<Frame> {
        let Look { size, radius, frame, frames } = look;
        let place = OrbitPlace { radius, elevation: 0.0, frame, frames };
        let frame = Frame::on_orbit(&Orbit::around(view), &place, size, size)?;
        Ok(frame.with_isosurfaces(&[Isosurface { value: isovalue, albedo: ALBEDO }], solver)?)
    }
}
