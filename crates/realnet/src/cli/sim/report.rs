//! Reports: one page a run that needs nothing but itself, and a page over many runs.

mod chart;
mod index;
mod lanes;
mod plots;
mod top_view;

pub(super) use index::index;

use super::json::RunResult;
use super::table::{number, percent};
use crate::cli::html::escape;
use plots::Plots;
use realnet_sim::{CueFigures, RunLog};
use std::fmt::Write as _;

/// Stops that are listed.
const MOST_STOPS: usize = 40;

/// What a page says besides the run.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PageOptions<'a> {
    /// How the program was called.
    pub(super) command: &'a str,
    /// Where the video of the run is, as seen from the page.
    pub(super) video: Option<&'a str>,
    /// Where the page over all runs is, as seen from the page.
    pub(super) index: Option<&'a str>,
}

/// The file name of a run's page.
pub(super) fn page_name(run: &RunResult) -> String {
    format!("{}-{}.html", run.scenario, run.seed)
}

/// The page of a run.
pub(super) fn page(run: &RunResult, log: &RunLog, options: &PageOptions<'_>) -> String {
    let title = format!("{}, seed {}", run.scenario, run.seed);
    let mut html = head(&title);
    if let Some(index) = options.index {
        let _ = writeln!(html, "<nav><a href=\"{}\">← all scenarios</a></nav>", escape(index));
    }
    let _ = writeln!(
        html,
        "<header><h1>{} {}</h1><p class=\"lead\">{}</p><p class=\"facts\">Seed {} · {} s · {} frames</p>",
        escape(&run.scenario),
        badge(run.passed()),
        escape(&log.description),
        run.seed,
        number(Some(run.figures.duration_s), 1),
        run.figures.frames,
    );
    if !run.passed() {
        html.push_str("<ul class=\"failures\">");
        for failure in &run.failures {
            let _ = write!(html, "<li>{}</li>", escape(failure));
        }
        html.push_str("</ul>");
    }
    html.push_str("</header>\n");
    figures(&mut html, run, log);
    if let Some(video) = options.video {
        let video = escape(video);
        let _ = writeln!(html, "<p>Video: <a href=\"{video}\">{video}</a></p>");
    }
    let plots = Plots::new(log, &run.figures);
    if log.frames.is_empty() {
        html.push_str("<p>The run has no frames.</p>\n");
    } else {
        html.push_str(
            "<h2>Range</h2>\n<p class=\"note\">Grey background: the target is not tracked.</p>\n",
        );
        html.push_str(&plots.range());
        html.push_str(&plots.error());
        html.push_str("<h2>Driving</h2>\n");
        html.push_str(&plots.gap());
        html.push_str(&plots.speed());
        html.push_str(&plots.steering());
        html.push_str(&plots.lateral());
        html.push_str(&top_view::html(log));
        html.push_str("<h2>What held when</h2>\n");
        html.push_str(&lanes::html(log));
        html.push_str(&stops(run));
        html.push_str("<h2>How late things came</h2>\n");
        html.push_str(&plots.latency());
    }
    html.push_str(&foot(options.command));
    html
}

/// The figures of a run in two tables.
fn figures(html: &mut String, run: &RunResult, log: &RunLog) {
    let f = &run.figures;
    let millimetres = |value: Option<f64>| number(value.map(|m| 1e3 * m), 1);
    html.push_str("<div class=\"tables\">\n<table><caption>Driving</caption><tbody>");
    let asked = number(Some(log.desired_gap_m), 2);
    for (name, value, unit) in [
        (format!("Gap off the {asked} m asked, RMS"), number(f.gap_rmse_m, 3), "m"),
        ("Off the target’s path, RMS".to_owned(), number(f.lateral_rmse_m, 3), "m"),
        ("Least clearance".to_owned(), number(f.min_gap_m, 3), "m"),
        ("Collisions".to_owned(), f.collisions.to_string(), ""),
        ("Target tracked while visible".to_owned(), percent(f.tracked_share, 1), "%"),
        ("Stops".to_owned(), f.stops.len().to_string(), ""),
    ] {
        let _ = write!(
            html,
            "<tr><th scope=\"row\">{name}</th><td>{value}</td><td class=\"unit\">{unit}</td></tr>"
        );
    }
    html.push_str("</tbody></table>\n<table><caption>Range, on frames tracked with a range of the network</caption><thead><tr><td></td>");
    for name in ["fused", "fast", "network"] {
        let _ = write!(html, "<th scope=\"col\" class=\"{name}\"><i></i>{name}</th>");
    }
    html.push_str("<td></td></tr></thead><tbody>");
    let mut row = |name: &str, value: &dyn Fn(&CueFigures) -> String, unit: &str| {
        let _ = write!(html, "<tr><th scope=\"row\">{name}</th>");
        for cue in [&f.fused, &f.fast, &f.network] {
            let _ = write!(html, "<td>{}</td>", value(cue));
        }
        let _ = write!(html, "<td class=\"unit\">{unit}</td></tr>");
    };
    row("Relative error, mean", &|cue| percent(cue.abs_rel, 2), "%");
    row("Bias", &|cue| percent(cue.bias, 2), "%");
    row("Jitter, RMS", &|cue| millimetres(cue.jitter_m), "mm");
    row("Known while visible", &|cue| percent(cue.known_share, 1), "%");
    // Of the fused range alone, which needs no map of the network.
    for (name, value) in [
        ("Relative error, all tracked frames", percent(f.tracked.abs_rel, 2)),
        ("Truth in two deviations, all tracked", percent(f.within_two_std, 1)),
    ] {
        let _ = write!(
            html,
            "<tr><th scope=\"row\">{name}</th><td>{value}</td><td></td><td></td>\
             <td class=\"unit\">%</td></tr>"
        );
    }
    html.push_str("</tbody></table>\n</div>\n");
}

/// The stops in a table.
fn stops(run: &RunResult) -> String {
    if run.figures.stops.is_empty() {
        return "<p class=\"note\">The follower was never stopped.</p>\n".to_owned();
    }
    let mut html = String::from(
        "<table class=\"stops\"><thead><tr><th scope=\"col\">Stop</th><th scope=\"col\">from, s</th>\
         <th scope=\"col\">until, s</th></tr></thead><tbody>",
    );
    for stop in run.figures.stops.iter().take(MOST_STOPS) {
        let until = stop.until_s.map_or("the end".to_owned(), |until| number(Some(until), 2));
        let _ = write!(
            html,
            "<tr><th scope=\"row\">{}</th><td>{}</td><td>{until}</td></tr>",
            stop.reason.name(),
            number(Some(stop.from_s), 2)
        );
    }
    html.push_str("</tbody></table>\n");
    if let Some(more) = run.figures.stops.len().checked_sub(MOST_STOPS).filter(|more| *more > 0) {
        let _ = writeln!(html, "<p class=\"note\">… and {more} more.</p>");
    }
    html
}

/// Passed or failed, in words and colour.
fn badge(passed: bool) -> &'static str {
    if passed {
        "<span class=\"badge passed\">✓ passed</span>"
    } else {
        "<span class=\"badge failed\">✗ failed</span>"
    }
}

fn head(title: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <title>RealNet: {}</title>\n<style>\n{}</style></head><body>\n",
        escape(title),
        include_str!("report/page.css")
    )
}

fn foot(command: &str) -> String {
    let version = env!("CARGO_PKG_VERSION");
    let script = include_str!("report/page.js");
    format!(
        "<footer><pre>{}</pre><p>realnet {version}</p></footer>\n<script>\n{script}</script>\n</body></html>\n",
        escape(command)
    )
}

#[cfg(test)]
pub(super) mod tests;
