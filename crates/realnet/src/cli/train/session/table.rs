//! The figures of the epochs: as lines, as objects, as `results.csv`.

use realnet_train::trainer::EpochReport;
use serde_json::{Map, Value};

/// Names of the columns, and how epochs become rows of them.
pub(super) struct Table {
    parts: &'static [&'static str],
    epochs: usize,
}

impl Table {
    /// For a loss of these parts and this many epochs.
    pub(super) const fn new(parts: &'static [&'static str], epochs: usize) -> Self {
        Self { parts, epochs }
    }

    /// Epochs of the whole training.
    pub(super) const fn epochs(&self) -> usize {
        self.epochs
    }

    /// Names and values of the loss and its parts.
    pub(super) fn losses(&self, report: &EpochReport) -> Vec<(String, f64)> {
        let parts = self.parts.iter().map(|name| (*name).to_owned()).zip(report.parts.clone());
        [("loss".to_owned(), report.loss)].into_iter().chain(parts).collect()
    }

    /// All columns between the epoch and the last ones.
    fn columns(&self, report: &EpochReport) -> Vec<(String, f64)> {
        let mut columns = self.losses(report);
        columns.push(("lr".to_owned(), report.lr));
        columns.extend(report.validation.figures.iter().cloned());
        columns
    }

    /// The names above the rows.
    pub(super) fn head(&self, report: &EpochReport) -> String {
        let names = self.columns(report);
        let names = names.iter().map(|(name, _)| format!(" {name:>9}")).collect::<String>();
        format!("{:>11}{names}   seconds", "epoch")
    }

    /// An epoch for people.
    pub(super) fn row(&self, report: &EpochReport, seconds: f64) -> String {
        let epoch = format!("{}/{}", report.epoch + 1, self.epochs);
        let values = self.columns(report);
        let values = values.iter().map(|(_, value)| {
            let small = *value != 0.0 && value.abs() < 0.01;
            if small { format!(" {value:>9.2e}") } else { format!(" {value:>9.4}") }
        });
        let best = if report.best { "  best" } else { "" };
        format!("{epoch:>11}{} {seconds:>9.1}{best}", values.collect::<String>())
    }

    /// An epoch for programs.
    pub(super) fn object(&self, report: &EpochReport, seconds: f64) -> Map<String, Value> {
        let mut object = Map::new();
        object.insert("epoch".to_owned(), (report.epoch + 1).into());
        object.insert("epochs".to_owned(), self.epochs.into());
        for (name, value) in self.columns(report) {
            object.insert(name, value.into());
        }
        object.insert("fitness".to_owned(), report.validation.fitness.into());
        object.insert("best".to_owned(), report.best.into());
        object.insert("seconds".to_owned(), ((seconds * 1e3).round() / 1e3).into());
        object
    }

    /// All epochs as a table of commas. Nothing of it depends on the time that they took, so
    /// that a run that went on has the same one.
    pub(super) fn csv(&self, history: &[EpochReport]) -> String {
        let mut text = String::new();
        for (index, report) in history.iter().enumerate() {
            let columns = self.columns(report);
            if index == 0 {
                let names: String = columns.iter().map(|(name, _)| format!(",{name}")).collect();
                text = format!("epoch{names},fitness,best\n");
            }
            let values: String = columns.iter().map(|(_, value)| format!(",{value}")).collect();
            let (fitness, best) = (report.validation.fitness, u8::from(report.best));
            text += &format!("{}{values},{fitness},{best}\n", report.epoch + 1);
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_train::trainer::Figures;

    fn report(epoch: usize, best: bool) -> EpochReport {
        let figures = vec![("mAP50".to_owned(), 0.25 * epoch as f64)];
        let validation = Figures { figures, fitness: 0.1 };
        EpochReport { epoch, loss: 1.5, parts: vec![1.0, 0.5], lr: 0.01, validation, best }
    }

    #[test]
    fn rows_have_the_columns_of_the_head() {
        let table = Table::new(&["box", "obj"], 10);
        let csv = table.csv(&[report(0, true), report(1, false)]);
        assert_eq!(
            csv,
            "epoch,loss,box,obj,lr,mAP50,fitness,best\n1,1.5,1,0.5,0.01,0,0.1,1\n\
             2,1.5,1,0.5,0.01,0.25,0.1,0\n"
        );
        let report = report(1, true);
        let (head, row) = (table.head(&report), table.row(&report, 2.5));
        assert_eq!(head.len() + "  best".len(), row.len(), "\n{head}\n{row}");
        assert_eq!(head.split_whitespace().count() + 1, row.split_whitespace().count());
        let object = serde_json::to_string(&table.object(&report, 2.5)).unwrap();
        assert_eq!(
            object,
            r#"{"epoch":2,"epochs":10,"loss":1.5,"box":1.0,"obj":0.5,"lr":0.01,"mAP50":0.25,"fitness":0.1,"best":true,"seconds":2.5}"#
        );
    }
}
