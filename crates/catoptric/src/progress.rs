//! Progress of the stages: bars on a terminal, a plain line now and then elsewhere; and how long each stage took.

use std::io::IsTerminal;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

use catoptric_scene::Progress;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use crate::failure::tell;
use crate::interrupt;

/// A plain line comes after a tenth of the stage, but not more often than this ...
const SHORTEST_PAUSE: Duration = Duration::from_secs(1);
/// ... and at the latest after this.
const LONGEST_PAUSE: Duration = Duration::from_secs(5);

/// How long a stage took, all its runs together.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct StageTime {
    /// Name of the stage.
    pub(crate) name: String,
    /// Wall-clock seconds.
    pub(crate) seconds: f64,
    /// How often it ran: once per image, or once.
    pub(crate) runs: u64,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Voice {
    Silent,
    Lines,
    Bars,
}

/// The one that stages report to.
pub(crate) struct Reporter {
    started: Instant,
    shared: Arc<Shared>,
}

/// What the reporter shares with the thread that speaks where stages are silent for long.
struct Shared {
    voice: Voice,
    /// Units done in the current stage.
    done: AtomicU64,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    context: String,
    running: Option<Running>,
    times: Vec<StageTime>,
}

struct Running {
    name: String,
    total: u64,
    started: Instant,
    bar: Option<ProgressBar>,
    last_line: Instant,
    next_tenth: u64,
}

impl Reporter {
    /// Bars if standard error is a terminal.
    pub(crate) fn new(quiet: bool) -> Self {
        let voice = match (quiet, std::io::stderr().is_terminal()) {
            (true, _) => Voice::Silent,
            (false, true) => Voice::Bars,
            (false, false) => Voice::Lines,
        };
        let shared = Arc::new(Shared { voice, done: AtomicU64::new(0), state: Mutex::default() });
        if voice == Voice::Lines {
            let watched = Arc::downgrade(&shared);
            std::thread::spawn(move || watch(&watched));
        }
        Self { started: Instant::now(), shared }
    }

    /// What the next stages belong to, shown with their names: a camera, a frame.
    pub(crate) fn set_context(&self, context: String) {
        self.shared.state().context = context;
    }

    /// Begins a stage that does not ask whether it shall stop, and leaves nothing behind if it is ended midway.
    pub(crate) fn begin_deaf(&self, stage: &str) {
        self.begin(stage, 0);
        interrupt::listen(false);
    }

    /// Begins to write outputs, which is not ended midway.
    pub(crate) fn begin_write(&self) {
        self.begin("write", 0);
        interrupt::write();
    }

    /// Ends the current stage.
    pub(crate) fn end(&self) {
        self.shared.state().end(self.shared.voice);
    }

    /// Says something to the person, between the bars.
    pub(crate) fn say(&self, text: &str) {
        if self.shared.voice == Voice::Silent {
            return;
        }
        let state = self.shared.state();
        match state.running.as_ref().and_then(|running| running.bar.as_ref()) {
            Some(bar) => bar.suspend(|| tell(text)),
            None => tell(text),
        }
    }

    /// The stages so far, in the order of their first run.
    pub(crate) fn times(&self) -> Vec<StageTime> {
        self.end();
        self.shared.state().times.clone()
    }

    /// Seconds since the start of the program.
    pub(crate) fn seconds(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Speaks for stages that do not, for as long as the reporter lives.
fn watch(shared: &Weak<Shared>) {
    loop {
        std::thread::sleep(SHORTEST_PAUSE);
        let Some(shared) = shared.upgrade() else { return };
        shared.state().line(shared.done.load(Ordering::Relaxed));
    }
}

impl State {
    fn end(&mut self, voice: Voice) {
        let Some(running) = self.running.take() else { return };
        let seconds = running.started.elapsed().as_secs_f64();
        if let Some(bar) = running.bar {
            bar.finish_and_clear();
        }
        if voice == Voice::Lines && seconds >= SHORTEST_PAUSE.as_secs_f64() {
            tell(format_args!("{}: done in {seconds:.1} s", running.name));
        }
        match self.times.iter_mut().find(|time| time.name == running.name) {
            Some(time) => {
                time.seconds += seconds;
                time.runs += 1;
            }
            None => self.times.push(StageTime { name: running.name, seconds, runs: 1 }),
        }
    }
}

impl State {
    /// A plain line, if it is time for one.
    fn line(&mut self, done: u64) {
        let Some(running) = &mut self.running else { return };
        let pause = running.last_line.elapsed();
        let percent = (done.min(running.total) * 100).checked_div(running.total);
        let tenth = percent.unwrap_or(0) / 10;
        if (tenth >= running.next_tenth && pause >= SHORTEST_PAUSE) || pause >= LONGEST_PAUSE {
            running.last_line = Instant::now();
            running.next_tenth = tenth + 1;
            let context =
                if self.context.is_empty() { String::new() } else { format!(" ({})", self.context) };
            let share = percent.map_or(String::new(), |percent| format!("{percent} % after "));
            let seconds = running.started.elapsed().as_secs_f64();
            tell(format_args!("{}{context}: {share}{seconds:.0} s", running.name));
        }
    }
}

impl Progress for Reporter {
    fn begin(&self, stage: &str, total: u64) {
        interrupt::listen(true);
        let mut state = self.shared.state();
        state.end(self.shared.voice);
        self.shared.done.store(0, Ordering::Relaxed);
        let now = Instant::now();
        let bar = (self.shared.voice == Voice::Bars).then(|| bar(stage, &state.context, total));
        state.running =
            Some(Running { name: stage.to_owned(), total, started: now, bar, last_line: now, next_tenth: 1 });
    }

    fn advance(&self, units: u64) {
        let done = self.shared.done.fetch_add(units, Ordering::Relaxed) + units;
        // Whoever finds the lock taken goes on working: the next call shows its units too.
        let Ok(mut state) = self.shared.state.try_lock() else { return };
        match (self.shared.voice, state.running.as_ref().and_then(|running| running.bar.as_ref())) {
            (Voice::Bars, Some(bar)) => bar.set_position(done),
            (Voice::Lines, _) => state.line(done),
            _ => {}
        }
    }

    fn is_cancelled(&self) -> bool {
        interrupt::requested()
    }
}

/// A bar with an estimate, or a spinner where the amount of work is not known.
fn bar(stage: &str, context: &str, total: u64) -> ProgressBar {
    let bar = if total > 0 { ProgressBar::new(total) } else { ProgressBar::new_spinner() };
    let template = match total {
        0 => "{prefix:>20} {spinner} {elapsed} {msg}",
        _ => "{prefix:>20} [{bar:40}] {percent:>3} % {elapsed}, {eta} left {msg}",
    };
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.set_prefix(stage.to_owned());
    bar.set_message(context.to_owned());
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_are_timed_once_per_name_in_the_order_of_their_first_run() {
        let reporter = Reporter::new(true);
        for stage in ["solve", "render", "write", "render", "write"] {
            reporter.begin(stage, 10);
            reporter.advance(10);
        }
        let times = reporter.times();
        let names: Vec<_> = times.iter().map(|time| (time.name.as_str(), time.runs)).collect();
        assert_eq!(names, [("solve", 1), ("render", 2), ("write", 2)]);
        assert!(times.iter().all(|time| time.seconds >= 0.0));
    }
}
