//! Progress bars: on standard error, and only on a terminal.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;

/// A bar for `length` steps, or a counter when the length is not known. Draws
/// nothing when standard error is not a terminal.
pub(crate) fn bar(length: Option<u64>, what: &'static str) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::with_draw_target(length, ProgressDrawTarget::hidden());
    }
    let (bar, template) = match length {
        Some(length) => (
            ProgressBar::new(length),
            "{prefix} {bar:30} {pos}/{len} {per_sec:>10} eta {eta} {wide_msg}",
        ),
        None => (ProgressBar::new_spinner(), "{prefix} {pos} {per_sec:>10} {elapsed} {wide_msg}"),
    };
    let style = ProgressStyle::with_template(template);
    bar.with_prefix(what).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}
