//! Detection.

use crate::export::{ExportNetworkError, detector_onnx};
use crate::loss::{DetectionLoss, Target};
use crate::nets::YoloV5;
use crate::trainer::{Figures, Loss, Task};
use burn::tensor::{Device, Tensor, TensorData};
use realnet_core::Detection;
use realnet_data::{
    DataError, DetectionBatch, DetectionSamples, DetectionSet, Loader, SampleError,
};
use realnet_eval::{CocoOptions, EvalError, GroundTruth, Prediction, evaluate};
use realnet_io::picture::{self, PictureError};
use realnet_nn::detector::{DetectError, Detector, DetectorModel, DetectorOptions, ModelError};
use realnet_nn::engine::Runtime;
use realnet_nn::onnx::OnnxOptions;
use std::sync::Arc;
use thiserror::Error;

/// What can go wrong with detection data or a detector.
#[derive(Debug, Error)]
pub enum DetectionTaskError {
    /// The data.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The network as a file.
    #[error(transparent)]
    Export(#[from] ExportNetworkError),
    /// That file as a detector.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The detector at work.
    #[error(transparent)]
    Detect(#[from] DetectError),
    /// A picture of the validation.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// One that was given in memory.
    #[error(transparent)]
    Sample(#[from] SampleError),
    /// The figures.
    #[error(transparent)]
    Eval(#[from] EvalError),
}

/// A detector learned from labelled pictures, and judged on others as it will be used: as an
/// ONNX file, by an engine at run time, with the letterbox and suppression of there.
pub struct DetectionTask {
    loader: Loader<DetectionSamples>,
    loss: DetectionLoss,
    validation: Arc<DetectionSet>,
    runtime: Runtime,
}

impl DetectionTask {
    /// Learns from the samples of `loader` with `loss`; `validation` is looked at after each
    /// epoch.
    #[must_use]
    pub const fn new(
        loader: Loader<DetectionSamples>,
        loss: DetectionLoss,
        validation: Arc<DetectionSet>,
        runtime: Runtime,
    ) -> Self {
        Self { loader, loss, validation, runtime }
    }

    /// The loader, for its failures.
    #[must_use]
    pub const fn loader(&self) -> &Loader<DetectionSamples> {
        &self.loader
    }
}

/// The figure by which the best network is chosen: a tenth of mAP50 and nine of mAP50-95.
#[must_use]
pub fn fitness(map50: f64, map: f64) -> f64 {
    0.1 * map50 + 0.9 * map
}

impl Task for DetectionTask {
    type Model = YoloV5;
    type Batch = DetectionBatch;
    type Error = DetectionTaskError;

    const PARTS: &'static [&'static str] = &["box", "obj", "cls"];

    fn batches(
        &self,
        epoch: usize,
        first: usize,
    ) -> Result<impl Iterator<Item = Result<DetectionBatch, DetectionTaskError>>, DetectionTaskError>
    {
        let epoch = u32::try_from(epoch).unwrap_or(u32::MAX);
        Ok(self.loader.epoch_from(epoch, first).map(|batch| {
            batch.map(|samples| DetectionBatch::collate(&samples)).map_err(Into::into)
        }))
    }

    fn steps(&self) -> usize {
        self.loader.batches()
    }

    fn loss(&self, model: &YoloV5, batch: DetectionBatch, device: &Device) -> Loss {
        let side = batch.size as usize;
        let targets: Vec<Target> = batch
            .targets
            .iter()
            .map(|&[place, class, cx, cy, w, h]| Target {
                image: place as usize,
                class: class as usize,
                bbox: [cx, cy, w, h],
            })
            .collect();
        let data = TensorData::new(batch.images, [batch.count, 3, side, side]);
        let parts = self.loss.of(model.forward(Tensor::from_data(data, device)), &targets);
        let samples = batch.count;
        let count = samples.max(1) as f32;
        let values = [&parts.boxes, &parts.objectness, &parts.classes];
        let values = values.map(|part| part.clone().into_scalar::<f32>() / count);
        Loss { total: parts.total(), parts: values.to_vec(), samples }
    }

    fn validate(&self, model: &YoloV5) -> Result<Figures, DetectionTaskError> {
        let side = self.validation.size();
        let options = OnnxOptions { width: side as usize, height: side as usize, half: false };
        let file = detector_onnx(model, self.validation.names(), &options)?;
        let network = DetectorModel::from_vec("the network in training", file)?;
        // Weak boxes too: the curve needs them.
        let options = DetectorOptions {
            confidence: 0.001,
            iou: 0.6,
            max_det: 300,
            multi_label: self.validation.names().len() > 1,
            ..Default::default()
        };
        let mut detector = Detector::new(network, &self.runtime, options)?;
        let (mut truth, mut found) = (Vec::new(), Vec::new());
        for (image_id, (index, image)) in (0..).zip(self.validation.images().iter().enumerate()) {
            // Pictures given in memory are there in the size of the network alone.
            let frame = if image.path.as_os_str().is_empty() {
                self.validation.frame(index).map(Arc::unwrap_or_clone)?
            } else {
                picture::read(&image.path)?
            };
            let (width, height) = (frame.width() as f32, frame.height() as f32);
            truth.extend(image.targets.iter().map(|target| {
                GroundTruth::new(image_id, target.class_id, target.to_pixels(width, height))
            }));
            found.extend(detector.detect(&frame)?.iter().map(|detection| {
                let Detection { class_id, confidence, bbox, .. } = *detection;
                Prediction { image_id, category: class_id, bbox, confidence }
            }));
        }
        let summary = evaluate(&truth, &found, &CocoOptions::default())?;
        let (map50, map) = (summary.ap50.unwrap_or(0.0), summary.ap.unwrap_or(0.0));
        let figures = vec![("mAP50".to_owned(), map50), ("mAP50-95".to_owned(), map)];
        Ok(Figures { figures, fitness: fitness(map50, map) })
    }
}
