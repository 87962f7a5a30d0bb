//! Bytes as a scene image, and as lies in a good one: refused, or traced without leaving them.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| match bytes.split_first() {
    Some((b'I', image)) => scene::fuzzing::image(image),
    Some((_, lies)) => scene::fuzzing::lying_image(lies),
    None => {}
});
