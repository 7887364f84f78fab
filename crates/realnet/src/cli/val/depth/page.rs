//! The report: a page with the figures and pictures from the best to the worst.

use super::{
    data::{Data, Sample},
    estimate::Estimator,
    report::{FrameErrors, Report},
};
use crate::cli::{camera_args::CameraArgs, detect::make_directory, failure::keep_input, html};
use anyhow::Result;
use realnet::{
    DepthMap, Frame,
    annotate::{depth_colors, depth_error_colors, side_by_side},
    atomic,
    eval::DepthErrors,
    picture,
};
use std::{
    fmt::Write as _,
    path::{Path, PathBuf},
};

/// Names of the files.
const METRICS: &str = "metrics.json";
const IMAGES: &str = "images.csv";
pub(super) const INDEX: &str = "index.html";

/// The relative error that is drawn white.
const WHITE: f32 = 0.5;
/// Which pictures are shown: their places when all are sorted by error.
const SHOWN: [(f64, &str); 5] = [
    (0.0, "The best"),
    (0.25, "Better than three quarters"),
    (0.5, "The middle one"),
    (0.75, "Worse than three quarters"),
    (1.0, "The worst"),
];

/// The report's folder.
pub(super) struct Page {
    folder: PathBuf,
}

impl Page {
    /// A report into `folder`, which replaces none of the inputs.
    pub(super) fn create(folder: &Path, inputs: &[Option<&Path>]) -> Result<Self> {
        make_directory(folder)?;
        for input in inputs.iter().flatten() {
            for name in [METRICS, IMAGES, INDEX] {
                keep_input(&folder.join(name), input)?;
            }
        }
        Ok(Self { folder: folder.to_owned() })
    }

    /// Writes the page and its pictures; their depth is produced once more.
    #[allow(clippy::too_many_arguments, reason = "the parts of a report")]
    pub(super) fn finish(
        &self,
        command: &str,
        report: &Report,
        text: &str,
        data: &Data,
        frames: &[FrameErrors],
        estimator: &mut Estimator,
        camera: &CameraArgs,
    ) -> Result<()> {
        let write = |name: &str, bytes: &[u8]| atomic::write(&self.folder.join(name), bytes);
        write(METRICS, &serde_json::to_vec_pretty(report)?)?;
        write(IMAGES, csv(data, frames)?.as_bytes())?;
        let mut html = String::from(HEAD);
        writeln!(html, "<h1>Depth</h1><p>{}</p>", html::text(&report.protocol.data))?;
        writeln!(html, "<pre>{}</pre><pre>{}</pre>", html::text(command), html::text(text))?;
        writeln!(
            html,
            "<p>Picture, true depth, produced depth (near red, far blue, unknown grey), error: \
             black 0 to white {:.0} % and more; blue where only one of the two is known.</p>",
            100.0 * WHITE
        )?;
        let mut sorted: Vec<(f64, usize)> = frames
            .iter()
            .filter_map(|frame| Some((frame.compared.errors?.abs_rel, frame.index)))
            .collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut last = None;
        for (number, (share, title)) in SHOWN.into_iter().enumerate() {
            let place = (share * sorted.len().saturating_sub(1) as f64).round() as usize;
            let Some((abs_rel, index)) = sorted.get(place) else { break };
            let (Some(sample), false) = (data.samples.get(*index), last == Some(place)) else {
                continue;
            };
            last = Some(place);
            let name = format!("depth-{number}.png");
            picture::write(&self.folder.join(&name), &draw(sample, estimator, camera)?)?;
            writeln!(
                html,
                "<h2>{title}: {}, abs_rel {abs_rel:.3}</h2><img src=\"{name}\" alt=\"depth\">",
                html::text(&sample.name().display().to_string())
            )?;
        }
        html.push_str("</body></html>\n");
        // Last: what it shows is there.
        write(INDEX, html.as_bytes())?;
        Ok(())
    }
}

/// Picture, truth, produced depth and error of a sample in a row.
fn draw(sample: &Sample, estimator: &mut Estimator, camera: &CameraArgs) -> Result<Frame> {
    let (frame, truth) = sample.read()?;
    let prepared = estimator.prepare(sample, &frame, camera)?;
    let (produced, _) = estimator.run(prepared, &frame)?;
    let (near, far) = range(&truth);
    let depths =
        side_by_side(&depth_colors(&truth, near, far)?, &depth_colors(&produced, near, far)?)?;
    let left = side_by_side(&frame.to_rgb(), &depths)?;
    Ok(side_by_side(&left, &depth_error_colors(&truth, &produced, WHITE)?)?)
}

/// The range of the known depths without the outer hundredths.
fn range(map: &DepthMap) -> (f32, f32) {
    let mut known: Vec<f32> =
        map.data().iter().copied().filter(|depth| DepthMap::is_known(*depth)).collect();
    known.sort_by(f32::total_cmp);
    let at = |share: f64| {
        known.get((share * known.len().saturating_sub(1) as f64) as usize).copied().unwrap_or(1.0)
    };
    (at(0.01), at(0.99))
}

/// A line for each picture.
fn csv(data: &Data, frames: &[FrameErrors]) -> Result<String> {
    let mut text = format!("image,truth_pixels,pixels,scale,{}\n", DepthErrors::NAMES.join(","));
    for FrameErrors { index, compared } in frames {
        let Some(sample) = data.samples.get(*index) else { continue };
        let name = sample.name().display().to_string().replace('"', "\"\"");
        write!(text, "\"{name}\",{},{},", compared.truth_pixels, compared.pixels)?;
        if let Some(scale) = compared.scale {
            write!(text, "{scale:.5}")?;
        }
        match &compared.errors {
            Some(errors) => {
                for value in errors.values() {
                    write!(text, ",{value:.6}")?;
                }
            }
            None => text.push_str(&",".repeat(DepthErrors::NAMES.len())),
        }
        text.push('\n');
    }
    Ok(text)
}

const HEAD: &str = "<!doctype html>
<html lang=\"en\"><head><meta charset=\"utf-8\"><title>Depth</title>
<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">
<style>
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 84rem; padding: 0 1rem; }
pre { background: #f4f4f4; overflow-x: auto; padding: .7rem; }
img { max-width: 100%; }
</style></head><body>
";
