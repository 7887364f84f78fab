//! Figures of a detector (average precision by the COCO protocol, precision and
//! recall against confidence, the confusion matrix, a report and plots), of depth
//! maps and of camera motion.
//!
//! | function | what it gives |
//! |---|---|
//! | [`evaluate`] | [`CocoSummary`]: COCO's twelve numbers, scores of each category, precision curves |
//! | [`confidence_curves`] | [`ConfidenceCurves`]: precision, recall, F1 and the confidence of the best F1 |
//! | [`confusion_matrix`] | [`ConfusionMatrix`]: which category is taken for which |
//! | [`Report::new`] | [`Report`]: the figures of a validation run as JSON or as a table |
//! | [`plot`] | the curves and the matrix as pictures |
//! | [`DepthMetrics`] | [`DepthReport`]: errors of depth maps, with their protocol |
//! | [`relative_pose_error`] | [`RelativePoseReport`]: errors of camera motion |
//!
//! The figures of a detector take the same two slices, [`GroundTruth`] and
//! [`Prediction`]. Nothing here reads or writes files.
//!
//! ```
//! use realnet_core::BoundingBox;
//! use realnet_eval::{CocoOptions, GroundTruth, Prediction, Report};
//! use std::collections::BTreeMap;
//!
//! let bbox = BoundingBox::new(10.0, 10.0, 60.0, 40.0);
//! let truth = [GroundTruth::new(1, 2, bbox), GroundTruth::new(2, 2, bbox)];
//! let found = [Prediction { image_id: 1, category: 2, bbox, confidence: 0.9 }];
//!
//! let summary = realnet_eval::evaluate(&truth, &found, &CocoOptions::default())?;
//! let curves = realnet_eval::confidence_curves(&truth, &found, 0.5)?;
//! let names = BTreeMap::from([(2, "car".to_owned())]);
//! let report = Report::new(&summary, &curves, 2, &names);
//! assert_eq!((report.precision, report.recall), (Some(1.0), Some(0.5)));
//! assert!(report.table().starts_with("Class"));
//! # Ok::<(), realnet_eval::EvalError>(())
//! ```

mod coco;
mod confusion;
mod curves;
pub mod depth;
mod index;
mod normals;
pub mod odometry;
pub mod plot;
mod report;
mod types;

pub use coco::{AreaRange, ClassScore, CocoOptions, CocoSummary, evaluate};
pub use confusion::{ConfusionMatrix, ConfusionOptions, confusion_matrix};
pub use curves::{ClassCurves, ConfidenceCurves, OperatingPoint, confidence_curves};
pub use depth::{
    DepthCrop, DepthErrors, DepthEvalError, DepthMetrics, DepthProtocol, DepthReport, ImageDepth,
    Pooling, ScaleSpread,
};
pub use normals::{NormalErrors, NormalMetrics};
pub use odometry::{
    ErrorSummary, OdometryError, RelativePoseErrors, RelativePoseReport, relative_pose_error,
};
pub use plot::PlotError;
pub use report::{ClassReport, Report};
pub use types::{EvalError, GroundTruth, Prediction};
