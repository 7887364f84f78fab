//! Changes of a graph: other outputs, another input size.

use std::collections::{HashMap, HashSet};

use super::proto::{
    AttributeProto, Dimension, DimensionValue, GraphProto, NodeProto, TensorProto,
    TensorShapeProto, TensorTypeProto, TypeProto, TypeValue, ValueInfoProto, data_type,
};
use super::{Dim, ElementType, OnnxError, OnnxModel, TensorInfo};

impl OnnxModel {
    /// Makes the named tensors the only outputs, in the order given.
    ///
    /// They may be intermediate tensors. Nodes, initialisers and inputs that no
    /// longer contribute are dropped.
    ///
    /// # Errors
    /// [`OnnxError::UnknownTensor`] if a name is not in the graph,
    /// [`OnnxError::NoOutputsKept`] if none is given. The model is unchanged then.
    pub fn keep_outputs(&mut self, names: &[&str]) -> Result<(), OnnxError> {
        if names.is_empty() {
            return Err(OnnxError::NoOutputsKept);
        }
        if let Some(missing) = names.iter().find(|n| !self.has_tensor(n)) {
            let outputs: Vec<String> = self.outputs().into_iter().map(|o| o.name).collect();
            return Err(OnnxError::UnknownTensor {
                name: (*missing).to_owned(),
                outputs: outputs.join(", "),
            });
        }
        let graph = self.model.graph.as_mut().ok_or(OnnxError::NoGraph)?;
        let mut kept = HashSet::new();
        let outputs = names
            .iter()
            .filter(|name| kept.insert(**name))
            .map(|name| {
                let known = graph.output.iter().chain(&graph.value_info).chain(&graph.input);
                known.into_iter().find(|v| v.name == *name).cloned().unwrap_or_else(|| {
                    ValueInfoProto { name: (*name).to_owned(), ..Default::default() }
                })
            })
            .collect();
        graph.output = outputs;
        prune(graph);
        Ok(())
    }

    /// Sets the shape of the only input, for example `[1, 3, 320, 320]`.
    ///
    /// Shapes that followed from the old one (value infos, outputs) are dropped.
    /// Constants inside the graph that depend on the input size are not changed:
    /// only graphs without such constants before their outputs still work.
    ///
    /// # Errors
    /// [`OnnxError::NotOneInput`], or [`OnnxError::BadInputDims`] if the rank
    /// differs from the file's or a dimension is 0.
    pub fn set_input_dims(&mut self, dims: &[usize]) -> Result<(), OnnxError> {
        let inputs = self.inputs();
        let [input] = inputs.as_slice() else {
            let names: Vec<&str> = inputs.iter().map(|i| i.name.as_str()).collect();
            return Err(OnnxError::NotOneInput { count: inputs.len(), names: names.join(", ") });
        };
        let rank_differs = input.dims.as_ref().is_some_and(|d| d.len() != dims.len());
        let new_dims: Option<Vec<Dimension>> = dims
            .iter()
            .map(|&n| {
                let n = i64::try_from(n).ok().filter(|&n| n > 0)?;
                Some(Dimension { value: Some(DimensionValue::Value(n)), denotation: String::new() })
            })
            .collect();
        let (false, Some(dim)) = (rank_differs, new_dims) else {
            return Err(OnnxError::BadInputDims {
                input: input.name.clone(),
                wanted: dims.to_vec(),
                found: input.shape_text(),
            });
        };
        let graph = self.model.graph.as_mut().ok_or(OnnxError::NoGraph)?;
        let old = TensorInfo::clone(input);
        if old.fixed_dims().as_deref() == Some(dims) {
            return Ok(());
        }
        for info in graph.input.iter_mut().filter(|i| i.name == old.name) {
            info.r#type =
                Some(tensor_type(old.element, Some(TensorShapeProto { dim: dim.clone() })));
        }
        graph.value_info.clear();
        for output in &mut graph.output {
            if let Some(TypeValue::Tensor(t)) =
                output.r#type.as_mut().and_then(|t| t.value.as_mut())
            {
                t.shape = None;
            }
        }
        Ok(())
    }
}

/// A tensor type for an element type and a shape.
fn tensor_type(element: ElementType, shape: Option<TensorShapeProto>) -> TypeProto {
    let elem_type = match element {
        ElementType::Float32 => data_type::FLOAT,
        ElementType::Float16 => data_type::FLOAT16,
        ElementType::Int64 => data_type::INT64,
        ElementType::Other(n) => n,
    };
    TypeProto {
        value: Some(TypeValue::Tensor(TensorTypeProto { elem_type: Some(elem_type), shape })),
        denotation: String::new(),
    }
}

/// Name and type of a tensor with 32-bit floats or the type given.
pub(crate) fn value_info(name: &str, element: ElementType, dims: &[Dim]) -> ValueInfoProto {
    let dim = dims
        .iter()
        .map(|d| Dimension {
            value: match d {
                Dim::Fixed(n) => i64::try_from(*n).ok().map(DimensionValue::Value),
                Dim::Symbolic(s) if s.is_empty() => None,
                Dim::Symbolic(s) => Some(DimensionValue::Param(s.clone())),
            },
            denotation: String::new(),
        })
        .collect();
    ValueInfoProto {
        name: name.to_owned(),
        r#type: Some(tensor_type(element, Some(TensorShapeProto { dim }))),
        ..Default::default()
    }
}

/// Drops what does not contribute to the outputs of the graph.
fn prune(graph: &mut GraphProto) {
    let needed: HashSet<String> = {
        let mut producer: HashMap<&str, usize> = HashMap::new();
        for (index, node) in graph.node.iter().enumerate() {
            for output in node.output.iter().filter(|o| !o.is_empty()) {
                producer.entry(output).or_insert(index);
            }
        }
        let mut needed: HashSet<&str> = HashSet::new();
        let mut queue: Vec<&str> = graph.output.iter().map(|o| o.name.as_str()).collect();
        // Parameters of quantised tensors are named outside the nodes.
        let annotations: HashMap<&str, _> = graph
            .quantization_annotation
            .iter()
            .map(|a| (a.tensor_name.as_str(), &a.quant_parameter_tensor_names))
            .collect();
        while let Some(name) = queue.pop() {
            if name.is_empty() || !needed.insert(name) {
                continue;
            }
            if let Some(node) = producer.get(name).and_then(|&i| graph.node.get(i)) {
                push_inputs(node, &mut queue);
            }
            if let Some(parameters) = annotations.get(name) {
                queue.extend(parameters.iter().map(|p| p.value.as_str()));
            }
        }
        needed.into_iter().map(str::to_owned).collect()
    };
    graph.node.retain(|n| n.output.iter().any(|o| needed.contains(o)));
    let produced: HashSet<&str> =
        graph.node.iter().flat_map(|n| n.output.iter().map(String::as_str)).collect();
    graph.value_info.retain(|v| {
        produced.contains(v.name.as_str()) && !graph.output.iter().any(|o| o.name == v.name)
    });
    graph.initializer.retain(|t| needed.contains(&t.name));
    graph
        .sparse_initializer
        .retain(|s| s.values.as_ref().is_some_and(|v| needed.contains(&v.name)));
    graph.input.retain(|i| needed.contains(&i.name));
    graph.quantization_annotation.retain(|a| needed.contains(&a.tensor_name));
}

/// All names a node reads, those captured by its inner graphs included.
fn push_inputs<'a>(node: &'a NodeProto, queue: &mut Vec<&'a str>) {
    queue.extend(node.input.iter().map(String::as_str));
    let mut graphs: Vec<&GraphProto> = node.attribute.iter().flat_map(inner_graphs).collect();
    while let Some(graph) = graphs.pop() {
        queue.extend(graph.output.iter().map(|o| o.name.as_str()));
        for inner in &graph.node {
            queue.extend(inner.input.iter().map(String::as_str));
            graphs.extend(inner.attribute.iter().flat_map(inner_graphs));
        }
    }
}

fn inner_graphs(attribute: &AttributeProto) -> impl Iterator<Item = &GraphProto> {
    attribute.g.iter().chain(&attribute.graphs)
}

/// Refuses tensors whose data is in another file.
pub(super) fn check_self_contained(graph: &GraphProto) -> Result<(), OnnxError> {
    let mut graphs = vec![graph];
    while let Some(graph) = graphs.pop() {
        for tensor in &graph.initializer {
            check_inline(tensor)?;
        }
        for sparse in &graph.sparse_initializer {
            for tensor in sparse.values.iter().chain(&sparse.indices) {
                check_inline(tensor)?;
            }
        }
        for attribute in graph.node.iter().flat_map(|n| &n.attribute) {
            for tensor in attribute.t.iter().chain(&attribute.tensors) {
                check_inline(tensor)?;
            }
            graphs.extend(inner_graphs(attribute));
        }
    }
    Ok(())
}

fn check_inline(tensor: &TensorProto) -> Result<(), OnnxError> {
    if tensor.data_location != Some(1) && tensor.external_data.is_empty() {
        return Ok(());
    }
    let location = tensor.external_data.iter().find(|e| e.key == "location");
    Err(OnnxError::ExternalData {
        tensor: tensor.name.clone(),
        location: location.map_or_else(|| "not told".to_owned(), |e| e.value.clone()),
    })
}
