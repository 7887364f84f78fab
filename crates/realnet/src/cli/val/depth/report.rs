//! The figures of a run with everything that they depend on.

use super::{
    data::{Data, SelectArgs},
    estimate::Words,
};
use realnet::eval::{
    DepthErrors, DepthProtocol, DepthReport, ImageDepth, NormalErrors, NormalMetrics, ScaleSpread,
};
use realnet_pose::NormalOptions;
use serde::Serialize;
use std::fmt::Write as _;

/// What `--json` prints.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    #[serde(flatten)]
    pub(super) errors: DepthErrors,
    /// Pictures that the figures are of.
    pub(super) images: usize,
    pub(super) protocol: Protocol,
    /// Errors of the surfaces' normals, mean of images; where they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) normals: Option<Normals>,
    /// Median of fitting, inference and resizing; reading files is not in it. Depth
    /// maps of another program have none.
    pub(super) ms_per_image: Option<f64>,
}

/// Errors of surface normals, and how planes were fitted.
#[derive(Debug, Serialize)]
pub(super) struct Normals {
    #[serde(flatten)]
    errors: NormalErrors,
    /// Pixels that were compared.
    pixels: u64,
    /// Columns and rows of the depths that a plane is fitted to.
    window: u32,
    /// Share of the depth by which neighbours may differ.
    step: f32,
    /// Share of the window that has to belong to the surface.
    least: f64,
}

impl Normals {
    pub(super) fn new(metrics: &NormalMetrics, options: NormalOptions) -> Option<Self> {
        let NormalOptions { radius, step, least } = options;
        let (pixels, window) = (metrics.pixels(), 2 * radius + 1);
        metrics.errors().map(|errors| Self { errors, pixels, window, step, least })
    }
}

/// How it was measured, and on what.
#[derive(Debug, Serialize)]
pub(super) struct Protocol {
    #[serde(flatten)]
    pub(super) own: DepthProtocol,
    pub(super) data: String,
    pub(super) layout: String,
    /// Units a metre in the files of the truth.
    pub(super) depth_scale: f64,
    pub(super) selection: Selection,
    /// Pictures without depth, or that could not be read or compared.
    pub(super) images_left_out: usize,
    /// Pictures without a pixel to compare.
    pub(super) images_without_comparison: usize,
    /// Pixels with a true depth inside crop and range.
    pub(super) truth_pixels: u64,
    /// Those of them with a produced depth: the ones compared.
    pub(super) pixels: u64,
    /// `pixels / truth_pixels`.
    pub(super) known_share: Option<f64>,
    /// The ratios of the medians, with median scaling.
    pub(super) scale: Option<ScaleSpread>,
    pub(super) estimator: Words,
    pub(super) camera: Option<String>,
}

/// Which pictures of the data.
#[derive(Debug, Serialize)]
pub(super) struct Selection {
    split: Option<String>,
    from: Option<u64>,
    to: Option<u64>,
    limit: Option<u32>,
    /// The first and the last picture that were chosen.
    first: String,
    last: String,
    chosen: usize,
}

impl Selection {
    pub(super) fn new(args: &SelectArgs, data: &Data) -> Self {
        let name = |sample: Option<&super::data::Sample>| {
            sample.map_or(String::new(), |sample| sample.name().display().to_string())
        };
        Self {
            split: args.split.as_ref().map(|path| path.display().to_string()),
            from: args.from,
            to: args.to,
            limit: args.limit,
            first: name(data.samples.first()),
            last: name(data.samples.last()),
            chosen: data.samples.len(),
        }
    }
}

/// The comparison of one picture, by its place in the data.
#[derive(Clone, Copy, Debug)]
pub(super) struct FrameErrors {
    pub(super) index: usize,
    pub(super) compared: ImageDepth,
}

/// The figures for people.
pub(super) fn text(report: &Report, errors: &DepthReport) -> String {
    let Protocol { data, layout, depth_scale, selection, estimator, camera, .. } = &report.protocol;
    let Selection { first, last, chosen, .. } = selection;
    let mut text = format!(
        "data: {data} ({layout}, {depth_scale} units a metre), {chosen} pictures, {first} to \
         {last}\n"
    );
    let _ = match estimator {
        Words::Network { model, engine, input: (width, height), output, focal } => writeln!(
            text,
            "depth: {model} at {width}x{height} ({output} output, focal length {focal} px), \
             {engine}; camera: {}",
            camera.as_deref().unwrap_or("unknown")
        ),
        Words::Predictions { folder, scale } => {
            writeln!(text, "depth: the files in {folder}, {scale} units a metre")
        }
    };
    text.push_str(&errors.table());
    let DepthErrors { abs_rel, sq_rel, rmse, rmse_log, d1, .. } = report.errors;
    let _ = write!(
        text,
        "\nthe paper's table ({})\n     Abs       Sq      RMS   logRMS  Accuracy\n\
         {abs_rel:8.4} {sq_rel:8.4} {rmse:8.4} {rmse_log:8.4} {:7.2} %\n\
         Abs: mean of |g - p| / g; Sq: mean of (g - p)^2 / g, m; RMS: root of the mean of \
         (g - p)^2, m;\nlogRMS: root of the mean of (ln g - ln p)^2; Accuracy: share of pixels \
         with max(g / p, p / g) < 1.25;\ng true and p produced depth\n",
        report.protocol.own.pooling,
        100.0 * d1
    );
    if let Some(normals) = &report.normals {
        let Normals { errors, pixels, window, .. } = normals;
        let _ = writeln!(
            text,
            "\n{errors}\n(mean of images; planes fitted to {window}x{window} depths; {pixels} pixels)"
        );
    }
    if let Some(ms) = report.ms_per_image {
        let _ = writeln!(text, "\n{ms:.1} ms a picture (median; reading files not counted)");
    }
    text
}

/// The median; of an even number the lower one of the middle two.
pub(super) fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len().saturating_sub(1) / 2).copied()
}
