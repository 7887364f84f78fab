//! The `realnet` program.
//!
//! Exit codes: 0 done, 1 something failed, 2 the input was bad (also a wrong
//! command line), 130 stopped by Ctrl-C.

mod cli;

// Networks allocate and free the same large blocks for every frame; the system's
// allocator gives them back to the kernel each time.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    cli::run()
}
