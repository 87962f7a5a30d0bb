//! Bytes as a volume file, as a name of one, and as a description of one: samples, or one error.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| scene::fuzzing::volume(bytes));
