//! The epochs as a picture.

use super::table::Table;
use anyhow::Result;
use realnet::{
    Frame,
    eval::plot::{Panel, Series, history_plot},
};
use realnet_train::trainer::EpochReport;

/// Losses, figures and the learning rate over the epochs.
pub(super) fn draw(table: &Table, history: &[EpochReport]) -> Result<Frame> {
    let series = |values: &dyn Fn(&EpochReport) -> Vec<(String, f64)>| -> Vec<Series> {
        let names = history.first().map(values).unwrap_or_default();
        let names = names.into_iter().enumerate();
        names
            .map(|(index, (name, _))| Series {
                name,
                points: history
                    .iter()
                    .filter_map(|report| {
                        Some(((report.epoch + 1) as f64, values(report).get(index)?.1))
                    })
                    .collect(),
            })
            .collect()
    };
    // Each part of the loss has its own size.
    let mut panels: Vec<Panel> = series(&|report| table.losses(report))
        .into_iter()
        .map(|series| Panel { title: series.name.clone(), series: vec![series] })
        .collect();
    panels.push(Panel {
        title: "validation".to_owned(),
        series: series(&|report| report.validation.figures.clone()),
    });
    panels.push(Panel {
        title: "learning rate".to_owned(),
        series: series(&|report| vec![("lr".to_owned(), report.lr)]),
    });
    Ok(history_plot("epoch", &panels)?)
}
