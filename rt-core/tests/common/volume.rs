//! Small volumes in memory.

use std::io::Cursor;

use rt_core::isosurface_f64::Samples;
use rt_core::{Flat, SceneView};
use scene::volume::{SampleType, StoredType};
use scene::{VolumeError, VolumeShape, VolumeSource, write_volume};

/// A volume held in memory, as a source and as the reference wants it.
pub struct InMemory {
    pub shape: VolumeShape,
    pub samples: Vec<f32>,
}

impl InMemory {
    /// Samples by their coordinates.
    pub fn new(dims: [usize; 3], sample: impl Fn([usize; 3]) -> f32) -> Self {
        let [x, y, z] = dims;
        let at = |i: usize| [i % x, i / x % y, i / x / y];
        let samples = (0..x * y * z).map(|i| sample(at(i))).collect();
        let shape = VolumeShape::new(dims.map(|count| count as u64), SampleType::F32).expect("a shape");
        Self { shape, samples }
    }

    /// The scene image, with samples stored as asked, or without loss.
    pub fn image(&mut self, stored: Option<StoredType>, page_bytes: u32) -> Vec<u8> {
        let mut out = Cursor::new(Vec::new());
        write_volume(self, None, stored, page_bytes, &mut out, &|_| {}).expect("an image");
        out.into_inner()
    }

    pub fn reference(&self) -> Samples<'_> {
        let dims = self.shape.dims.map(|count| usize::try_from(count).expect("small"));
        Samples { dims, samples: &self.samples }
    }
}

impl VolumeSource for InMemory {
    fn shape(&self) -> &VolumeShape {
        &self.shape
    }

    fn read_samples(&mut self, first: u64, samples: &mut [f32]) -> Result<(), VolumeError> {
        let first = usize::try_from(first).expect("small");
        samples.copy_from_slice(&self.samples[first..][..samples.len()]);
        Ok(())
    }
}

pub fn view(image: &[u8]) -> SceneView<Flat<'_>> {
    scene::file::view_of(image).expect("a sound image")
}
