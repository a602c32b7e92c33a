//! The `feedwright` command.

use clap::Parser;
use feedwright_server::cli::{Cli, run};
use feedwright_server::config::ConfigError;
use std::io::Write;
use std::num::NonZero;
use std::process::ExitCode;
use std::thread::available_parallelism;
use tokio::runtime::{Builder, Runtime};

/// A post allocates some hundred times, on several threads, and frees on others.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// How many threads serve, where somebody wants another number: the runtime reads it itself.
const THREADS: &str = "TOKIO_WORKER_THREADS";

/// What it ends with where settings are not accepted (sysexits.h, `EX_CONFIG`): who starts it again need not try before
/// somebody has changed them.
const NOT_ACCEPTED: u8 = 78;

fn main() -> ExitCode {
    let ended =
        runtime().map_err(anyhow::Error::from).and_then(|runtime| runtime.block_on(run(Cli::parse())));
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Who closed standard error does not want to know; the exit code says it too.
            drop(writeln!(std::io::stderr().lock(), "feedwright: {error:#}"));
            match error.downcast_ref::<ConfigError>() {
                Some(_) => NOT_ACCEPTED.into(),
                None => ExitCode::FAILURE,
            }
        }
    }
}

/// One thread for each two processors: groups, connections to the database and long computations have threads of their
/// own. Where there is one for each processor, a request goes from thread to thread between two of its reads, as an idle
/// one takes over what another has just been woken for: each time a thread is woken that has nothing of it in its caches.
fn runtime() -> std::io::Result<Runtime> {
    let mut builder = Builder::new_multi_thread();
    if std::env::var_os(THREADS).is_none() {
        builder.worker_threads(available_parallelism().map_or(1, NonZero::get).div_ceil(2));
    }
    builder.enable_all().build()
}
