//! The data folder, which `MEMSAVVY_DATA` names.

use std::path::PathBuf;

use crate::experiment::Effort;

/// Where a mesh lies, if a data folder is named.
pub(crate) fn mesh_file(name: &str, effort: Effort) -> Option<PathBuf> {
    Some(folder(name, effort)?.join("meshes").join(format!("{name}.ply")))
}

/// Where the description of a volume lies, if a data folder is named.
pub(crate) fn volume_file(name: &str, effort: Effort) -> Option<PathBuf> {
    Some(folder(name, effort)?.join("volumes").join(format!("{name}.json")))
}

fn folder(wanted: &str, effort: Effort) -> Option<PathBuf> {
    let folder = std::env::var_os("MEMSAVVY_DATA").map(PathBuf::from);
    if folder.is_none() {
        effort.say(&format!("{wanted} is left out: MEMSAVVY_DATA does not name the data folder"));
    }
    folder
}
