//! Makes the scene image that the program traces, and has it linked without anything of the system's.

use std::path::Path;

use scene::{BuildOptions, build, builtin};

fn main() {
    let folder = std::env::var_os("OUT_DIR").expect("cargo names a folder");
    let scene = build(builtin::knot(2000), &BuildOptions::default(), &|_| {}).expect("the knot builds");
    let image = scene.to_bytes(4096).expect("the knot is written");
    std::fs::write(Path::new(&folder).join("knot.msv"), image).expect("cargo's folder can be written to");
    for argument in ["-nostartfiles", "-nostdlib", "-static"] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
    println!("cargo::rerun-if-changed=build.rs");
}
