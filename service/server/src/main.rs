//! The `feedwright` command.

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

/// How many threads serve, where somebody wants another number.
const THREADS: &str = "TOKIO_WORKER_THREADS";

/// Most of them: more than any machine has processors.
const MOST_THREADS: usize = 4096;

/// What it ends with where settings are not accepted (sysexits.h, `EX_CONFIG`): who starts it again need not try before
/// somebody has changed them.
const NOT_ACCEPTED: u8 = 78;

fn main() -> ExitCode {
    let cli = Cli::of_process();
    let ended = match runtime() {
        Ok(runtime) => {
            let ended = runtime.block_on(run(cli));
            // What a name server or a file does not answer is waited for no longer than the command was.
            runtime.shutdown_background();
            ended
        }
        Err(error) => Err(error),
    };
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
fn runtime() -> anyhow::Result<Runtime> {
    let threads = match std::env::var_os(THREADS) {
        None => available_parallelism().map_or(1, NonZero::get).div_ceil(2),
        Some(asked) => {
            let asked = asked.to_str().and_then(|text| text.parse().ok());
            // The runtime would panic over it.
            asked.filter(|threads| (1..=MOST_THREADS).contains(threads)).ok_or_else(|| {
                ConfigError::Invalid(vec![format!("{THREADS}: must be a whole number, 1 to {MOST_THREADS}")])
            })?
        }
    };
    Ok(Builder::new_multi_thread().worker_threads(threads).enable_all().build()?)
}
