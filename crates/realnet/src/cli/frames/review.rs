//! The page to look at before training, and the list of frames outside the set.

use super::{
    record::{Entry, Kind, Record},
    set::{FrameSet, frame_name},
};
use crate::cli::html;
use anyhow::{Context, Result};
use realnet::{datasets::YoloDataset, picture};
use realnet_io::{
    atomic,
    datasets::{Label, labels},
};
use std::{
    collections::HashMap,
    fmt::Write as _,
    path::{Path, PathBuf},
};

/// A carried box that resembles the one before less is to be looked at.
const DOUBTFUL_SIMILARITY: f32 = 0.8;
/// So is one whose centre is less sure, as a share of the box's sides: the deviation
/// that flow tells is a careful one, at 0.2 boxes of a blurred car still had an IoU
/// above 0.8 with those drawn by hand.
const DOUBTFUL_DRIFT: f64 = 0.2;

/// Writes `review.html` and `lost.csv` from the records and the labels as they
/// are now.
pub(super) fn write(set: &FrameSet) -> Result<()> {
    let names = YoloDataset::open(&set.folder().join("data.yaml"))?.names().to_vec();
    let runs = runs(&set.folder().join("runs"))?;
    let mut lost = "name,frame,why\n".to_owned();
    let mut body = String::new();
    for (run, record) in &runs {
        let split = &record.recipe.split;
        let images = listing(&set.folder().join("images").join(split))?;
        writeln!(body, "<h2>{} ({split})</h2>", html::text(run))?;
        writeln!(body, "<p>{}</p><div class=grid>", counts(record))?;
        for entry in &record.frames {
            let name = frame_name(run, entry.index);
            match entry.kind {
                Kind::Lost | Kind::Waiting => {
                    let why = entry.reason.as_deref().unwrap_or("no box yet").replace('"', "'");
                    writeln!(lost, "{name},{},\"{why}\"", entry.index)?;
                }
                Kind::Plain | Kind::Given | Kind::Carried => {
                    // A picture that was taken out in review is not missed.
                    let Some(image) = images.get(&name) else { continue };
                    let path = set.folder().join("labels").join(split).join(&name);
                    let found = labels::read(&path.with_added_extension("txt"), names.len());
                    let rows = found.map(|labels| labels.rows).map_err(|error| error.to_string());
                    let image = format!("images/{split}/{image}");
                    body.push_str(&figure(&image, &name, entry, rows, &names));
                }
            }
        }
        body.push_str("</div>\n");
    }
    atomic::write(&set.lost_list(), lost.as_bytes())?;
    let page = format!("{HEAD}{body}</body></html>\n");
    Ok(atomic::write(&set.page(), page.as_bytes())?)
}

fn counts(record: &Record) -> String {
    let count = |kind| record.frames.iter().filter(|entry| entry.kind == kind).count();
    let doubtful = record.frames.iter().filter(|entry| is_doubtful(entry)).count();
    format!(
        "{} boxes given, {} carried ({doubtful} doubtful), {} without labels; outside the set: {} \
         lost, {} before the first box",
        count(Kind::Given),
        count(Kind::Carried),
        count(Kind::Plain),
        count(Kind::Lost),
        count(Kind::Waiting)
    )
}

fn is_doubtful(entry: &Entry) -> bool {
    entry.similarity.is_some_and(|similarity| similarity < DOUBTFUL_SIMILARITY)
        || entry.drift.is_some_and(|drift| drift > DOUBTFUL_DRIFT)
}

/// A picture with its boxes as they are in its labels now.
fn figure(
    image: &str,
    name: &str,
    entry: &Entry,
    rows: Result<Vec<Label>, String>,
    names: &[String],
) -> String {
    let class = match entry.kind {
        Kind::Given => "given",
        _ if is_doubtful(entry) => "doubtful",
        _ => "carried",
    };
    let image = html::escape(image);
    let mut text = format!(
        "<figure class={class}><a href=\"{image}\"><img loading=lazy src=\"{image}\" \
         alt=\"{}\">",
        html::escape(name)
    );
    let mut note = String::new();
    match rows {
        Ok(rows) => {
            for Label { class_id, cx, cy, w, h } in rows {
                let percent = |share: f64| 100.0 * share;
                let title = names.get(class_id as usize).map_or("", String::as_str);
                let _ = write!(
                    text,
                    "<i title=\"{}\" style=\"left:{:.2}%;top:{:.2}%;width:{:.2}%;height:{:.2}%\"></i>",
                    html::escape(title),
                    percent(cx - w / 2.0),
                    percent(cy - h / 2.0),
                    percent(w),
                    percent(h)
                );
            }
        }
        Err(error) => note = format!(" {}", html::text(&error)),
    }
    if let (Some(similarity), Some(drift)) = (entry.similarity, entry.drift) {
        let _ = write!(note, " alike {similarity:.2}, centre ±{:.1} %", 100.0 * drift);
    }
    let _ = writeln!(text, "</a><figcaption>{}{note}</figcaption></figure>", html::text(name));
    text
}

/// The records of a set, by name.
fn runs(folder: &Path) -> Result<Vec<(String, Record)>> {
    let mut paths = paths(folder)?;
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "json"));
    paths.sort();
    let mut runs = Vec::new();
    for path in paths {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if let Some(record) = Record::read(&path)? {
            runs.push((name, record));
        }
    }
    Ok(runs)
}

/// The pictures of a folder: their file names by their names without extension.
fn listing(folder: &Path) -> Result<HashMap<String, String>> {
    let mut found = HashMap::new();
    for path in paths(folder)?.iter().filter(|path| picture::has_picture_extension(path)) {
        let part = |part: Option<&std::ffi::OsStr>| {
            part.unwrap_or_default().to_string_lossy().into_owned()
        };
        found.insert(part(path.file_stem()), part(path.file_name()));
    }
    Ok(found)
}

fn paths(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder)
        .with_context(|| format!("cannot list the folder {}", folder.display()))?;
    let list: std::io::Result<Vec<PathBuf>> =
        entries.map(|entry| entry.map(|entry| entry.path())).collect();
    list.with_context(|| format!("cannot list the folder {}", folder.display()))
}

const HEAD: &str = "<!doctype html>
<html lang=\"en\"><head><meta charset=\"utf-8\"><title>Labels to review</title>
<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">
<style>
body { font: 14px/1.4 system-ui, sans-serif; margin: 1.5rem; }
.grid { display: grid; gap: .6rem; grid-template-columns: repeat(auto-fill, minmax(17rem, 1fr)); }
figure { border: 3px solid #ccc; margin: 0; }
figure.given { border-color: #2471a3; }
figure.doubtful { border-color: #d35400; }
figure a { display: block; position: relative; }
figure img { display: block; width: 100%; }
figure i { border: 2px solid #19e36b; box-sizing: border-box; position: absolute; }
figcaption { overflow-wrap: anywhere; padding: .2rem .4rem; }
</style></head><body>
<h1>Labels to review</h1>
<p>Boxes as they are in <code>labels/</code> now. Blue frames: the box was given; grey: carried by
flow; <b style=\"color:#d35400\">orange: doubtful</b>, because the box looks unlike the one before or
its centre has become unsure. A carried box that is wrong stays wrong from there on: give a box of a
later frame with <code>--boxes</code>, or correct the label files, or delete picture and label. The
same command does not write again what is there or was deleted; it renews this page. Frames in
<code>lost.csv</code> are outside the set.</p>
";
