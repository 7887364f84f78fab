//! The `realnet` program.
//!
//! Exit codes: 0 done, 1 something failed, 2 the input was bad (also a wrong
//! command line), 130 stopped by Ctrl-C.

mod cli;

fn main() -> std::process::ExitCode {
    cli::run()
}
