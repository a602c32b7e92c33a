//! One socket: a message at a time, answered before the next is read.

use super::answer::{
    self, OverrideMessage, PlainMessage, ResumedMessage, StandingPart, StartedMessage, StoredMessage,
};
use super::binary::{self, Frame};
use super::cycle::{self, Checked, Ordered, StreamedCycle};
use super::finish::{self, connection_gone, show};
use super::message::{
    self, EndMessage, Incoming, MonitorMessage, ResumeMessage, SamplesMessage, StartMessage, VibrationMessage,
};
use super::overload::{self, Overload};
use super::slots::{Held, Ownership, Unnamed};
use crate::auth::Caller;
use crate::clock::Moment;
use crate::http::dto::mirror::{To, violation};
use crate::http::dto::time;
use crate::http::problem::Problem;
use crate::live::{Event, Kind, MachineState};
use crate::state::AppState;
use axum::extract::ws::{CloseFrame, Message, Utf8Bytes, WebSocket};
use bytes::{Bytes, BytesMut};
use feedwright_core::closed_loop::monitor::{MOST_BLOCK, Monitor};
use feedwright_core::closed_loop::{Answer, Batch, LoopReason, LoopReasons, SampleAdvice};
use feedwright_core::ids::CycleId;
use feedwright_core::invalid::Violation;
use feedwright_core::units::Timestamp;
use feedwright_core::vibratory::peak_to_peak::{ControllerInput, ControllerSettings, VibrationSample};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior, interval, timeout};
use tokio_util::sync::CancellationToken;

/// Unreadable messages in a row after which a connection is closed: it speaks something else.
const MOST_UNREADABLE: u32 = 100;
/// An answer to one sample as text is about 500 bytes: no growing on the way there.
const TEXT_BYTES: usize = 640;
/// How late samples may be counted.
const COUNTED_EVERY: Duration = Duration::from_millis(100);
/// How long the other end has to answer a close.
const CLOSE_PATIENCE: Duration = Duration::from_secs(1);

/// Why a stream is closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Closing {
    /// The server stops.
    GoingAway,
    /// A message or frame is too large.
    TooLarge,
    /// The frames are no WebSocket's.
    Protocol,
    /// Another stream of the machine was opened.
    TakenOver,
    /// Nothing was heard for too long.
    Idle,
    /// Too many messages in a row could not be read.
    Unreadable,
    /// The token that opened it was revoked.
    Revoked,
}

impl Closing {
    /// Code and text of the close frame.
    pub const fn frame(self) -> (u16, &'static str) {
        match self {
            Self::GoingAway => (1001, "the server stops"),
            Self::TooLarge => (1009, "the message is too large"),
            Self::Protocol => (1002, "no WebSocket frame"),
            Self::TakenOver => (4001, "another stream of this machine was opened"),
            Self::Idle => (4008, "nothing was heard for too long"),
            Self::Unreadable => (4400, "too many messages could not be read"),
            Self::Revoked => (4401, "the token was revoked"),
        }
    }
}

/// What a connection is told beside its messages.
enum Told {
    /// It is time for a ping.
    Beat,
    /// The stream is to be closed.
    Close(Closing),
}

/// Waits for everything that a connection waits for beside its messages, in a task of its own: a message does not pay
/// for what happens once in a while.
async fn watch(state: AppState, caller: Caller, leave: CancellationToken, tell: mpsc::Sender<Told>) {
    let every = state.config.stream.heartbeat();
    let beating = async {
        let mut beats = interval(every);
        beats.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            beats.tick().await;
            if tell.send(Told::Beat).await.is_err() {
                return;
            }
        }
    };
    let closing = tokio::select! {
        () = leave.cancelled() => Closing::TakenOver,
        () = state.lifecycle.stopping() => Closing::GoingAway,
        () = caller.over(&state, every) => Closing::Revoked,
        // The connection is gone.
        () = beating => return,
    };
    let _ = tell.send(Told::Close(closing)).await;
}

/// What goes on the wire.
enum Out {
    Text(String),
    /// Text that was written where answers to samples are.
    Written(Bytes),
    Binary(Bytes),
}

/// Serves one stream until it ends.
pub async fn serve(state: AppState, caller: Caller, ownership: Ownership, mut socket: WebSocket) {
    let machine = ownership.slot.machine.clone();
    let _served = Served::begin(&state, &ownership);
    tracing::info!(%machine, "a stream is open");
    if let Some(held) = ownership.held() {
        let runs = held.cycle.is_some();
        show(&state, &machine, &held, if runs { MachineState::Interrupted } else { MachineState::Connected });
    }
    let mut connection = Connection::new(state.clone(), ownership.clone());
    let closing = connection.run(caller, &mut socket).await;
    connection.count(0, None);
    if let Some(closing) = closing {
        close(&mut socket, closing).await;
    }
    drop(socket);
    tracing::info!(%machine, ?closing, "a stream is closed");
    connection_gone(&state, &ownership).await;
}

/// Counts a stream as open. One that ends by a panic is gone as any other: its machine's next one would wait for ever else.
struct Served {
    state: AppState,
    ownership: Ownership,
}

impl Served {
    fn begin(state: &AppState, ownership: &Ownership) -> Self {
        state.metrics.streams_open().inc();
        Self { state: state.clone(), ownership: ownership.clone() }
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.state.metrics.streams_open().dec();
        if std::thread::panicking() {
            let (state, ownership) = (self.state.clone(), self.ownership.clone());
            self.state.lifecycle.spawn(async move { connection_gone(&state, &ownership).await });
        }
    }
}

async fn close(socket: &mut WebSocket, closing: Closing) {
    let (code, reason) = closing.frame();
    let frame = CloseFrame { code, reason: reason.into() };
    let shaken = async {
        if socket.send(Message::Close(Some(frame))).await.is_ok() {
            // Until the other end has answered, or the connection is gone.
            while let Some(Ok(_)) = socket.recv().await {}
        }
    };
    let _ = timeout(CLOSE_PATIENCE, shaken).await;
}

struct Connection {
    state: AppState,
    ownership: Ownership,
    /// Number of the last message sent.
    sent: u32,
    unreadable: u32,
    monitor: Option<Monitor>,
    /// The samples of a binary message, and what each is answered; kept from one message to the next.
    ordered: Ordered,
    each: Vec<SampleAdvice>,
    /// Where answers to samples are written, one after the other.
    out: BytesMut,
    /// Samples that the service's counter does not have yet, and when it was told last.
    counted: usize,
    counted_at: Option<Moment>,
}

impl Connection {
    fn new(state: AppState, ownership: Ownership) -> Self {
        Self {
            state,
            ownership,
            sent: 0,
            unreadable: 0,
            monitor: None,
            ordered: Ordered::default(),
            each: Vec::new(),
            out: BytesMut::new(),
            counted: 0,
            counted_at: None,
        }
    }

    /// Answers messages until the stream ends; why it is to be closed, where the other end did not close it.
    async fn run(&mut self, caller: Caller, socket: &mut WebSocket) -> Option<Closing> {
        let idle = self.state.config.stream.idle();
        let (tell, mut told) = mpsc::channel(1);
        // Ends with this function.
        let mut watching = JoinSet::new();
        watching.spawn(watch(self.state.clone(), caller, self.ownership.leave.clone(), tell));
        let mut heard = Instant::now();
        loop {
            tokio::select! {
                received = socket.recv() => {
                    heard = Instant::now();
                    let out = match received {
                        None | Some(Ok(Message::Close(_))) => return None,
                        Some(Err(error)) => return Some(broken(&error)),
                        Some(Ok(Message::Ping(_) | Message::Pong(_))) => continue,
                        Some(Ok(Message::Text(text))) => self.text(text.as_str()).await,
                        Some(Ok(Message::Binary(bytes))) => self.binary(&bytes),
                    };
                    let Some(out) = out else { return Some(Closing::TakenOver) };
                    let message = match out {
                        Out::Text(text) => Message::Text(text.into()),
                        Out::Written(bytes) => Message::Text(Utf8Bytes::try_from(bytes).unwrap_or_default()),
                        Out::Binary(bytes) => Message::Binary(bytes),
                    };
                    if socket.send(message).await.is_err() {
                        return None;
                    }
                    if self.unreadable >= MOST_UNREADABLE {
                        return Some(Closing::Unreadable);
                    }
                }
                event = told.recv() => match event {
                    Some(Told::Close(closing)) => return Some(closing),
                    // Nobody is left who would see its end.
                    None => return Some(Closing::GoingAway),
                    Some(Told::Beat) => {
                        if heard.elapsed() >= idle {
                            return Some(Closing::Idle);
                        }
                        if socket.send(Message::Ping(Bytes::new())).await.is_err() {
                            return None;
                        }
                    }
                },
            }
        }
    }

    /// Counts samples that were answered. The counter is every stream's: it is told once in a while, and at the end.
    fn count(&mut self, samples: usize, now: Option<Moment>) {
        self.counted += samples;
        let told = now.zip(self.counted_at).is_some_and(|(now, at)| now.since(at) < COUNTED_EVERY);
        if !told {
            self.state.metrics.stream_samples(std::mem::take(&mut self.counted));
            self.counted_at = now;
        }
    }

    const fn number(&mut self) -> u32 {
        self.sent = self.sent.wrapping_add(1);
        self.sent
    }

    /// Answers a text message; `None` where another connection owns the machine's place.
    async fn text(&mut self, text: &str) -> Option<Out> {
        let now = self.state.clock.now();
        match message::read(text) {
            Ok(incoming) => {
                self.unreadable = 0;
                match incoming {
                    Incoming::Samples(message) => self.samples(now, &message),
                    Incoming::Start(message) => self.start(now, *message).await,
                    Incoming::End(message) => self.end(*message).await,
                    Incoming::Resume(message) => self.resume(&message),
                    Incoming::Heartbeat(message) => self.heartbeat(now, message.n),
                    Incoming::Monitor(message) => Some(self.begin_monitor(now, *message)),
                    Incoming::Vibration(message) => Some(self.vibration(message)),
                }
            }
            Err(unreadable) => {
                if unreadable.begins {
                    self.ownership.held()?.leave(None);
                }
                self.fault(unreadable.n, &unreadable.violation)
            }
        }
    }

    /// A message that cannot be used: neutral where a cycle runs, and said.
    fn fault(&mut self, re: Option<u32>, violation: &Violation) -> Option<Out> {
        self.unreadable += 1;
        self.state.metrics.stream_refusal(violation.code);
        let n = self.number();
        let mut held = self.ownership.held()?;
        held.refuse();
        let moment = self.state.clock.moment();
        let standing = held.cycle.as_mut().map(|cycle| {
            let answer = cycle.running.fault(cycle.time_at(moment), LoopReason::Malformed);
            answer::standing(cycle, &answer)
        });
        Some(Out::Text(answer::text(&answer::error(n, re, violation, standing))))
    }

    /// A refusal that says nothing about the cycle that runs.
    fn refuse(&mut self, re: u32, problem: &Problem) -> Option<Out> {
        self.state.metrics.stream_refusal(problem.code);
        let n = self.number();
        let mut held = self.ownership.held()?;
        held.refuse();
        let standing = standing(&self.state, &mut held);
        Some(Out::Text(answer::text(&answer::problem(n, Some(re), problem, standing))))
    }

    fn samples(&mut self, now: Timestamp, message: &SamplesMessage) -> Option<Out> {
        let re = message.n;
        let most = self.state.config.stream.samples_per_message;
        let mut held = self.ownership.held()?;
        let fits = held
            .meant()
            .map_or_else(|| Err(no_cycle()), |cycle| cycle.order(message, most, &mut self.ordered));
        if let Err(violation) = fits {
            drop(held);
            return self.fault(Some(re), &violation);
        }
        let moment = self.state.clock.moment();
        let ordered = ((now, moment), &self.ordered);
        let answered = judge(&self.state, &self.ownership, &mut held, ordered, &mut self.each)?;
        self.sent = self.sent.wrapping_add(1);
        let cycle = held.cycle.as_ref()?;
        let standing = answer::standing(cycle, &answered);
        let each = (cycle.running.mode(), &self.each[..]);
        self.out.reserve(TEXT_BYTES);
        answer::overrides(&mut self.out, (self.sent, re), &standing, each);
        drop(held);
        self.count(self.ordered.count, Some(moment));
        Some(Out::Written(self.out.split().freeze()))
    }

    fn binary(&mut self, bytes: &[u8]) -> Option<Out> {
        let now = self.state.clock.now();
        let most = self.state.config.stream.samples_per_message;
        let mut held = self.ownership.held()?;
        let decimals = held.cycle.as_ref().map_or(&[][..], |cycle| &cycle.decimals);
        let frame = match binary::read(bytes, decimals, &mut self.ordered) {
            Ok(frame) => frame,
            Err(bad) => {
                drop(held);
                let violation = Violation::new("", "malformed_frame", bad.why);
                return self.fault(bad.n, &violation);
            }
        };
        self.unreadable = 0;
        match frame {
            Frame::Samples { n: re } => {
                let fits = held.meant().map_or_else(
                    || Err(no_cycle()),
                    |cycle| cycle.fits(self.ordered.count, self.ordered.times_ms.len(), most),
                );
                if let Err(violation) = fits {
                    drop(held);
                    return self.fault(Some(re), &violation);
                }
                let moment = self.state.clock.moment();
                let ordered = ((now, moment), &self.ordered);
                let answered = judge(&self.state, &self.ownership, &mut held, ordered, &mut self.each)?;
                let mode = held.cycle.as_ref()?.running.mode();
                drop(held);
                let n = self.number();
                self.out.reserve(binary::length(self.each.len()));
                binary::overrides(&mut self.out, binary::Told { n, re, mode }, &answered, &self.each);
                self.count(self.ordered.count, Some(moment));
                Some(Out::Binary(self.out.split().freeze()))
            }
            Frame::Vibration { n: re, first, block } => {
                drop(held);
                let Some(monitor) = &mut self.monitor else {
                    return self.fault(Some(re), &no_monitor());
                };
                let advice = monitor.take(first, &block);
                let n = self.number();
                binary::gain(&mut self.out, n, re, &advice);
                Some(Out::Binary(self.out.split().freeze()))
            }
        }
    }

    async fn start(&mut self, now: Timestamp, message: StartMessage) -> Option<Out> {
        let (re, id) = (message.n, message.cycle_id.clone());
        let came = (now, self.state.clock.moment());
        let begun = match cycle::check(message, came, &self.state.config.stream) {
            Ok(checked) => self.begin(checked).await,
            Err(violations) => Err(Problem::invalid(violations)),
        };
        if let Err(problem) = begun {
            self.ownership.held()?.leave(Some(&id));
            return self.refuse(re, &problem);
        }
        let n = self.number();
        let held = self.ownership.held()?;
        let cycle = held.cycle.as_ref()?;
        let mut standing = answer::standing(cycle, &cycle.running.standing(came.0));
        standing.reasons.0 = standing.reasons.0.and(cycle.running.standing_reasons());
        if cycle.meta.resend {
            standing.reasons.0.add(LoopReason::Restarted);
        }
        let text = answer::text(&StartedMessage {
            kind: "started",
            n,
            re,
            standing,
            channels: cycle.running.record().channels().iter().map(|channel| channel.as_str()).collect(),
            decimals: cycle.decimals.clone(),
            override_range_percent: cycle.running.bounds_percent(),
        });
        show(&self.state, &self.ownership.slot.machine, &held, MachineState::Running);
        drop(held);
        Some(Out::Text(text))
    }

    /// Puts a new cycle into the machine's place; one that was left there without its end is stored as incomplete.
    async fn begin(&self, checked: Checked) -> Result<(), Problem> {
        let id = checked.id().clone();
        let machine = &self.ownership.slot.machine;
        let (running, overload) = match self.ownership.held().as_ref().and_then(|held| held.cycle.as_ref()) {
            Some(cycle) => (Some(cycle.id.clone()), cycle.overload.clone()),
            None => (None, None),
        };
        if running.as_ref() == Some(&id) && !checked.resends() {
            let detail = "this cycle runs already: resume it, or start it with resend to send it from its first sample";
            return Err(Problem::new(http::StatusCode::CONFLICT, "cycle_running", detail));
        }
        if !self.state.streams.has_room() {
            return Err(Problem::unavailable(
                "too_many_samples_held",
                "running cycles hold too many samples",
                5,
            ));
        }
        // That of a cycle whose connection broke may be on its way yet.
        for overload in overload.into_iter().chain(self.state.streams.unraised(machine)) {
            overload.raise(&self.state, machine).await?;
        }
        let begun = cycle::begin(&self.state, machine, checked).await?;
        let begun = begun.ok_or_else(|| {
            let detail = format!("there is no machine `{machine}`");
            Problem::new(http::StatusCode::NOT_FOUND, "unknown_machine", detail)
        })?;
        let held_up = begun.overload.is_some();
        let left = match self.ownership.held() {
            Some(mut held) => {
                held.unnamed = Unnamed::Running;
                self.state.streams.replace(&mut held, begun)
            }
            None => None,
        };
        if held_up {
            // It may have been acknowledged before there was this cycle to free.
            overload::settle(&self.state, machine).await;
        }
        if let Some((left, charged)) = left.filter(|(left, _)| left.id != id) {
            let (state, machine) = (self.state.clone(), machine.clone());
            // Its samples are held until they are stored: a machine that begins one cycle after the other piles up no more than others.
            self.state.lifecycle.spawn(async move {
                finish::store_incomplete(&state, &machine, left).await;
                drop(charged);
            });
        }
        Ok(())
    }

    fn resume(&mut self, message: &ResumeMessage) -> Option<Out> {
        if let Err(violation) = CycleId::parse("cycle_id", &message.cycle_id) {
            return self.fault(Some(message.n), &violation);
        }
        let n = self.number();
        let mut held = self.ownership.held()?;
        let running = held.cycle.as_ref().filter(|cycle| cycle.id.as_str() == message.cycle_id);
        if let Some(resume_from) = running.map(|cycle| cycle.running.record().first_missing()) {
            let text = answer::text(&ResumedMessage {
                kind: "resumed",
                n,
                re: message.n,
                cycle_id: &message.cycle_id,
                resume_from: Some(resume_from),
                restart_from: None,
                standing: standing(&self.state, &mut held),
            });
            held.unnamed = Unnamed::Running;
            show(&self.state, &self.ownership.slot.machine, &held, MachineState::Running);
            drop(held);
            return Some(Out::Text(text));
        }
        if let Some((id, status, answer)) = &held.ended
            && id.as_str() == message.cycle_id
        {
            let (status, answer) = (*status, answer.clone());
            if held.cycle.is_none() {
                held.unnamed = Unnamed::Ended;
            }
            return Some(Out::Text(answer::text(&StoredMessage {
                kind: "stored",
                n,
                re: message.n,
                status,
                answer,
            })));
        }
        held.leave(None);
        Some(Out::Text(answer::text(&ResumedMessage {
            kind: "resumed",
            n,
            re: message.n,
            cycle_id: &message.cycle_id,
            resume_from: None,
            restart_from: Some(0),
            standing: None,
        })))
    }

    fn heartbeat(&mut self, now: Timestamp, re: u32) -> Option<Out> {
        let n = self.number();
        let mut held = self.ownership.held()?;
        let runs = held.meant().is_some();
        Some(Out::Text(match standing(&self.state, &mut held).filter(|_| runs) {
            Some(standing) => {
                answer::text(&OverrideMessage { kind: "heartbeat", n, re: Some(re), standing, each: None })
            }
            None => answer::text(&PlainMessage { kind: "heartbeat", n, re, at: time::show(now) }),
        }))
    }

    async fn end(&mut self, message: EndMessage) -> Option<Out> {
        let re = message.n;
        // Whoever reads the answer finds every sample counted.
        self.count(0, None);
        let cycle = match self.take_ended(&message)? {
            Ending::Cycle(cycle) => cycle,
            Ending::Known(status, answer) => {
                let n = self.number();
                return Some(Out::Text(answer::text(&StoredMessage {
                    kind: "stored",
                    n,
                    re,
                    status,
                    answer,
                })));
            }
            Ending::Refused(problem) => return self.refuse(re, &problem),
        };
        let id = cycle.id.clone();
        let (state, machine) = (self.state.clone(), self.ownership.slot.machine.clone());
        // The machine may hang up; what was taken in goes on to its commit all the same.
        let storing = self.state.lifecycle.spawn(async move {
            finish::store(&state, &machine, *cycle, message.outcome, message.reported).await
        });
        let stored = storing.await;
        let n = self.number();
        let text = match stored {
            Ok(Ok(stored)) => {
                if let Some(mut held) = self.ownership.held() {
                    held.ended = Some((id, stored.status, stored.answer.clone()));
                    held.unnamed = Unnamed::Ended;
                    self.state.streams.charge(&mut held);
                    self.show_end(&held);
                }
                answer::text(&StoredMessage {
                    kind: "stored",
                    n,
                    re,
                    status: stored.status,
                    answer: stored.answer,
                })
            }
            Ok(Err(not_stored)) => {
                if let Some(mut held) = self.ownership.held() {
                    if held.cycle.is_none() {
                        held.cycle = not_stored.cycle;
                    }
                    // What is in quarantine holds nothing here any more.
                    self.state.streams.charge(&mut held);
                    self.show_end(&held);
                }
                answer::text(&answer::problem(n, Some(re), &not_stored.problem, None))
            }
            Err(panicked) => {
                if let Some(held) = self.ownership.held() {
                    self.show_end(&held);
                }
                let problem = Problem::internal(panicked.to_string());
                answer::text(&answer::problem(n, Some(re), &problem, None))
            }
        };
        Some(Out::Text(text))
    }

    /// Shows that the cycle has ended, to who watches the machine.
    fn show_end(&self, held: &Held) {
        show(&self.state, &self.ownership.slot.machine, held, MachineState::Connected);
    }

    /// Takes the cycle that ends out of its place, once every sample of it is there.
    fn take_ended(&self, message: &EndMessage) -> Option<Ending> {
        let mut held = self.ownership.held()?;
        let asked = message.cycle_id.as_deref();
        let meant = match asked {
            None => held.meant(),
            Some(id) => held.cycle.as_ref().filter(|cycle| id == cycle.id.as_str()),
        };
        let Some(cycle) = meant else {
            return Some(match &held.ended {
                Some((id, status, answer))
                    if asked.map_or(held.unnamed == Unnamed::Ended, |asked| asked == id.as_str()) =>
                {
                    Ending::Known(*status, answer.clone())
                }
                _ => Ending::Refused(no_cycle().into()),
            });
        };
        let record = cycle.running.record();
        if let Some(samples) = message.samples {
            let from = record.first_missing();
            if from < samples && !cycle.running.was_cut_short() {
                let detail = format!("sample {from} is missing: send from there again, then end");
                let problem = Problem::new(http::StatusCode::CONFLICT, "samples_missing", detail);
                return Some(Ending::Refused(problem));
            }
            if record.next() > samples {
                let detail = format!("{} samples came, {samples} are told", record.next());
                let problem = Problem::new(http::StatusCode::CONFLICT, "samples_contradictory", detail);
                return Some(Ending::Refused(problem));
            }
        }
        held.cycle.take().map(Box::new).map(Ending::Cycle)
    }

    fn begin_monitor(&mut self, now: Timestamp, message: MonitorMessage) -> Out {
        let n = self.number();
        let input: ControllerInput = message.settings.map_or(ControllerInput::IVANOV_2024, To::to);
        match ControllerSettings::new(input) {
            Ok(settings) => {
                self.monitor = Some(Monitor::new(settings));
                Out::Text(answer::text(&PlainMessage {
                    kind: "monitoring",
                    n,
                    re: message.n,
                    at: time::show(now),
                }))
            }
            Err(error) => {
                let violation = violation("settings", error);
                Out::Text(answer::text(&answer::error(n, Some(message.n), &violation, None)))
            }
        }
    }

    fn vibration(&mut self, message: VibrationMessage) -> Out {
        let n = self.number();
        let (re, count) = (message.n, message.velocity_mm_s.len());
        let refused =
            |violation: &Violation| Out::Text(answer::text(&answer::error(n, Some(re), violation, None)));
        if count != message.acceleration_mm_s2.len() {
            let why =
                format!("has {} samples where velocity_mm_s has {count}", message.acceleration_mm_s2.len());
            return refused(&Violation::new("acceleration_mm_s2", "length_mismatch", why));
        }
        if count > MOST_BLOCK {
            return refused(&Violation::new(
                "velocity_mm_s",
                "too_many_samples",
                format!("at most {MOST_BLOCK}"),
            ));
        }
        let Some(monitor) = &mut self.monitor else { return refused(&no_monitor()) };
        let samples = message.velocity_mm_s.into_iter().zip(message.acceleration_mm_s2);
        let block: Vec<VibrationSample> = samples
            .map(|(velocity_mm_s, acceleration_mm_s2)| VibrationSample { velocity_mm_s, acceleration_mm_s2 })
            .collect();
        let advice = monitor.take(message.first, &block);
        Out::Text(answer::text(&answer::gain(n, re, &advice)))
    }
}

/// What becomes of the wish to end a cycle.
enum Ending {
    Cycle(Box<StreamedCycle>),
    Known(u16, serde_json::Value),
    Refused(Problem),
}

fn no_cycle() -> Violation {
    Violation::new("type", "no_cycle", "no cycle runs: start or resume one first")
}

fn no_monitor() -> Violation {
    Violation::new("type", "no_monitor", "nothing is monitored: send monitor first")
}

/// Tells the running cycle whether its machine is known to be served by this server alone.
fn note_lease(held: &mut Held, now: Moment) {
    let passing = match held.is_leased(now) {
        true => LoopReasons::NONE,
        false => LoopReasons::of(LoopReason::LeaseUnknown),
    };
    if let Some(cycle) = &mut held.cycle {
        cycle.running.set_passing(passing);
    }
}

/// What is in force in the running cycle now.
fn standing<'h>(state: &AppState, held: &'h mut Held) -> Option<StandingPart<'h>> {
    let moment = state.clock.moment();
    note_lease(held, moment);
    let cycle = held.cycle.as_ref()?;
    Some(answer::standing(cycle, &cycle.running.standing(cycle.time_at(moment))))
}

/// Passes samples to the running cycle, and tells of them whoever has to know.
fn judge(
    state: &AppState,
    ownership: &Ownership,
    held: &mut Held,
    ((now, moment), ordered): ((Timestamp, Moment), &Ordered),
    each: &mut Vec<SampleAdvice>,
) -> Option<Answer> {
    note_lease(held, moment);
    let cycle = held.cycle.as_mut()?;
    let Ordered { first, count, values, times_ms } = ordered;
    let batch = Batch { first: *first, count: *count, values, times_ms };
    each.clear();
    let answered = cycle.running.take(cycle.time_at(moment), &batch, each);
    let machine = &ownership.slot.machine;
    if cycle.running.is_overloaded()
        && !cycle.overload.as_ref().is_some_and(|overload| overload.is_the_cycles())
    {
        let overload = Arc::new(Overload::seen(&cycle.id, &cycle.tool, now));
        cycle.overload = Some(overload.clone());
        overload.raise_beside(state, machine);
    }
    let interval = Duration::from_millis(state.live.config().sample_interval_ms);
    if cycle.shown_at.is_none_or(|shown| moment.since(shown) >= interval) {
        // Once an interval, watched or not: whether somebody watches is behind a lock that every stream shares.
        cycle.shown_at = Some(moment);
        if let Some(last) = each.last().filter(|_| state.live.samples_are_watched()) {
            state.live.publish(Event::new(Kind::Sample, Some(machine), cycle.shown(machine, ordered, last)));
        }
    }
    state.streams.charge(held);
    Some(answered)
}

/// Why reading failed. The protocol library's own error type is not part of the web framework's interface.
fn broken(error: &axum::Error) -> Closing {
    let text = error.to_string();
    if text.contains("too long") || text.contains("Space limit") {
        Closing::TooLarge
    } else {
        Closing::Protocol
    }
}
