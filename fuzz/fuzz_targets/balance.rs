//! Bytes as all that happens to a cluster that balances its tiles, under the eyes of the oracle.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| balance_ops::run_bytes(bytes));
