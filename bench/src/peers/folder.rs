//! A folder of this run's own.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

/// A folder in the system's temporary one, removed on drop.
#[derive(Debug)]
pub(crate) struct Folder {
    path: PathBuf,
}

impl Folder {
    pub(crate) fn create(experiment: &str) -> Result<Self> {
        let path = std::env::temp_dir().join(format!("memsavvy-{experiment}-{}", std::process::id()));
        fs::create_dir_all(&path).with_context(|| format!("cannot write to {}", path.display()))?;
        Ok(Self { path })
    }

    /// Where a file of this name goes.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        Path::new(&self.path).join(name)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // What cannot be removed lies in the system's temporary folder.
        let _ = fs::remove_dir_all(&self.path);
    }
}
