//! A network on a thread of its own.

use crate::networks::NetworkError;
use realnet_core::{Frame, Stamp};
use std::any::Any;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::Builder;
use std::time::Instant;

/// What a network said of a frame.
#[derive(Debug)]
pub(crate) struct Answer<T> {
    /// Of the frame.
    pub(crate) stamp: Stamp,
    pub(crate) value: Result<T, NetworkError>,
    /// How long it took, milliseconds.
    pub(crate) ms: f64,
}

/// A thread that is given a frame whenever it has none. Frames never wait for it: by the
/// time it is free there are newer ones.
#[derive(Debug)]
pub(crate) struct Worker<T> {
    jobs: Sender<Arc<Frame>>,
    answers: Receiver<Answer<T>>,
    is_busy: bool,
}

impl<T: Send + 'static> Worker<T> {
    /// Starts the thread. A panic in `work` is an answer, and its last one: what is left of
    /// the network behind it may be anything.
    ///
    /// # Errors
    /// The system's, when there can be no thread.
    pub(crate) fn start(
        name: &str,
        mut work: impl FnMut(&Frame) -> Result<T, NetworkError> + Send + 'static,
    ) -> io::Result<Self> {
        let (jobs, asked) = mpsc::channel::<Arc<Frame>>();
        let (told, answers) = mpsc::channel();
        Builder::new().name(name.to_owned()).spawn(move || {
            for frame in asked {
                let start = Instant::now();
                let done = catch_unwind(AssertUnwindSafe(|| work(&frame)));
                let panicked = done.is_err();
                let value = done.unwrap_or_else(|cause| Err(words(&*cause).into()));
                let ms = start.elapsed().as_secs_f64() * 1e3;
                let stamp = frame.stamp();
                // The frame is free before anybody hears of it.
                drop(frame);
                if told.send(Answer { stamp, value, ms }).is_err() || panicked {
                    return;
                }
            }
        })?;
        Ok(Self { jobs, answers, is_busy: false })
    }

    /// Gives it a frame, if it has none. Whether it took it.
    pub(crate) fn offer(&mut self, frame: &Arc<Frame>) -> bool {
        let takes = !self.is_busy && self.jobs.send(Arc::clone(frame)).is_ok();
        self.is_busy |= takes;
        takes
    }

    /// Its answer, if there is one.
    pub(crate) fn answer(&mut self) -> Option<Answer<T>> {
        let answer = self.answers.try_recv().ok()?;
        self.is_busy = false;
        Some(answer)
    }
}

/// What a panic said.
fn words(cause: &(dyn Any + Send)) -> String {
    let said = cause
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| cause.downcast_ref::<String>().map(String::as_str));
    format!("it panicked: {}", said.unwrap_or("without a word"))
}
