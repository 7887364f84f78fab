//! The report: a page with the figures, curves over the frames, and pictures of
//! some frames.

mod chart;

use super::measure::{Figures, FrameFigures, KeyTarget, View};
use crate::cli::{detect::make_directory, failure::keep_input, html};
use anyhow::Result;
use chart::{Chart, density};
use realnet::{
    DepthMap, Frame,
    annotate::{Annotator, FlowMark, FlowSide, depth_colors, depth_error_colors, side_by_side},
    atomic, picture,
};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

const TARGET: [u8; 3] = [255, 140, 0];
const BACKGROUND: [u8; 3] = [60, 200, 255];
const WRONG: [u8; 3] = [255, 60, 120];
const LOST: [u8; 3] = [160, 160, 160];

/// Names of the files.
const METRICS: &str = "metrics.json";
const FRAMES: &str = "frames.csv";
pub(super) const INDEX: &str = "index.html";

/// Pictures shown besides that of the largest error.
const SHOWN: u64 = 3;
/// The relative error that is drawn white.
const WHITE: f32 = 0.1;

/// The report, while frames come in.
pub(super) struct Page {
    directory: PathBuf,
    annotator: Annotator,
    views: Vec<Shown>,
    worst: Option<Shown>,
    /// Frames of the run.
    length: u64,
}

/// One frame of the report.
struct Shown {
    figures: FrameFigures,
    key: u64,
    corners: Frame,
    depths: Frame,
    /// A sentence and a chart about the target.
    target: Option<(String, Option<String>)>,
}

impl Page {
    /// A report into `directory` of a run over `length` frames. It does not replace
    /// the file `input`.
    pub(super) fn create(directory: &Path, length: u64, input: Option<&Path>) -> Result<Self> {
        make_directory(directory)?;
        if let Some(input) = input {
            for name in [METRICS, FRAMES, INDEX] {
                keep_input(&directory.join(name), input)?;
            }
        }
        Ok(Self {
            directory: directory.to_owned(),
            annotator: Annotator::new(Vec::new())?,
            views: Vec::new(),
            worst: None,
            length,
        })
    }

    /// A frame, the `index`-th of the run, that may be shown.
    pub(super) fn offer(&mut self, index: u64, view: &View<'_>) -> Result<()> {
        // In the middle of equal parts of the run, or a little later, when the map
        // is old enough to show anything.
        let due = (2 * self.views.len() as u64 + 1) * self.length / (2 * SHOWN);
        let patience = (self.length / (4 * SHOWN)).min(8);
        let old = view.figures.since_depth > 2 || index >= due + patience;
        if (self.views.len() as u64) < SHOWN && index >= due && old {
            self.views.push(self.draw(view)?);
        }
        let error = |figures: &FrameFigures| figures.abs_rel.unwrap_or(0.0);
        let most = self.worst.as_ref().map_or(0.0, |worst| error(&worst.figures));
        if error(view.figures) > most {
            self.worst = Some(self.draw(view)?);
        }
        Ok(())
    }

    fn draw(&self, view: &View<'_>) -> Result<Shown> {
        let mut marks = Vec::new();
        let background = view.tracker.background_tracks().map(|track| (track, BACKGROUND));
        let target = view.tracker.target_tracks().map(|track| (track, TARGET));
        for ((from, track, agrees), color) in background.chain(target) {
            marks.push(match (track.is_tracked(), agrees) {
                (true, true) => FlowMark { from, to: Some(track.point), color },
                (true, false) => FlowMark { from, to: Some(track.point), color: WRONG },
                (false, _) => FlowMark { from, to: None, color: LOST },
            });
        }
        let (mut before, mut after) = (view.key.color.to_rgb(), view.color.to_rgb());
        let own: Vec<FlowMark> = marks
            .iter()
            .map(|mark| FlowMark {
                color: if mark.color == TARGET { TARGET } else { BACKGROUND },
                ..*mark
            })
            .collect();
        self.annotator.draw_flow(&mut before, &own, FlowSide::Before);
        self.annotator.draw_flow(&mut after, &marks, FlowSide::After);
        if let Some(target) = &view.key.target {
            self.annotator.draw_box(&mut before, &target.bbox, TARGET, "target");
        }
        let (near, far) = range(view.truth);
        let depths = [view.truth, view.produced, &view.key.depth];
        let [truth, produced, held] = depths.map(|map| depth_colors(map, near, far));
        let errors =
            [view.produced, &view.key.depth].map(|map| depth_error_colors(view.truth, map, WHITE));
        let [produced_error, held_error] = errors;
        let upper = side_by_side(&side_by_side(&truth?, &produced?)?, &held?)?;
        let blank = Frame::rgb8(
            view.truth.stamp(),
            view.truth.width(),
            view.truth.height(),
            vec![255; view.truth.data().len() * 3],
        )?;
        let lower = side_by_side(&side_by_side(&blank, &produced_error?)?, &held_error?)?;
        Ok(Shown {
            figures: view.figures.clone(),
            key: view.key.number,
            corners: side_by_side(&before, &after)?,
            depths: stack(&upper, &lower)?,
            target: view.key.target.as_ref().map(describe),
        })
    }

    /// Writes the page and its pictures.
    pub(super) fn finish(
        &self,
        title: &str,
        command: &str,
        figures: &Figures,
        table: &str,
        frames: &[FrameFigures],
    ) -> Result<()> {
        let write = |name: &str, bytes: &[u8]| atomic::write(&self.directory.join(name), bytes);
        write(METRICS, &serde_json::to_vec_pretty(figures)?)?;
        write(FRAMES, csv(frames)?.as_bytes())?;
        let mut html = String::new();
        html.push_str(HEAD);
        writeln!(html, "<h1>Motion between depth maps</h1><p>{}</p>", html::text(title))?;
        writeln!(html, "<pre>{}</pre><pre>{}</pre>", html::text(command), html::text(table))?;
        self.charts(&mut html, frames)?;
        for (index, shown) in self.views.iter().chain(&self.worst).enumerate() {
            let worst = index == self.views.len();
            self.view(&mut html, index + 1, shown, worst)?;
        }
        html.push_str("</body></html>\n");
        // Last: what it shows is there.
        write(INDEX, html.as_bytes())?;
        Ok(())
    }

    fn charts(&self, html: &mut String, frames: &[FrameFigures]) -> Result<()> {
        let number = |f: &FrameFigures| f.frame as f64;
        let series = |value: fn(&FrameFigures) -> Option<f64>| -> Vec<(f64, Option<f64>)> {
            frames.iter().map(|f| (number(f), value(f))).collect()
        };
        let failed: Vec<f64> = frames.iter().filter(|f| f.failure.is_some()).map(number).collect();
        let depth = Chart::new("absolute relative error of the depth", "frame")
            .line("produced", "#d35400", series(|f| f.abs_rel))
            .line("last map held", "#7f8c8d", series(|f| f.abs_rel_hold))
            .marks("failed", "#c0392b", failed.clone());
        let known = Chart::new("share of the pixels known", "frame")
            .line("produced", "#d35400", series(|f| f.known_share))
            .top(1.0);
        let rotation = Chart::new("rotation error from frame to frame, degrees", "frame")
            .line("rotation", "#2471a3", series(|f| f.rpe_rot_deg))
            .marks("failed", "#c0392b", failed.clone());
        let translation = Chart::new("translation error from frame to frame, mm", "frame")
            .line("translation", "#1e8449", series(|f| f.rpe_trans_m.map(|m| 1000.0 * m)))
            .marks("failed", "#c0392b", failed);
        for chart in [depth, known, rotation, translation] {
            html.push_str(&chart.svg());
        }
        Ok(())
    }

    fn view(&self, html: &mut String, number: usize, shown: &Shown, worst: bool) -> Result<()> {
        let (corners, depths) = (format!("corners-{number}.png"), format!("depth-{number}.png"));
        picture::write(&self.directory.join(&corners), &shown.corners)?;
        picture::write(&self.directory.join(&depths), &shown.depths)?;
        let figures = &shown.figures;
        let percent =
            |v: Option<f64>| v.map_or("unknown".into(), |v| format!("{:.2} %", 100.0 * v));
        writeln!(
            html,
            "<h2>{}Frame {}, {} after the depth map of frame {}</h2>",
            if worst { "The largest error: " } else { "" },
            figures.frame,
            if figures.since_depth == 1 {
                "1 frame".into()
            } else {
                format!("{} frames", figures.since_depth)
            },
            shown.key
        )?;
        writeln!(
            html,
            "<p>{} corners of the background, {} found again, {} agree with one motion. \
             Depth off by {}, the held map by {}; {} of the pixels known.</p>",
            figures.corners,
            figures.tracked,
            figures.inliers,
            percent(figures.abs_rel),
            percent(figures.abs_rel_hold),
            percent(figures.known_share)
        )?;
        for failure in figures.failure.iter().chain(&figures.target_failure) {
            writeln!(html, "<p class=bad>Unknown: {}</p>", html::text(failure))?;
        }
        writeln!(
            html,
            "<figure><img src=\"{corners}\" alt=\"corners and flow\"><figcaption>Left: corners on \
             the depth map's frame, <b style=\"color:#1793c4\">background</b> and \
             <b style=\"color:#d97700\">target</b>. Right: where flow took them; \
             <b style=\"color:#d6336c\">disagree</b> with the motion, \
             <b style=\"color:#777\">crosses</b> were lost.</figcaption></figure>"
        )?;
        writeln!(
            html,
            "<figure><img src=\"{depths}\" alt=\"depth\"><figcaption>Depth, near red, far blue, \
             unknown grey: true, produced, last map held. Below: error against the truth, black 0 \
             to white {:.0} % and more; blue where only one of the two is known.</figcaption></figure>",
            100.0 * WHITE
        )?;
        if let Some((sentence, chart)) = &shown.target {
            writeln!(html, "<p>{}</p>", html::text(sentence))?;
            html.push_str(chart.as_deref().unwrap_or_default());
        }
        Ok(())
    }
}

/// The range of the target in its box on the key frame.
fn describe(target: &KeyTarget) -> (String, Option<String>) {
    match &target.found {
        Ok((range, histogram, gate)) => {
            let sentence = format!(
                "Depth in the box: {:.2} m, standard deviation {:.2} m, from {:.0} % of its known \
                 pixels; the target by the sigma rule: {:.2} to {:.2} m.",
                range.depth_m,
                range.std_m,
                100.0 * range.used_share(),
                gate.near,
                gate.far
            );
            (sentence, Some(density(histogram, gate)))
        }
        Err(reason) => (format!("Depth in the box is unknown: {reason}"), None),
    }
}

/// Depths that hold 96 % of a map.
fn range(map: &DepthMap) -> (f32, f32) {
    let mut known: Vec<f32> =
        map.data().iter().copied().filter(|z| DepthMap::is_known(*z)).collect();
    known.sort_by(f32::total_cmp);
    let at = |share: f64| known.get((known.len() as f64 * share) as usize).copied();
    match (at(0.02), at(0.98)) {
        (Some(near), Some(far)) if far > near => (near, far),
        (Some(near), _) => (0.9 * near, 1.1 * near),
        _ => (0.5, 5.0),
    }
}

/// One frame above another of the same width.
fn stack(upper: &Frame, lower: &Frame) -> Result<Frame> {
    let mut data = upper.data().to_vec();
    data.extend_from_slice(lower.data());
    Ok(Frame::rgb8(upper.stamp(), upper.width(), upper.height() + lower.height(), data)?)
}

/// The figures of each frame as CSV.
fn csv(frames: &[FrameFigures]) -> Result<String> {
    let mut text = String::from(
        "frame,since_depth,abs_rel,abs_rel_hold,known_share,rpe_trans_m,rpe_rot_deg,corners,tracked,\
         inliers,ms,failure,target_failure\n",
    );
    let number = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.6}"));
    let words = |value: &Option<String>| {
        value.as_ref().map_or(String::new(), |v| format!("\"{}\"", v.replace('"', "\"\"")))
    };
    for f in frames {
        writeln!(
            text,
            "{},{},{},{},{},{},{},{},{},{},{:.3},{},{}",
            f.frame,
            f.since_depth,
            number(f.abs_rel),
            number(f.abs_rel_hold),
            number(f.known_share),
            number(f.rpe_trans_m),
            number(f.rpe_rot_deg),
            f.corners,
            f.tracked,
            f.inliers,
            f.ms,
            words(&f.failure),
            words(&f.target_failure)
        )?;
    }
    Ok(text)
}

const HEAD: &str = r#"<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>RealNet: motion between depth maps</title>
<style>
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
pre { background: #f4f4f2; padding: .7rem 1rem; overflow-x: auto; white-space: pre-wrap; font-size: 14px; }
figure { margin: 1rem 0; } img { width: 100%; image-rendering: auto; }
figcaption, .bad { font-size: 14px; color: #555; } .bad { color: #b03a2e; }
h2 { margin-top: 2.5rem; } svg { width: 100%; height: auto; margin: .6rem 0; }
</style></head><body>
"#;
