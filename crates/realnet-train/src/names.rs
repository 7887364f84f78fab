//! Parameters by the names that PyTorch gives them: weights in and out.

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Tensor, TensorData};
use realnet_nn::weights;
use std::collections::BTreeMap;
use thiserror::Error;

/// Tensors by name.
pub type Tensors = BTreeMap<String, weights::Tensor>;

/// Why weights cannot be taken over.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum NamesError {
    /// Nothing in the file fits the network.
    #[error("none of the {given} tensors fits the network, which has '{wanted}', for example")]
    Nothing {
        /// Tensors given.
        given: usize,
        /// A name of the network.
        wanted: String,
    },
    /// A tensor that the network needs is not there.
    #[error("the weights have no '{name}' (shape {shape:?}); {missing} are missing in all")]
    Missing {
        /// Name of the first one.
        name: String,
        /// Its shape.
        shape: Vec<usize>,
        /// How many are missing.
        missing: usize,
    },
    /// A tensor has another shape.
    #[error("'{name}' has shape {found:?}, the network has {expected:?}")]
    Shape {
        /// Its name.
        name: String,
        /// In the weights.
        found: Vec<usize>,
        /// In the network.
        expected: Vec<usize>,
    },
    /// A tensor of the network could not be read.
    #[error("'{name}' cannot be read: {reason}")]
    Read {
        /// Its name.
        name: String,
        /// What the framework says.
        reason: String,
    },
}

/// What became of weights that were given to a network.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Taken {
    /// Tensors that were taken over.
    pub taken: usize,
    /// Those of the network that were not given: they stay as they were.
    pub missing: Vec<String>,
    /// Those that have another shape in the network: a head for other classes, say. They
    /// stay as they were.
    pub reshaped: Vec<String>,
    /// Those given that the network does not have.
    pub unused: Vec<String>,
}

impl Taken {
    /// Whether every tensor of the network was given.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.missing.is_empty() && self.reshaped.is_empty()
    }
}

/// Whether what is entered is a part of names: the variants of an enumeration, one module in
/// different forms, are none.
fn is_named(container: &str) -> bool {
    !container.starts_with("Enum:")
}

/// The name of PyTorch's modules for a path of ours: `l13.m.0.cv1.bn.gamma` is
/// `model.13.m.0.cv1.bn.weight`.
#[must_use]
pub fn pytorch_name(path: &[String]) -> String {
    let mut parts: Vec<String> = Vec::with_capacity(path.len() + 1);
    for (index, part) in path.iter().enumerate() {
        // Layers of YOLOv5; a letter behind the number tells forms of one apart.
        let layer = part.strip_prefix('l').map(|rest| rest.trim_end_matches(['c', 'f', 's']));
        match (index, layer.and_then(|number| number.parse::<usize>().ok()), part.as_str()) {
            (0, Some(number), _) => parts.extend(["model".to_owned(), number.to_string()]),
            (_, _, "gamma") => parts.push("weight".to_owned()),
            (_, _, "beta") => parts.push("bias".to_owned()),
            _ => parts.push(part.clone()),
        }
    }
    parts.join(".")
}

/// All tensors of a module by name, the running statistics of batch normalisation among
/// them. Statistics that wait for an update in a training module are missed: give what
/// [`Module::valid`] gives.
///
/// # Errors
/// [`NamesError::Read`] when the device does not give the numbers.
pub fn tensors<M: Module>(module: &M) -> Result<Tensors, NamesError> {
    let mut reader = Reader { path: Vec::new(), tensors: Tensors::new(), error: None };
    module.visit(&mut reader);
    reader.error.map_or(Ok(reader.tensors), Err)
}

struct Reader {
    path: Vec<String>,
    tensors: Tensors,
    error: Option<NamesError>,
}

impl ModuleVisitor for Reader {
    fn enter_module(&mut self, name: &str, container: &str) {
        if is_named(container) {
            self.path.push(name.to_owned());
        }
    }

    fn exit_module(&mut self, _: &str, container: &str) {
        if is_named(container) {
            self.path.pop();
        }
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let name = pytorch_name(&self.path);
        let data = param.val().into_data();
        let shape = data.shape().to_vec();
        match data.try_to_vec::<f32>() {
            Ok(values) => {
                if let Some(tensor) = weights::Tensor::new(shape, values) {
                    self.tensors.insert(name, tensor);
                }
            }
            Err(error) => {
                self.error = Some(NamesError::Read { name, reason: format!("{error:?}") })
            }
        }
    }
}

/// Gives a module these tensors, as far as names and shapes fit.
///
/// # Errors
/// [`NamesError::Nothing`] when not one fits.
pub fn take<M: Module>(module: M, tensors: &Tensors) -> Result<(M, Taken), NamesError> {
    let mut writer =
        Writer { path: Vec::new(), tensors, taken: Taken::default(), seen: Vec::new() };
    let module = module.map(&mut writer);
    let Writer { mut taken, seen, .. } = writer;
    if taken.taken == 0 {
        let wanted = seen.into_iter().next().unwrap_or_default();
        return Err(NamesError::Nothing { given: tensors.len(), wanted });
    }
    let seen: std::collections::BTreeSet<String> = seen.into_iter().collect();
    taken.unused = tensors.keys().filter(|name| !seen.contains(*name)).cloned().collect();
    Ok((module, taken))
}

/// Gives a module exactly these tensors.
///
/// # Errors
/// [`NamesError`] names the first that is missing or of another shape.
pub fn take_all<M: Module>(module: M, tensors: &Tensors) -> Result<M, NamesError> {
    let own = self::tensors(&module)?;
    for (name, tensor) in &own {
        let expected = tensor.shape().to_vec();
        match tensors.get(name) {
            None => {
                let missing = own.keys().filter(|name| !tensors.contains_key(*name)).count();
                return Err(NamesError::Missing { name: name.clone(), shape: expected, missing });
            }
            Some(given) if given.shape() != tensor.shape() => {
                let found = given.shape().to_vec();
                return Err(NamesError::Shape { name: name.clone(), found, expected });
            }
            Some(_) => {}
        }
    }
    take(module, tensors).map(|(module, _)| module)
}

struct Writer<'a> {
    path: Vec<String>,
    tensors: &'a Tensors,
    taken: Taken,
    seen: Vec<String>,
}

impl ModuleMapper for Writer<'_> {
    fn enter_module(&mut self, name: &str, container: &str) {
        if is_named(container) {
            self.path.push(name.to_owned());
        }
    }

    fn exit_module(&mut self, _: &str, container: &str) {
        if is_named(container) {
            self.path.pop();
        }
    }

    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let name = pytorch_name(&self.path);
        self.seen.push(name.clone());
        let shape = param.lazy_shape().to_vec();
        match self.tensors.get(&name) {
            None => self.taken.missing.push(name),
            Some(given) if given.shape() != shape.as_slice() => self.taken.reshaped.push(name),
            Some(given) => {
                self.taken.taken += 1;
                let data = TensorData::new(given.data().to_vec(), shape);
                let tensor = Tensor::<D>::from_data(data, &param.lazy_device());
                let id = param.id;
                return param.transform_for_load(tensor, id);
            }
        }
        param
    }
}

#[cfg(test)]
mod tests {
    use super::pytorch_name;

    fn name(path: &str) -> String {
        pytorch_name(&path.split('.').map(str::to_owned).collect::<Vec<_>>())
    }

    #[test]
    fn names_are_those_of_the_reference() {
        for (ours, theirs) in [
            ("l0.conv.weight", "model.0.conv.weight"),
            ("l0.bn.gamma", "model.0.bn.weight"),
            ("l0f.conv.bn.running_mean", "model.0.conv.bn.running_mean"),
            ("l13.m.0.cv1.bn.beta", "model.13.m.0.cv1.bn.bias"),
            ("l9s.cv2.bn.running_var", "model.9.cv2.bn.running_var"),
            ("l24.m.2.bias", "model.24.m.2.bias"),
            ("stages.0.1.c1.conv.weight", "stages.0.1.c1.conv.weight"),
        ] {
            assert_eq!(name(ours), theirs);
        }
    }
}
