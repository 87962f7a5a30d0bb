//! Bytes as all that happens to a cluster of the paging core, under the eyes of the oracle.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| dsm_ops::run_bytes(bytes));
