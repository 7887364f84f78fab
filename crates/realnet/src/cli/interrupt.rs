//! Ctrl-C (and SIGTERM): finish the frame, close the files, leave.

use std::sync::{
    Mutex,
    atomic::{AtomicBool, Ordering},
};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);
static STOPPER: Mutex<Option<realnet::source::Stopper>> = Mutex::new(None);

/// From now on the first Ctrl-C only asks to end; the second ends at once.
pub(crate) fn install() {
    let result = ctrlc::set_handler(|| {
        if INTERRUPTED.swap(true, Ordering::SeqCst) {
            std::process::exit(130);
        }
        if let Ok(mut stopper) = STOPPER.lock()
            && let Some(stopper) = stopper.take()
        {
            stopper.stop();
        }
    });
    // Without a handler Ctrl-C ends the program at once, as it always did.
    if let Err(error) = result {
        super::failure::say(format!("Ctrl-C will not be caught: {error}"));
    }
}

/// True once Ctrl-C was pressed.
pub(crate) fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::SeqCst)
}

/// A source that waits for its next frame is to be woken by Ctrl-C.
pub(crate) fn stop_on_interrupt(source: &realnet::source::Source) {
    if let Ok(mut stopper) = STOPPER.lock() {
        *stopper = Some(source.stopper());
    }
    // It may have come before there was anything to stop.
    if interrupted() {
        source.stopper().stop();
    }
}
