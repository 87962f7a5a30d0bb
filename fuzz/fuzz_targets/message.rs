//! Bytes as a message to a node and to a home.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    #[cfg(fuzzing)]
    dsm_core::fuzzing::message(bytes);
    #[cfg(not(fuzzing))]
    let _ = bytes;
});
