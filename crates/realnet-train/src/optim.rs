//! What moves the weights: optimisers with groups, schedules, clipping, averaging.

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param, ParamGroup};
use burn::optim::decay::WeightDecayConfig;
use burn::optim::momentum::MomentumConfig;
use burn::optim::{AdamWConfig, GradientsParams, ModuleOptimizer, SgdConfig};
use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};
use std::any::Any;
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// How gradients become steps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Optimizer {
    /// Stochastic gradient descent with Nesterov's momentum.
    Sgd {
        /// Share of the last step in the next one.
        momentum: f64,
    },
    /// Adam with decoupled weight decay (Loshchilov and Hutter, 2019).
    AdamW {
        /// Decay of the mean of the gradients.
        beta_1: f32,
        /// Decay of the mean of their squares.
        beta_2: f32,
    },
}

impl Optimizer {
    /// Ready to step. `weight_decay` holds for the weights of convolutions alone: biases and
    /// the parameters of batch normalisation do not decay.
    #[must_use]
    pub fn init(self, weight_decay: f32) -> ModuleOptimizer {
        let weights = ParamGroup::from_regex(r"(^|\.)weight$").ok();
        match self {
            Self::Sgd { momentum } => {
                // The framework's dampening is not PyTorch's by default.
                let momentum = MomentumConfig::new()
                    .with_momentum(momentum)
                    .with_dampening(0.0)
                    .with_nesterov(true);
                let base = SgdConfig::new().with_momentum(Some(momentum));
                let decay = WeightDecayConfig::new(weight_decay);
                let decayed = base.clone().with_weight_decay(Some(decay)).build();
                let all = base.init();
                match weights {
                    Some(weights) => all.with_group(weights, decayed, None),
                    None => all,
                }
            }
            Self::AdamW { beta_1, beta_2 } => {
                let base = AdamWConfig::new()
                    .with_beta_1(beta_1)
                    .with_beta_2(beta_2)
                    .with_epsilon(1e-8)
                    .with_weight_decay(0.0);
                let decayed = base.clone().with_weight_decay(weight_decay).build();
                let all = base.init();
                match weights {
                    Some(weights) => all.with_group(weights, decayed, None),
                    None => all,
                }
            }
        }
    }
}

/// The learning rate's way from its first to its last value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Schedule {
    /// Along half a cosine.
    Cosine,
    /// Along a line.
    Linear,
    /// A tenth at two thirds and again at eight ninths.
    Step,
}

impl Schedule {
    /// The factor of the learning rate after the share `done` of the training, from 1 at 0 to
    /// `last` at 1.
    #[must_use]
    pub fn factor(self, done: f64, last: f64) -> f64 {
        let done = done.clamp(0.0, 1.0);
        match self {
            Self::Cosine => (1.0 - (done * PI).cos()) / 2.0 * (last - 1.0) + 1.0,
            Self::Linear => (1.0 - done) * (1.0 - last) + last,
            Self::Step if done < 2.0 / 3.0 => 1.0,
            Self::Step if done < 8.0 / 9.0 => 0.1,
            Self::Step => 0.01,
        }
    }
}

/// Clips the gradients so that their norm, over all parameters together, is at most `limit`,
/// if that is above 0. The norm that they had.
pub fn clip_norm<M: Module>(module: &M, gradients: &mut GradientsParams, limit: f64) -> f64 {
    let mut squares = Squares { gradients, sum: 0.0 };
    module.visit(&mut squares);
    let norm = squares.sum.sqrt();
    if limit > 0.0 && norm > limit {
        module.visit(&mut Scaled { gradients, factor: limit / norm });
    }
    norm
}

struct Squares<'a> {
    gradients: &'a GradientsParams,
    sum: f64,
}

impl ModuleVisitor for Squares<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if let Some(gradient) = self.gradients.get::<D>(param.id) {
            self.sum += gradient.square().sum().into_scalar::<f64>();
        }
    }
}

struct Scaled<'a> {
    gradients: &'a mut GradientsParams,
    factor: f64,
}

impl ModuleVisitor for Scaled<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if let Some(gradient) = self.gradients.remove::<D>(param.id) {
            self.gradients.register(param.id, gradient.mul_scalar(self.factor));
        }
    }
}

/// Exponential moving average of a model's weights and statistics, whose decay grows with
/// the number of updates: `decay · (1 - exp(-updates / ramp))`.
#[derive(Clone, Debug)]
pub struct Ema<M: Module> {
    model: M,
    updates: u64,
    decay: f64,
    ramp: f64,
}

impl<M: Module> Ema<M> {
    /// Begins with `model`, as [`Module::valid`] gives it, after `updates`.
    #[must_use]
    pub const fn new(model: M, updates: u64, decay: f64, ramp: f64) -> Self {
        Self { model, updates, decay, ramp }
    }

    /// The average.
    #[must_use]
    pub const fn model(&self) -> &M {
        &self.model
    }

    /// Updates so far.
    #[must_use]
    pub const fn updates(&self) -> u64 {
        self.updates
    }

    /// Moves towards `model`, as [`Module::valid`] gives it.
    pub fn update(&mut self, model: &M) {
        self.updates += 1;
        let decay = self.decay * (1.0 - (-(self.updates as f64) / self.ramp).exp());
        let mut found = Found { path: Vec::new(), tensors: BTreeMap::new() };
        model.visit(&mut found);
        let mut towards = Towards { decay, path: Vec::new(), tensors: found.tensors };
        self.model = self.model.clone().map(&mut towards);
    }
}

struct Found {
    path: Vec<String>,
    tensors: BTreeMap<String, Box<dyn Any>>,
}

impl ModuleVisitor for Found {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        self.tensors.insert(self.path.join("."), Box::new(param.val()));
    }
}

struct Towards {
    decay: f64,
    path: Vec<String>,
    tensors: BTreeMap<String, Box<dyn Any>>,
}

impl ModuleMapper for Towards {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }

    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let found = self.tensors.remove(&self.path.join("."));
        let Some(new) = found.and_then(|tensor| tensor.downcast::<Tensor<D>>().ok()) else {
            return param;
        };
        let decay = self.decay;
        param.map(|old| old.mul_scalar(decay) + new.mul_scalar(1.0 - decay))
    }
}
