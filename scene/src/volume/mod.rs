//! Volumes: samples on a regular grid, read in runs so that no volume is ever whole in memory.

mod analytic;
mod bytes;
mod error;
mod file_volume;
mod histogram;
mod input;
mod nifti;
mod nrrd;
mod numbers;
mod open;
mod packing;
mod raw;
mod run;
mod sample;
mod shape;
mod stored;
mod vti;

pub use analytic::{Analytic, Formula};
pub use error::{Place, Trouble, VolumeError};
pub use file_volume::FileVolume;
pub use histogram::Histogram;
pub use open::{VolumeFormat, VolumeName, open_file, parse_volume};
pub use raw::RawVolume;
pub use sample::{Endian, SampleType};
pub use shape::{Note, ValueMap, VolumeShape};
pub use stored::{SampleRange, Storage, StoredType};

/// Where a volume's samples come from, run by run.
///
/// Samples are numbered from 0, x fastest, then y, then z. They are handed out as single-precision numbers: exact for
/// every type of 24 bits or less, rounded to the nearest for the others, of which the shape's notes tell. They are
/// what the file holds; [`VolumeShape::world`] makes values of them. NaN and infinities pass through.
pub trait VolumeSource: Send {
    /// Number of samples along each axis, their spacing, and what they are.
    fn shape(&self) -> &VolumeShape;

    /// Reads the samples from number `first` on.
    ///
    /// Going forward costs what is read, from a compressed file what is skipped too. Going back by up to one slice
    /// costs nothing more; by more, a compressed file is read again from its beginning.
    ///
    /// # Errors
    /// When the file cannot be read, ends too early, or does not decompress; `samples` is then in no stated state.
    ///
    /// # Panics
    /// When the volume has not that many samples.
    fn read_samples(&mut self, first: u64, samples: &mut [f32]) -> Result<(), VolumeError>;

    /// Reads whole slices from slice `z` on, as many as `samples` holds; x fastest, then y.
    ///
    /// # Errors
    /// As [`read_samples`](Self::read_samples).
    ///
    /// # Panics
    /// When the volume has not that many slices.
    fn read_slices(&mut self, z: u64, samples: &mut [f32]) -> Result<(), VolumeError> {
        let first = z.checked_mul(self.shape().slice_samples()).expect("a slice of the volume");
        self.read_samples(first, samples)
    }
}
