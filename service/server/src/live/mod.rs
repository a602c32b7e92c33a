//! What happens now, for people who watch: machines, cycles and alarms, in a sequence that a reader can resume.
//!
//! Everything that is published gets the next number and stands in a bounded history. A reader has a position in it
//! and nothing else: one that is too slow falls out of the history and is told the gap; it costs nobody else anything.
//! Samples of running cycles are shown thinned and have no number: they are gone when they are gone.
//! Servers on one PostgreSQL tell each other ([`replicas`]); each numbers what it shows by itself, so a position of
//! another server, or of this one before its restart, is answered by a gap. What is decided never comes from here.

mod alarms;
mod event;
mod history;
mod machines;
mod reader;
mod replicas;

pub use event::{Data, Event, Kind, MachineState};
pub use reader::{Position, Reader};

use crate::config::LiveConfig;
use crate::lifecycle::begin_anew;
use crate::state::AppState;
use history::{History, Shown};
use machines::Machines;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::futures::Notified;
use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore, broadcast, mpsc, watch};
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// Samples of running cycles that wait for one reader; thinned to a few a second, this is many seconds.
const SAMPLES_KEPT: usize = 256;
/// Events that wait to be told to other servers.
const OUTBOX: usize = 1024;

/// The live view of one server.
pub struct Live {
    config: LiveConfig,
    /// Names this run of the server in positions.
    boot: String,
    history: Mutex<History>,
    newest: watch::Sender<u64>,
    samples: broadcast::Sender<Arc<Shown>>,
    machines: Mutex<Machines>,
    outbox: mpsc::Sender<Event>,
    /// Held by what tells them.
    outgoing: tokio::sync::Mutex<mpsc::Receiver<Event>>,
    /// Whether there are other servers that might want to know.
    told: AtomicBool,
    untold: AtomicU64,
    /// Nothing more will happen here: what waits is told, and no more.
    over: CancellationToken,
    alarms_due: Notify,
    /// Alarms may have changed here since the other servers were told so.
    alarms_untold: AtomicBool,
    readers: Arc<Semaphore>,
    /// Told when a session may be over.
    sessions: Notify,
}

impl Live {
    /// A view that nobody has told anything yet.
    pub fn new(config: &LiveConfig) -> Arc<Self> {
        let (outbox, outgoing) = mpsc::channel(OUTBOX);
        Arc::new(Self {
            config: *config,
            boot: uuid::Uuid::now_v7().simple().to_string(),
            history: Mutex::new(History::new(config.history_events)),
            newest: watch::channel(0).0,
            samples: broadcast::channel(SAMPLES_KEPT).0,
            machines: Mutex::default(),
            outbox,
            outgoing: tokio::sync::Mutex::new(outgoing),
            told: false.into(),
            untold: AtomicU64::new(0),
            over: CancellationToken::new(),
            alarms_due: Notify::new(),
            alarms_untold: AtomicBool::new(false),
            readers: Arc::new(Semaphore::new(config.readers)),
            sessions: Notify::new(),
        })
    }

    /// The bounds it was made with.
    pub const fn config(&self) -> &LiveConfig {
        &self.config
    }

    /// Has every reader that came with a session look whether it goes on.
    pub fn look_at_sessions(&self) {
        self.sessions.notify_waiters();
    }

    /// Ready when a session may be over; told from the moment on in which it is made.
    pub fn sessions_moved(&self) -> Notified<'_> {
        self.sessions.notified()
    }

    /// Shows an event to the readers of this server and of the others.
    pub fn publish(&self, event: Event) {
        if self.told.load(Ordering::Relaxed) && self.outbox.try_send(event.clone()).is_err() {
            self.untold.fetch_add(1, Ordering::Relaxed);
        }
        self.show(event);
    }

    /// Shows an event of this server's to its readers.
    fn show(&self, event: Event) {
        self.show_of(event, &self.boot);
    }

    /// Shows an event that a server told of, `by` this run of it, to the readers of this one.
    fn show_of(&self, event: Event, by: &str) {
        if event.kind == Kind::Sample {
            // Fails where nobody watches.
            let _ = self.samples.send(Arc::new(Shown::new(None, event)));
            return;
        }
        if event.kind == Kind::Machine && !self.locked_machines().take(&event, by) {
            return;
        }
        let mut history = self.history.lock().unwrap_or_else(PoisonError::into_inner);
        let number = history.add(event);
        self.newest.send_replace(number);
    }

    fn locked_machines(&self) -> MutexGuard<'_, Machines> {
        self.machines.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The machines that are connected now, by their last event.
    fn machines(&self) -> Vec<serde_json::Value> {
        self.locked_machines().all()
    }

    /// Whether somebody watches samples: otherwise none need be thinned and shown.
    pub fn samples_are_watched(&self) -> bool {
        self.samples.receiver_count() > 0 || self.told.load(Ordering::Relaxed)
    }

    /// Has the open alarms compared with those that were shown, soon; the other servers do the same when they are told of the next
    /// event. Said after the commit.
    pub fn alarms_may_have_changed(&self) {
        self.alarms_untold.store(true, Ordering::Release);
        self.alarms_due.notify_one();
    }

    /// A place for one more reader; `None` where all are taken.
    fn place(&self) -> Option<OwnedSemaphorePermit> {
        Arc::clone(&self.readers).try_acquire_owned().ok()
    }
}

/// Begins to watch alarms, and to tell and to listen to other servers.
pub fn start(state: &AppState) -> Link {
    let (watched, shown) = (state.clone(), Arc::default());
    state.lifecycle.keep("watching alarms", move || alarms::watch(watched.clone(), Arc::clone(&shown)));
    if state.store.notices().is_none() {
        return Link(None);
    }
    let (hearing, telling) = (state.clone(), state.clone());
    state.lifecycle.keep("hearing other servers", move || replicas::hear_others(hearing.clone()));
    let tell = move || replicas::tell_others(telling.clone());
    Link(Some(tokio::spawn(begin_anew("telling other servers", tell, state.live.over.clone()))))
}

/// The link to other servers. It outlasts everything else that runs: they are told of the last stream's end too.
pub struct Link(Option<JoinHandle<()>>);

impl Link {
    /// Tells what is left to tell, and ends.
    pub async fn end(self, live: &Live) {
        live.over.cancel();
        if let Some(telling) = self.0
            && let Err(error) = telling.await
        {
            tracing::error!(%error, "telling other servers failed");
        }
    }
}
