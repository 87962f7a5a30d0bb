//! SAME_IMAGE: however a session was drawn, its pictures are the same bytes.

use anyhow::{Result, ensure};
use memsavvy::report::RunReport;

/// The pictures that all runs on a scene must show: nothing is timed of a run that shows others.
#[derive(Debug, Default)]
pub(crate) struct Images {
    frames: Option<Vec<String>>,
}

impl Images {
    pub(crate) fn expect_same(&mut self, run: &RunReport) -> Result<()> {
        let frames: Vec<String> = run.frames.iter().map(|frame| frame.image_hash.clone()).collect();
        let name = &run.scene.name;
        ensure!(
            *self.frames.get_or_insert_with(|| frames.clone()) == frames,
            "SAME_IMAGE: two runs on {name} differ"
        );
        Ok(())
    }
}
