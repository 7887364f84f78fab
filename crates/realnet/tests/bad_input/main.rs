//! Bad input: each case ends with the right exit code and a message that names
//! what is wrong, in the words of the program and not of a panic; what was
//! written before stays whole.
//!
//! Exit code 2 says that the input was bad, 1 that something failed.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]

mod cases;
#[path = "../common/mod.rs"]
mod common;
mod data;
mod interrupt;
mod models;
mod options;
mod outputs;
mod pt;
mod sources;
