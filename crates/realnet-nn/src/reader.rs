//! Reads the convolutions of a network from named tensors: checks names, shapes and values,
//! and folds batch normalisation.

use crate::{
    fold::{BatchNorm, fold},
    layer::{Activation, Conv},
    weights::{Checkpoint, Tensor},
};
use std::collections::BTreeSet;
use thiserror::Error;

/// A tensor that does not fit the network it was read for.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum TensorError {
    /// A tensor is missing.
    #[error("tensor '{name}' is missing")]
    Missing {
        /// Its name.
        name: String,
    },
    /// Tensors that no layer uses.
    #[error("{count} tensors belong to no layer of the network, first '{name}'")]
    Surplus {
        /// Name of the first.
        name: String,
        /// How many.
        count: usize,
    },
    /// A tensor of a wrong shape.
    #[error("tensor '{name}' has shape {found:?}, expected {expected}")]
    Shape {
        /// Its name.
        name: String,
        /// What fits.
        expected: String,
        /// What was found.
        found: Vec<usize>,
    },
    /// A tensor with NaN or infinite elements, or a negative variance.
    #[error("tensor '{name}' holds {what}")]
    Value {
        /// Its name.
        name: String,
        /// What it holds.
        what: &'static str,
    },
}

/// The numbers of a convolution that its weights do not tell.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Numbers {
    pub kernel: usize,
    pub stride: usize,
    pub dilation: usize,
    pub activation: Activation,
}

impl Numbers {
    /// One pixel.
    pub(crate) const POINT: Self =
        Self { kernel: 1, stride: 1, dilation: 1, activation: Activation::Identity };
    /// Three by three.
    pub(crate) const THREE: Self = Self { kernel: 3, ..Self::POINT };
    /// Three by three at every second pixel.
    pub(crate) const HALVE: Self = Self { stride: 2, ..Self::THREE };

    pub(crate) const fn then(self, activation: Activation) -> Self {
        Self { activation, ..self }
    }

    pub(crate) const fn dilated(self, dilation: usize) -> Self {
        Self { dilation, ..self }
    }
}

/// Reads tensors by name and remembers which were asked for.
pub(crate) struct Reader<'a> {
    checkpoint: &'a Checkpoint,
    /// What stands before all names.
    prefix: &'static str,
    used: BTreeSet<String>,
}

impl<'a> Reader<'a> {
    pub(crate) fn new(checkpoint: &'a Checkpoint, prefix: &'static str) -> Self {
        Self { checkpoint, prefix, used: BTreeSet::new() }
    }

    /// Whether there is a tensor of this name.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.checkpoint.tensors.contains_key(&self.full(name))
    }

    /// The weights at `path`, of `out` channels where that is known, from
    /// `input` channels a group. Without bias, padded to keep the size.
    pub(crate) fn conv(
        &mut self,
        path: &str,
        out: Option<usize>,
        input: usize,
        numbers: Numbers,
    ) -> Result<Conv, TensorError> {
        let Numbers { kernel, stride, dilation, activation } = numbers;
        let name = format!("{path}.weight");
        let tensor = self.tensor(&name)?;
        let channels = match tensor.shape() {
            &[o, i, h, w] if (i, h, w) == (input, kernel, kernel) && o > 0 => Some(o),
            _ => None,
        };
        let Some(channels) = channels.filter(|&o| out.is_none_or(|out| out == o)) else {
            let out = out.map_or_else(|| "out".to_owned(), |out| out.to_string());
            let expected = format!("[{out}, {input}, {kernel}, {kernel}]");
            return Err(self.shape_error(&name, expected, tensor.shape()));
        };
        Ok(Conv {
            shape: [channels, input, kernel, kernel],
            weight: tensor.data().to_vec(),
            bias: vec![0.0; channels],
            stride,
            pad: dilation * (kernel / 2),
            dilation,
            groups: 1,
            activation,
        })
    }

    /// `conv` with the bias at `path`.
    pub(crate) fn biased(&mut self, conv: Conv, path: &str) -> Result<Conv, TensorError> {
        let bias = self.list(&format!("{path}.bias"), conv.out())?.to_vec();
        Ok(Conv { bias, ..conv })
    }

    /// `conv` with the normalisation at `path` folded in.
    pub(crate) fn normalised(
        &mut self,
        conv: Conv,
        path: &str,
        eps: f64,
    ) -> Result<Conv, TensorError> {
        let channels = conv.out();
        let mut part = |part: &str| self.list(&format!("{path}.{part}"), channels);
        let (weight, bias) = (part("weight")?, part("bias")?);
        let (mean, var) = (part("running_mean")?, part("running_var")?);
        if var.iter().any(|&v| v < 0.0) {
            let name = self.full(&format!("{path}.running_var"));
            return Err(TensorError::Value { name, what: "a negative variance" });
        }
        let bn = BatchNorm { weight, bias, mean, var, eps };
        let (weight, bias) = fold(&conv.weight, Some(&conv.bias), &bn);
        if !weight.iter().chain(&bias).all(|x| x.is_finite()) {
            let name = self.full(&format!("{path}.weight"));
            return Err(TensorError::Value { name, what: "NaN or infinity after folding" });
        }
        Ok(Conv { weight, bias, ..conv })
    }

    /// A tensor of one axis.
    fn list(&mut self, name: &str, length: usize) -> Result<&'a [f32], TensorError> {
        let tensor = self.tensor(name)?;
        if tensor.shape() != [length] {
            return Err(self.shape_error(name, format!("[{length}]"), tensor.shape()));
        }
        Ok(tensor.data())
    }

    fn tensor(&mut self, name: &str) -> Result<&'a Tensor, TensorError> {
        let name = self.full(name);
        let Some(tensor) = self.checkpoint.tensors.get(&name) else {
            return Err(TensorError::Missing { name });
        };
        if !tensor.data().iter().all(|x| x.is_finite()) {
            return Err(TensorError::Value { name, what: "NaN or infinity" });
        }
        self.used.insert(name);
        Ok(tensor)
    }

    fn full(&self, name: &str) -> String {
        format!("{}{name}", self.prefix)
    }

    /// That the tensor `name` has not the shape that fits.
    pub(crate) fn shape_error(&self, name: &str, expected: String, found: &[usize]) -> TensorError {
        TensorError::Shape { name: self.full(name), expected, found: found.to_vec() }
    }

    /// Whether all tensors were read.
    pub(crate) fn check_surplus(&self) -> Result<(), TensorError> {
        let mut surplus = self.checkpoint.tensors.keys().filter(|n| !self.used.contains(*n));
        match surplus.next() {
            None => Ok(()),
            Some(first) => {
                Err(TensorError::Surplus { name: first.clone(), count: surplus.count() + 1 })
            }
        }
    }
}
