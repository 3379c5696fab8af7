//! Ctrl-C: the first asks the running stage to stop, the second ends the program at once.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::failure::tell;

static REQUESTED: AtomicBool = AtomicBool::new(false);
/// Whether the running stage asks [`requested`] often enough.
static LISTENING: AtomicBool = AtomicBool::new(false);

/// Exit code after an interrupt, as shells have it: 128 + SIGINT.
pub(crate) const EXIT_CODE: u8 = 130;

/// Takes over SIGINT, SIGTERM and SIGHUP (Ctrl-C and Ctrl-Break on Windows).
pub(crate) fn install() {
    let handler = || {
        let again = REQUESTED.swap(true, Ordering::Relaxed);
        if again || !LISTENING.load(Ordering::Relaxed) {
            tell("\nerror: interrupted");
            std::process::exit(i32::from(EXIT_CODE));
        }
    };
    // Without the handler the system's own one ends the program: outputs are renamed into place, so none is torn.
    if let Err(error) = ctrlc::set_handler(handler) {
        tell(format_args!("warning: Ctrl-C will end the program at once: {error}"));
    }
}

/// Says whether the stage that begins now asks [`requested`]; one that does not is ended at once.
pub(crate) fn listen(listening: bool) {
    LISTENING.store(listening, Ordering::Relaxed);
}

/// Whether somebody asked to stop.
pub(crate) fn requested() -> bool {
    REQUESTED.load(Ordering::Relaxed)
}
