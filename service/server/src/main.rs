//! The `feedwright` command.

use clap::Parser;
use feedwright_server::cli::{Cli, run};
use std::process::ExitCode;

/// A post allocates some hundred times, on several threads, and frees on others.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

#[tokio::main]
async fn main() -> ExitCode {
    match run(Cli::parse()).await {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("feedwright: {error:#}");
            ExitCode::FAILURE
        }
    }
}
