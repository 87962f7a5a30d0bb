//! Makes the scene images that the program traces, and has it linked without anything of the system's.

use std::path::Path;

use scene::{BuildOptions, build, builtin};

fn main() {
    let folder = std::env::var_os("OUT_DIR").expect("cargo names a folder");
    for (name, model) in [("knot", builtin::knot(2000).into()), ("sphereflake", builtin::sphereflake(2))] {
        let scene = build(model, &BuildOptions::default(), &|_| {}).expect("a built-in scene builds");
        let image = scene.to_bytes(4096).expect("a built-in scene is written");
        let path = Path::new(&folder).join(format!("{name}.msv"));
        std::fs::write(path, image).expect("cargo's folder can be written to");
    }
    for argument in ["-nostartfiles", "-nostdlib", "-static"] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
    println!("cargo::rerun-if-changed=build.rs");
}
