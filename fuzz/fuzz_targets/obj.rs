//! Bytes as an OBJ file: a mesh whose indices are good, or one error.
#![no_main]

use libfuzzer_sys::fuzz_target;
use scene::read::Format;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(mesh) = scene::parse_mesh(bytes, Some(Format::Obj)) {
        assert!(mesh.triangles.iter().flatten().all(|index| (*index as usize) < mesh.positions.len()));
    }
});
