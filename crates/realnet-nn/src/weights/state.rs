//! From the values of a pickle to a checkpoint: finds the network, walks its
//! modules and reads its tensors.

use std::collections::HashMap;

use super::pickle::{Id, Pickle, Value};
use super::storage::{Budget, Dtype, View};
use super::{Checkpoint, ModuleInfo, Tensor, WeightsError, normalise_name};

/// Deepest nesting of modules; YOLOv5 has 6.
const MAX_DEPTH: usize = 64;
/// Most modules walked; YOLOv5x6 has about 1500.
const MAX_MODULES: usize = 50_000;
/// Most tensors read; YOLOv5x6 has about 1300.
const MAX_TENSORS: usize = 20_000;
/// Longest name of a tensor or module with its path, in bytes.
const MAX_NAME: usize = 512;
/// Most attributes, entries and numbers looked at while walking modules: shared
/// values are met once per module, so their number is bounded here.
const MAX_WORK: usize = 5_000_000;
/// Most dimensions of a tensor.
const MAX_RANK: usize = 16;
/// Most numbers kept of one attribute of a module.
const MAX_NUMBERS: usize = 4096;

/// Where the storages are.
pub(super) trait Source {
    /// The budget of the file.
    fn budget(&mut self) -> &mut Budget;

    /// Gives the bytes of a storage to `read`, and whether they are big-endian.
    fn with_storage<T>(
        &mut self,
        storage: &StorageRef,
        read: impl FnOnce(&[u8], bool) -> Result<T, WeightsError>,
    ) -> Result<T, WeightsError>;
}

/// A reference to a storage: `('storage', class, key, device, elements, view)`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct StorageRef {
    pub key: String,
    pub dtype: Dtype,
    pub count: usize,
    /// First element of the view that old streams allow on another storage.
    pub view_offset: usize,
}

impl StorageRef {
    fn parse(pickle: &Pickle, id: Id) -> Result<Self, String> {
        let Value::Persistent(inner) = pickle.get(id) else {
            return Err(format!("its storage is {}", pickle.describe(id)));
        };
        let Some([tag, class, key, _device, count, rest @ ..]) = pickle.sequence(*inner) else {
            return Err("its storage reference is too short".to_owned());
        };
        if pickle.str(*tag) != Some("storage") {
            return Err("its storage reference is of an unknown kind".to_owned());
        }
        let dtype = match pickle.global(*class) {
            Some(("torch" | "torch.cuda" | "torch.storage", name)) => Dtype::from_torch(name)
                .ok_or_else(|| format!("elements of type {name} are not supported"))?,
            _ => return Err(format!("its storage is of {}", pickle.describe(*class))),
        };
        let key = match pickle.get(*key) {
            Value::Str(key) => key.clone(),
            Value::Int(key) => key.to_string(),
            _ => return Err("its storage has no key".to_owned()),
        };
        let count = unsigned(pickle, *count).ok_or("its storage has no length")?;
        let view = rest.first().and_then(|id| pickle.sequence(*id));
        let view_offset = match view {
            Some([_, offset, _]) => unsigned(pickle, *offset).ok_or("bad view of a storage")?,
            _ => 0,
        };
        Ok(StorageRef { key, dtype, count, view_offset })
    }

    /// Length in bytes; `None` if it overflows.
    pub(super) fn bytes(&self) -> Option<u64> {
        (self.count as u64).checked_mul(self.dtype.size() as u64)
    }
}

/// Bytes per element of every storage that the pickle refers to.
pub(super) fn storage_sizes(pickle: &Pickle) -> HashMap<String, usize> {
    pickle
        .ids()
        .filter_map(|id| StorageRef::parse(pickle, id).ok())
        .map(|s| (s.key, s.dtype.size()))
        .collect()
}

fn unsigned(pickle: &Pickle, id: Id) -> Option<usize> {
    pickle.int(id).and_then(|n| usize::try_from(n).ok())
}

/// Makes the checkpoint of a decoded file.
pub(super) fn checkpoint(
    pickle: &Pickle,
    source: &mut impl Source,
) -> Result<Checkpoint, WeightsError> {
    let root = pickle.root();
    let mut reader =
        Reader { pickle, source, out: Checkpoint::default(), modules: 0, tensors: 0, work: 0 };
    reader.network(root)?;
    let names = pickle.lookup(root, "names").and_then(|id| class_names(pickle, id));
    if reader.out.class_names.is_none() {
        reader.out.class_names = names;
    }
    Ok(reader.out)
}

struct Reader<'a, S> {
    pickle: &'a Pickle,
    source: &'a mut S,
    out: Checkpoint,
    modules: usize,
    tensors: usize,
    work: usize,
}

impl<'a, S: Source> Reader<'a, S> {
    /// Finds the network: a module, a dictionary holding one (the moving
    /// average `ema` before `model`, then `state_dict` and
    /// `model_state_dict`), or named tensors.
    fn network(&mut self, root: Id) -> Result<(), WeightsError> {
        let pickle = self.pickle;
        if self.is_module(root) {
            return self.module(root, "", 0);
        }
        if pickle.entries(root).is_none() {
            let reason = format!("its root is {}", pickle.describe(root));
            return Err(WeightsError::NoNetwork { reason });
        }
        for key in ["ema", "model", "state_dict", "model_state_dict"] {
            let Some(id) = pickle.lookup(root, key) else { continue };
            if self.is_module(id) {
                return self.module(id, "", 0);
            }
            if self.has_tensors(id) {
                return self.state_dict(id);
            }
        }
        if self.has_tensors(root) {
            return self.state_dict(root);
        }
        let keys: Vec<&str> = pickle
            .entries(root)
            .unwrap_or_default()
            .iter()
            .filter_map(|(key, _)| pickle.str(*key))
            .take(12)
            .collect();
        let reason = format!(
            "neither modules nor tensors under 'ema', 'model', 'state_dict' or 'model_state_dict'; the keys are [{}]",
            keys.join(", ")
        );
        Err(WeightsError::NoNetwork { reason })
    }

    /// Counts what is looked at, and refuses too much of it.
    fn work(&mut self, count: usize) -> Result<(), WeightsError> {
        self.work = self.work.saturating_add(count);
        if self.work > MAX_WORK {
            let reason = format!("its modules hold more than {MAX_WORK} values");
            return Err(WeightsError::NoNetwork { reason });
        }
        Ok(())
    }

    /// An instance whose attributes have `_modules` or `_parameters`.
    fn is_module(&self, id: Id) -> bool {
        let attributes = self.pickle.attributes(id);
        attributes.is_some_and(|a| {
            ["_modules", "_parameters"].iter().any(|key| self.pickle.lookup(a, key).is_some())
        })
    }

    fn has_tensors(&self, dict: Id) -> bool {
        let entries = self.pickle.entries(dict).unwrap_or_default();
        entries.iter().any(|(_, value)| self.tensor_call(*value).is_some())
    }

    fn state_dict(&mut self, dict: Id) -> Result<(), WeightsError> {
        for (key, value) in self.pickle.entries(dict).unwrap_or_default() {
            if let Some(name) = self.pickle.str(key) {
                self.tensor(name, value)?;
            }
        }
        Ok(())
    }

    /// Walks a module: its tensors, its numbers, its children.
    fn module(&mut self, id: Id, path: &str, depth: usize) -> Result<(), WeightsError> {
        self.modules += 1;
        if depth > MAX_DEPTH || self.modules > MAX_MODULES {
            let reason = format!(
                "the modules at '{path}' are nested deeper than {MAX_DEPTH} or more than {MAX_MODULES}"
            );
            return Err(WeightsError::NoNetwork { reason });
        }
        let pickle = self.pickle;
        let Some(attributes) = pickle.attributes(id) else { return Ok(()) };
        if path.len() > MAX_NAME {
            let reason = format!("a module has a name of {} bytes", path.len());
            return Err(WeightsError::NoNetwork { reason });
        }
        self.work(1 + pickle.entry_count(attributes))?;
        let join = |name: &str| {
            if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") }
        };
        for group in ["_parameters", "_buffers"] {
            let group = pickle.lookup(attributes, group);
            self.work(group.map_or(0, |g| pickle.entry_count(g)))?;
            let group = group.and_then(|g| pickle.entries(g));
            for (key, value) in group.unwrap_or_default() {
                if let Some(name) = pickle.str(key) {
                    self.tensor(&join(name), value)?;
                }
            }
        }
        let class = match pickle.get(id) {
            Value::Object(object) => pickle.global(object.class).map_or("", |(_, name)| name),
            _ => "",
        };
        let info = ModuleInfo { class: class.to_owned(), numbers: self.numbers(attributes)? };
        if let Some(stride) = info.numbers.get("stride")
            && matches!(class, "Detect" | "Model" | "DetectionModel")
        {
            self.out.strides.get_or_insert_with(|| stride.clone());
        }
        if self.out.class_names.is_none() {
            let names = pickle.lookup(attributes, "names");
            self.out.class_names = names.and_then(|id| class_names(pickle, id));
        }
        self.out.modules.insert(normalise_name(path), info);
        let children = pickle.lookup(attributes, "_modules");
        self.work(children.map_or(0, |m| pickle.entry_count(m)))?;
        let children = children.and_then(|m| pickle.entries(m));
        for (key, child) in children.unwrap_or_default() {
            if let Some(name) = pickle.str(key) {
                self.module(child, &join(name), depth + 1)?;
            }
        }
        Ok(())
    }

    /// Attributes that are numbers, short sequences of numbers or small tensors.
    fn numbers(
        &mut self,
        attributes: Id,
    ) -> Result<std::collections::BTreeMap<String, Vec<f64>>, WeightsError> {
        let pickle = self.pickle;
        let mut numbers = std::collections::BTreeMap::new();
        for (key, value) in pickle.entries(attributes).unwrap_or_default() {
            let Some(name) = pickle.str(key).filter(|n| !n.starts_with('_')) else { continue };
            let found = match pickle.sequence(value) {
                Some(items) if items.len() <= MAX_NUMBERS => {
                    items.iter().map(|id| number(pickle, *id)).collect()
                }
                Some(_) => None,
                None if name == "stride" => self.small_tensor(name, value)?,
                None => number(pickle, value).map(|n| vec![n]),
            };
            if let Some(found) = found {
                self.work(found.len())?;
                numbers.insert(name.to_owned(), found);
            }
        }
        Ok(numbers)
    }

    fn small_tensor(&mut self, name: &str, id: Id) -> Result<Option<Vec<f64>>, WeightsError> {
        if self.tensor_call(id).is_none() {
            return Ok(number(self.pickle, id).map(|n| vec![n]));
        }
        let tensor = self.read_tensor(name, id)?;
        let small = tensor.filter(|t| t.data().len() <= MAX_NUMBERS);
        Ok(small.map(|t| t.data().iter().map(|&x| f64::from(x)).collect()))
    }

    fn tensor(&mut self, name: &str, id: Id) -> Result<(), WeightsError> {
        if name.ends_with("num_batches_tracked") {
            return Ok(());
        }
        if let Some(tensor) = self.read_tensor(name, id)? {
            let name = normalise_name(name);
            if self.out.tensors.contains_key(&name) {
                let reason = "two tensors of the file have this name".to_owned();
                return Err(WeightsError::Tensor { name, reason });
            }
            self.out.tensors.insert(name, tensor);
        }
        Ok(())
    }

    /// Reads a tensor; `None` for values that are none, such as `None`.
    fn read_tensor(&mut self, name: &str, id: Id) -> Result<Option<Tensor>, WeightsError> {
        let Some(call) = self.tensor_call(id) else { return Ok(None) };
        self.tensors += 1;
        let error = |reason| WeightsError::Tensor { name: name.to_owned(), reason };
        if name.len() > MAX_NAME {
            let start: String = name.chars().take(40).collect();
            let reason = format!("a name of {} bytes", name.len());
            return Err(WeightsError::Tensor { name: format!("{start}…"), reason });
        }
        if self.tensors > MAX_TENSORS {
            return Err(error(format!("more than {MAX_TENSORS} tensors")));
        }
        let (storage, view) = self.view(call).map_err(error)?;
        let count =
            view.count().ok_or_else(|| error(format!("shape {:?} is too large", view.shape)))?;
        self.source.budget().elements(count, name)?;
        let tensor = self
            .source
            .with_storage(&storage, |bytes, big_endian| view.read(name, bytes, big_endian))?;
        Ok(Some(tensor))
    }

    /// The call that rebuilds a tensor, wrappers such as parameters removed:
    /// the name of the function and its arguments.
    fn tensor_call(&self, mut id: Id) -> Option<(&'a str, &'a [Id])> {
        let pickle = self.pickle;
        // A parameter wraps a tensor once; more levels are not written by PyTorch.
        for _ in 0..4 {
            let Value::Object(object) = pickle.get(id) else { return None };
            let args = pickle.sequence(object.args)?;
            match pickle.global(object.class)? {
                (
                    "torch._utils",
                    name @ ("_rebuild_tensor_v2" | "_rebuild_tensor" | "_rebuild_tensor_v3"),
                ) => {
                    return Some((name, args));
                }
                ("torch._utils", "_rebuild_parameter" | "_rebuild_parameter_with_state")
                | ("torch.nn.parameter", "Parameter" | "Buffer") => id = *args.first()?,
                _ => return None,
            }
        }
        None
    }

    fn view(&self, (function, args): (&str, &[Id])) -> Result<(StorageRef, View), String> {
        let pickle = self.pickle;
        let [storage, offset, shape, stride, rest @ ..] = args else {
            return Err(format!("{} arguments instead of at least 4", args.len()));
        };
        let mut storage = StorageRef::parse(pickle, *storage)?;
        if function == "_rebuild_tensor_v3" {
            // (…, requires_grad, hooks, dtype, …) on a storage of bytes.
            let dtype = rest.get(2).and_then(|id| pickle.global(*id));
            let dtype = dtype.and_then(|(_, name)| Dtype::from_torch(name));
            storage.dtype = dtype.ok_or("its element type is not supported")?;
        }
        let sizes = |id: Id, what: &str| -> Result<Vec<usize>, String> {
            let items = pickle.sequence(id).ok_or_else(|| format!("its {what} is no tuple"))?;
            if items.len() > MAX_RANK {
                return Err(format!("{} dimensions; at most {MAX_RANK} are read", items.len()));
            }
            let sizes: Option<Vec<usize>> = items.iter().map(|id| unsigned(pickle, *id)).collect();
            sizes.ok_or_else(|| format!("its {what} holds a negative or unreadable number"))
        };
        let shape = sizes(*shape, "shape")?;
        let stride = sizes(*stride, "strides")?;
        if shape.len() != stride.len() {
            return Err(format!("shape {shape:?} and strides {stride:?} differ in length"));
        }
        let offset = unsigned(pickle, *offset)
            .and_then(|n| n.checked_add(storage.view_offset))
            .ok_or("its offset is negative or too large")?;
        let dtype = storage.dtype;
        Ok((storage, View { dtype, offset, shape, stride }))
    }
}

fn number(pickle: &Pickle, id: Id) -> Option<f64> {
    match pickle.get(id) {
        Value::Float(f) => Some(*f),
        _ => pickle.int(id).map(|n| n as f64),
    }
}

/// Class names as a list of texts, or as a dictionary from 0, 1, … to texts.
fn class_names(pickle: &Pickle, id: Id) -> Option<Vec<String>> {
    if let Some(items) = pickle.sequence(id) {
        let names: Option<Vec<String>> =
            items.iter().map(|id| pickle.str(*id).map(str::to_owned)).collect();
        return names.filter(|n| !n.is_empty());
    }
    let mut names = std::collections::BTreeMap::new();
    for (key, value) in pickle.entries(id)? {
        names.insert(pickle.int(key)?, pickle.str(value)?.to_owned());
    }
    let dense = names.keys().copied().eq(0..names.len() as i64);
    (dense && !names.is_empty()).then(|| names.into_values().collect())
}
