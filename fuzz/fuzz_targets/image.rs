//! Feeds made-up bytes to `boresight_io::fuzzing::image`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| boresight_io::fuzzing::image(bytes));
