//! The data folder, which `MEMSAVVY_DATA` names.

use std::path::{Path, PathBuf};

use crate::experiment::Effort;

/// Where a mesh lies, if a data folder is named.
pub(crate) fn mesh_file(name: &str, effort: Effort) -> Option<PathBuf> {
    let Some(folder) = std::env::var_os("MEMSAVVY_DATA") else {
        effort.say(&format!("{name} is left out: MEMSAVVY_DATA does not name the data folder"));
        return None;
    };
    Some(Path::new(&folder).join("meshes").join(format!("{name}.ply")))
}
