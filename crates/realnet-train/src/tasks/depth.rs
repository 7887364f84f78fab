//! Depth.

use crate::loss::DepthLoss;
use crate::loss::depth::DepthTruth;
use crate::nets::DepthNet;
use crate::trainer::{Figures, Loss, Task};
use burn::tensor::module::interpolate;
use burn::tensor::ops::{InterpolateMode, InterpolateOptions};
use burn::tensor::{Device, Tensor, TensorData};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use realnet_core::{DepthMap, DepthMapError, Stamp};
use realnet_data::{DataError, DepthBatch, DepthSamples, Loader};
use realnet_eval::{DepthEvalError, DepthMetrics, DepthProtocol};
use std::marker::PhantomData;
use thiserror::Error;

/// What can go wrong with depth data.
#[derive(Debug, Error)]
pub enum DepthTaskError {
    /// The data.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A map of the validation.
    #[error(transparent)]
    Map(#[from] DepthMapError),
    /// The figures.
    #[error(transparent)]
    Eval(#[from] DepthEvalError),
    /// No picture of the validation has a depth inside the protocol's range.
    #[error("no true depth of the validation set is inside {min} to {max} m")]
    NothingCompared {
        /// Lower end, metres.
        min: f64,
        /// Upper end, metres.
        max: f64,
    },
}

/// Samples of one step, and what the triangles of the virtual normals are drawn from.
#[derive(Clone, Debug)]
pub struct DepthStep {
    /// The samples.
    pub batch: DepthBatch,
    /// Seed of the draw.
    pub seed: u64,
}

/// A depth network learned from pictures with depth, and judged on others, letterboxed as at
/// run time and compared in the network's input, in metres of each picture's own camera.
pub struct DepthTask<N> {
    loader: Loader<DepthSamples>,
    loss: DepthLoss,
    validation: Loader<DepthSamples>,
    protocol: DepthProtocol,
    seed: u64,
    net: PhantomData<fn() -> N>,
}

impl<N> DepthTask<N> {
    /// Learns from the samples of `loader` with `loss`; those of `validation`, which are to
    /// come in the order of their set, are compared by `protocol` after each epoch. Triangles
    /// are drawn by `seed`.
    ///
    /// # Errors
    /// [`DepthTaskError::Eval`] for a protocol whose range holds nothing.
    pub fn new(
        loader: Loader<DepthSamples>,
        loss: DepthLoss,
        validation: Loader<DepthSamples>,
        protocol: DepthProtocol,
        seed: u64,
    ) -> Result<Self, DepthTaskError> {
        DepthMetrics::new(protocol.clone())?;
        Ok(Self { loader, loss, validation, protocol, seed, net: PhantomData })
    }

    /// The loader, for its failures.
    #[must_use]
    pub const fn loader(&self) -> &Loader<DepthSamples> {
        &self.loader
    }

    /// The loader of the validation, for its failures.
    #[must_use]
    pub const fn validation(&self) -> &Loader<DepthSamples> {
        &self.validation
    }
}

/// What is to be learned of a batch by a network whose logits have `rows` and `columns`:
/// blocks of pixels have the median of their known depths, and the ray of their middle.
#[must_use]
pub fn truth(batch: &DepthBatch, [rows, columns]: [usize; 2]) -> DepthTruth {
    let (width, height) = (batch.width as usize, batch.height as usize);
    let [down, across] = [height / rows.max(1), width / columns.max(1)].map(|step| step.max(1));
    let pixels = rows * columns;
    let mut truth = DepthTruth {
        images: batch.count,
        size: [rows, columns],
        depths: Vec::with_capacity(batch.count * pixels),
        rays: Vec::with_capacity(batch.count * pixels),
        metres_per_unit: batch.metres_per_unit.clone(),
    };
    let mut known = Vec::with_capacity(down * across);
    for (depths, camera) in batch.depths.chunks_exact((width * height).max(1)).zip(&batch.cameras) {
        for row in 0..rows {
            for column in 0..columns {
                known.clear();
                for line in depths.chunks_exact(width).skip(row * down).take(down) {
                    let block = line.iter().skip(column * across).take(across);
                    known.extend(block.filter(|depth| DepthMap::is_known(**depth)));
                }
                known.sort_unstable_by(f32::total_cmp);
                truth.depths.push(known.get(known.len() / 2).copied().unwrap_or(0.0));
                let middle =
                    |index: usize, step: usize| (index * step) as f64 + (step as f64 - 1.0) / 2.0;
                truth.rays.push([
                    ((middle(column, across) - camera.cx) / camera.fx) as f32,
                    ((middle(row, down) - camera.cy) / camera.fy) as f32,
                ]);
            }
        }
    }
    truth
}

fn images(batch: &mut DepthBatch, device: &Device) -> Tensor<4> {
    let shape = [batch.count, 3, batch.height as usize, batch.width as usize];
    Tensor::from_data(TensorData::new(std::mem::take(&mut batch.images), shape), device)
}

impl<N: DepthNet> Task for DepthTask<N> {
    type Model = N;
    type Batch = DepthStep;
    type Error = DepthTaskError;

    const IS_MEAN: bool = true;
    const PARTS: &'static [&'static str] = &["wce", "normals"];

    fn batches(
        &self,
        epoch: usize,
        first: usize,
    ) -> Result<impl Iterator<Item = Result<DepthStep, DepthTaskError>>, DepthTaskError> {
        let number = u32::try_from(epoch).unwrap_or(u32::MAX);
        let start = ((epoch as u64) << 32) + first as u64;
        Ok(self.loader.epoch_from(number, first).zip(start..).map(|(samples, step)| {
            let seed = self.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ step;
            Ok(DepthStep { batch: DepthBatch::collate(&samples?), seed })
        }))
    }

    fn steps(&self) -> usize {
        self.loader.batches()
    }

    fn loss(&self, model: &N, step: DepthStep, device: &Device) -> Loss {
        let DepthStep { mut batch, seed } = step;
        let logits = model.logits(images(&mut batch, device));
        let [_, _, rows, columns] = logits.dims();
        let truth = truth(&batch, [rows, columns]);
        let mut dice = Pcg64Mcg::seed_from_u64(seed);
        let triplets = self.loss.draw(&truth, |below| dice.random_range(0..below.max(1)));
        let (total, parts) = self.loss.of(logits, &truth, &triplets);
        let parts = parts.map(Tensor::into_scalar::<f32>).to_vec();
        Loss { total, parts, samples: batch.count }
    }

    fn validate(&self, model: &N) -> Result<Figures, DepthTaskError> {
        // A device without differentiation, as the model.
        let device = model.devices().into_iter().next().unwrap_or_default();
        let mut metrics = DepthMetrics::new(self.protocol.clone())?;
        for samples in self.validation.epoch(0) {
            let mut batch = DepthBatch::collate(&samples?);
            let (width, height) = (batch.width, batch.height);
            let depth = self.loss.depth(model.logits(images(&mut batch, &device)));
            let size = [height as usize, width as usize];
            let bilinear = InterpolateOptions::new(InterpolateMode::Bilinear);
            let depth =
                interpolate(depth, bilinear.with_align_corners(false).with_output_size(size));
            let found = depth.into_data().try_to_vec::<f32>().unwrap_or_default();
            let pixels = size[0] * size[1];
            let pictures = found.chunks_exact(pixels).zip(batch.depths.chunks_exact(pixels));
            for ((found, wanted), scale) in pictures.zip(&batch.metres_per_unit) {
                let map = |units: &[f32]| {
                    let metres = units.iter().map(|depth| depth * scale).collect();
                    DepthMap::new(Stamp::ZERO, width, height, metres)
                };
                metrics.add(&map(wanted)?, &map(found)?)?;
            }
        }
        let DepthProtocol { min_depth: min, max_depth: max, .. } = self.protocol;
        let errors =
            metrics.report().errors().ok_or(DepthTaskError::NothingCompared { min, max })?;
        let figures = [("abs_rel", errors.abs_rel), ("rmse", errors.rmse), ("d1", errors.d1)];
        let figures = figures.map(|(name, value)| (name.to_owned(), value)).to_vec();
        Ok(Figures { figures, fitness: -errors.abs_rel })
    }
}
