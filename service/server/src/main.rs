//! The `feedwright` command.

use clap::Parser;
use feedwright_server::cli::{Cli, run};
use std::process::ExitCode;

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
