//! Ctrl-C: the first asks the running stage to stop, and ends the program a little later if that has not; the second ends it at once.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::failure::tell;

static REQUESTED: AtomicBool = AtomicBool::new(false);
/// Whether the running stage asks [`requested`] often enough.
static LISTENING: AtomicBool = AtomicBool::new(false);

/// Whether outputs are being written, beside their places: a program that is ended then leaves something there.
static WRITING: AtomicBool = AtomicBool::new(false);

/// How long the running stage has to stop.
const PATIENCE: Duration = Duration::from_millis(700);

/// Exit code after an interrupt, as shells have it: 128 + SIGINT.
pub(crate) const EXIT_CODE: u8 = 130;

/// Takes over SIGINT, SIGTERM and SIGHUP (Ctrl-C and Ctrl-Break on Windows).
pub(crate) fn install() {
    let handler = || {
        let again = REQUESTED.swap(true, Ordering::Relaxed);
        if again || !LISTENING.load(Ordering::Relaxed) {
            end();
        }
        // Some stages have parts that ask seldom, such as the mesh of a heap of large triangles.
        std::thread::spawn(|| {
            std::thread::sleep(PATIENCE);
            if !WRITING.load(Ordering::Relaxed) {
                end();
            }
        });
    };
    // Without the handler the system's own one ends the program: outputs are renamed into place, so none is torn.
    if let Err(error) = ctrlc::set_handler(handler) {
        tell(format_args!("warning: Ctrl-C will end the program at once: {error}"));
    }
}

fn end() -> ! {
    tell("\nerror: interrupted");
    std::process::exit(i32::from(EXIT_CODE));
}

/// Says that outputs are written from now on, until the next stage.
pub(crate) fn write() {
    WRITING.store(true, Ordering::Relaxed);
}

/// Says whether the stage that begins now asks [`requested`]; one that does not is ended at once.
pub(crate) fn listen(listening: bool) {
    LISTENING.store(listening, Ordering::Relaxed);
    WRITING.store(false, Ordering::Relaxed);
}

/// Whether somebody asked to stop.
pub(crate) fn requested() -> bool {
    REQUESTED.load(Ordering::Relaxed)
}
