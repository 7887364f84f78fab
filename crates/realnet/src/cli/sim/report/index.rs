//! The page over many runs.

use super::{badge, foot, head, page_name};
use crate::cli::html::escape;
use crate::cli::sim::json::RunResult;
use crate::cli::sim::table::{RangeGain, ScenarioSummary, number, percent, summaries};
use realnet_sim::HELD_S;
use std::fmt::Write as _;

/// The page over these runs: what all come to, a row for each scenario, and a link to
/// the page of each run for which `has_page` says that there is one. `errors` are of
/// the runs that went wrong, with their names and seeds.
pub(in crate::cli::sim) fn index(
    runs: &[RunResult],
    has_page: impl Fn(&RunResult) -> bool,
    errors: &[String],
    command: &str,
) -> String {
    let scenarios = summaries(runs);
    let passed = runs.iter().filter(|run| run.passed()).count();
    let mut html = head("scenarios");
    let _ = writeln!(
        html,
        "<header><h1>Scenarios {}</h1><p class=\"lead\">{passed} of {} runs of {} scenarios passed.</p></header>",
        badge(passed == runs.len() && errors.is_empty()),
        runs.len(),
        scenarios.len(),
    );
    gain(&mut html, &RangeGain::of(runs));
    html.push_str(
        "<div class=\"scroll\"><table class=\"wide-table\"><thead>\
         <tr><td></td><td></td><th colspan=\"2\" scope=\"colgroup\">gap RMSE, m</th>\
         <th colspan=\"3\" scope=\"colgroup\">range error, %</th>\
         <th colspan=\"2\" scope=\"colgroup\">jitter, mm</th><th>in 2 sd</th><th>least</th>\
         <th>tracked</th></tr>\
         <tr><th scope=\"col\">scenario</th><th scope=\"col\">passed</th>\
         <th scope=\"col\">mean</th><th scope=\"col\">worst</th>\
         <th scope=\"col\">mean</th><th scope=\"col\">worst</th><th scope=\"col\">net</th>\
         <th scope=\"col\">mean</th><th scope=\"col\">net</th>\
         <th scope=\"col\">%</th><th scope=\"col\">clearance, m</th>\
         <th scope=\"col\">%</th></tr></thead><tbody>\n",
    );
    for scenario in &scenarios {
        row(&mut html, scenario, runs, &has_page);
    }
    let _ = writeln!(
        html,
        "</tbody></table></div>\n<p class=\"note\">Net: the range of the network alone, held between its maps for \
         {HELD_S} s at most; errors and jitter are of the frames with both. In 2 sd: frames with the true range within two deviations of the fused one. The squares are the \
         runs by seed, and link to their pages.</p>",
    );
    failures(&mut html, &scenarios, runs, &has_page);
    if !errors.is_empty() {
        html.push_str("<h2>What went wrong</h2>\n<ul class=\"failures\">");
        for error in errors {
            let _ = write!(html, "<li>{}</li>", escape(error));
        }
        html.push_str("</ul>\n");
    }
    html.push_str(&foot(command));
    html
}

/// What the fusion gains, in large numbers.
fn gain(html: &mut String, gain: &RangeGain) {
    let mm = |value: Option<f64>| number(value.map(|m| 1e3 * m), 1);
    html.push_str("<div class=\"tiles\">");
    for (name, value, note) in [
        (
            "Fused range is off by",
            format!("{} %", percent(gain.fused.abs_rel, 2)),
            format!(
                "{} % with the network alone: ratio {}",
                percent(gain.network.abs_rel, 2),
                number(gain.error_ratio(), 2)
            ),
        ),
        (
            "Jitter of the fused range",
            format!("{} mm", mm(gain.fused.jitter_m)),
            format!(
                "{} mm with the network alone: ratio {}",
                mm(gain.network.jitter_m),
                number(gain.jitter_ratio(), 2)
            ),
        ),
        (
            "Truth within two deviations",
            format!("{} %", percent(gain.within_two_std, 1)),
            format!("of {} tracked frames, all runs as one", gain.deviations),
        ),
    ] {
        let _ = write!(html, "<div><p>{name}</p><strong>{value}</strong><p>{note}</p></div>");
    }
    html.push_str("</div>\n");
}

fn row(
    html: &mut String,
    scenario: &ScenarioSummary,
    runs: &[RunResult],
    has_page: impl Fn(&RunResult) -> bool,
) {
    let own = || runs.iter().filter(|run| run.scenario == scenario.scenario);
    let name = escape(&scenario.scenario);
    // The page of its only run, or of the first that failed, is the one to look at.
    let shown = own().find(|run| !run.passed()).or_else(|| own().next());
    let name = match shown.filter(|run| has_page(run)) {
        Some(run) => format!("<a href=\"{}\">{name}</a>", escape(&page_name(run))),
        None => name,
    };
    let _ = write!(html, "<tr><th scope=\"row\">{name}<div class=\"seeds\">");
    for run in own() {
        let (class, word) = if run.passed() { ("passed", "passed") } else { ("failed", "failed") };
        let mark = if run.passed() { "" } else { "✗" };
        let title = format!("seed {}: {word}", run.seed);
        let _ = if has_page(run) {
            let page = escape(&page_name(run));
            write!(
                html,
                "<a class=\"{class}\" href=\"{page}\" title=\"{title}\" aria-label=\"{title}\">{mark}</a>"
            )
        } else {
            write!(html, "<span class=\"{class}\" title=\"{title}\">{mark}</span>")
        };
    }
    let class = if scenario.passed() { "" } else { " class=\"bad-cell\"" };
    let [passes, figures @ ..] = scenario.cells();
    let _ = write!(html, "</div></th><td{class}>{passes}</td>");
    for cell in figures {
        let _ = write!(html, "<td>{cell}</td>");
    }
    html.push_str("</tr>\n");
}

fn failures(
    html: &mut String,
    scenarios: &[ScenarioSummary],
    runs: &[RunResult],
    has_page: impl Fn(&RunResult) -> bool,
) {
    if scenarios.iter().all(ScenarioSummary::passed) {
        return;
    }
    html.push_str("<h2>Why runs failed</h2>\n");
    for scenario in scenarios.iter().filter(|scenario| !scenario.passed()) {
        let _ = write!(html, "<h3>{}</h3><ul class=\"failures\">", escape(&scenario.scenario));
        let own = runs.iter().filter(|run| run.scenario == scenario.scenario && !run.passed());
        for run in own {
            let seed = match has_page(run) {
                true => format!("<a href=\"{}\">seed {}</a>", escape(&page_name(run)), run.seed),
                false => format!("seed {}", run.seed),
            };
            let _ = write!(html, "<li>{seed}: {}</li>", escape(&run.failures.join("; ")));
        }
        html.push_str("</ul>\n");
    }
}
