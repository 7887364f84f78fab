//! A detector of brightness: an ONNX file of a few hundred bytes in the form of
//! an exported YOLOv5 that finds one box, as confident as its picture is bright.
//! With it the program can be tried without any weights.

use realnet::onnx::{OnnxModel, proto::*};

/// Side of its input.
pub const SIDE: u32 = 64;
/// Its only box, in a picture of [`SIDE`] x [`SIDE`] pixels.
pub const BOX: [f64; 4] = [16.0, 24.0, 48.0, 40.0];
/// Name of its only class.
pub const CLASS: &str = "lamp";

/// A float tensor's name, type and shape.
pub fn value_info(name: &str, dims: &[i64]) -> ValueInfoProto {
    let dim = |n: &i64| Dimension { value: Some(DimensionValue::Value(*n)), ..Default::default() };
    let tensor = TensorTypeProto {
        elem_type: Some(data_type::FLOAT),
        shape: Some(TensorShapeProto { dim: dims.iter().map(dim).collect() }),
    };
    let r#type = TypeProto { value: Some(TypeValue::Tensor(tensor)), ..Default::default() };
    ValueInfoProto { name: name.to_owned(), r#type: Some(r#type), ..Default::default() }
}

/// An operation with integer attributes.
pub fn node(
    op: &str,
    inputs: &[&str],
    output: &str,
    attributes: &[(&str, i64)],
    lists: &[(&str, &[i64])],
) -> NodeProto {
    let single = attributes.iter().map(|(name, value)| AttributeProto {
        name: (*name).to_owned(),
        i: Some(*value),
        r#type: Some(attribute_type::INT),
        ..Default::default()
    });
    let many = lists.iter().map(|(name, values)| AttributeProto {
        name: (*name).to_owned(),
        ints: values.to_vec(),
        r#type: Some(attribute_type::INTS),
        ..Default::default()
    });
    NodeProto {
        op_type: op.to_owned(),
        name: output.to_owned(),
        input: inputs.iter().map(|name| (*name).to_owned()).collect(),
        output: vec![output.to_owned()],
        attribute: single.chain(many).collect(),
        ..Default::default()
    }
}

/// A constant tensor.
pub fn constant(name: &str, dims: &[i64], data: &[f32]) -> TensorProto {
    TensorProto {
        name: name.to_owned(),
        dims: dims.to_vec(),
        data_type: Some(data_type::FLOAT),
        float_data: data.to_vec(),
        ..Default::default()
    }
}

/// The messages of the file, to be spoilt by tests.
pub fn proto() -> ModelProto {
    let [x0, y0, x1, y1] = BOX.map(|edge| edge as f32);
    let place = [(x0 + x1) / 2.0, (y0 + y1) / 2.0, x1 - x0, y1 - y0];
    let side = i64::from(SIDE);
    let graph = GraphProto {
        name: "brightness".to_owned(),
        node: vec![
            node("GlobalAveragePool", &["images"], "channels", &[], &[]),
            node("ReduceMean", &["channels"], "brightness", &[("keepdims", 0)], &[("axes", &[1])]),
            node("Concat", &["place", "brightness", "class"], "output0", &[("axis", 2)], &[]),
        ],
        initializer: vec![
            constant("place", &[1, 1, 4], &place),
            constant("class", &[1, 1, 1], &[1.0]),
        ],
        input: vec![value_info("images", &[1, 3, side, side])],
        output: vec![value_info("output0", &[1, 1, 6])],
        ..Default::default()
    };
    let names =
        StringStringEntryProto { key: "names".to_owned(), value: format!("{{0: '{CLASS}'}}") };
    ModelProto {
        ir_version: Some(8),
        graph: Some(graph),
        opset_import: vec![OperatorSetIdProto { domain: String::new(), version: Some(13) }],
        metadata_props: vec![names],
        ..Default::default()
    }
}

/// The bytes of a model that decodes.
pub fn bytes_of(proto: ModelProto) -> Vec<u8> {
    OnnxModel::from_proto(proto).unwrap().to_bytes()
}

/// The bytes of the detector.
pub fn bytes() -> Vec<u8> {
    bytes_of(proto())
}

/// The bytes after a change of the graph.
pub fn changed(change: impl FnOnce(&mut GraphProto)) -> Vec<u8> {
    let mut model = proto();
    change(model.graph.as_mut().unwrap());
    bytes_of(model)
}

/// A picture of one brightness.
pub fn picture(path: &std::path::Path, width: u32, height: u32, grey: u8) {
    let data = vec![grey; width as usize * height as usize * 3];
    let frame = realnet::Frame::rgb8(realnet::Stamp::ZERO, width, height, data).unwrap();
    realnet::picture::write(path, &frame).unwrap();
}
