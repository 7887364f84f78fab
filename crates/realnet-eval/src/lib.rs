//! Figures of a detector: average precision by the COCO protocol, precision and
//! recall against confidence, the confusion matrix, a report and plots.

mod coco;
mod confusion;
mod curves;
mod index;
pub mod plot;
mod report;
mod types;

pub use coco::{AreaRange, ClassScore, CocoOptions, CocoSummary, evaluate};
pub use confusion::{ConfusionMatrix, ConfusionOptions, confusion_matrix};
pub use curves::{ClassCurves, ConfidenceCurves, OperatingPoint, confidence_curves};
pub use plot::PlotError;
pub use report::{ClassReport, Report};
pub use types::{EvalError, GroundTruth, Prediction};
