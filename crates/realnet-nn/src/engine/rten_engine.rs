//! The embedded engine.

use super::{Engine, EngineError, TensorView};
use rten::{Model, ModelOptions, NodeId, RunOptions, ThreadPool, ValueOrView};
use rten_tensor::{AsView, Layout, NdTensor};
use std::sync::Arc;

const NAME: &str = "rten";
/// Release of rten that is compiled in.
pub const RTEN_VERSION: &str = "0.27";

pub(super) fn description() -> String {
    format!("{NAME} {RTEN_VERSION} on cpu")
}

/// A network in rten.
pub(super) struct RtenEngine {
    model: Model,
    input_id: NodeId,
    outputs: Vec<(NodeId, String)>,
    input: NdTensor<f32, 4>,
    options: RunOptions,
}

impl RtenEngine {
    pub(super) fn load(
        bytes: Vec<u8>,
        (width, height): (u32, u32),
        threads: usize,
    ) -> Result<Self, EngineError> {
        let failed = |reason: String| EngineError::Load { engine: NAME, reason };
        let mut options = ModelOptions::with_all_ops();
        options.prepack_weights(true);
        let model = options.load(bytes).map_err(|error| failed(error.to_string()))?;
        let input_id = *model
            .input_ids()
            .first()
            .ok_or_else(|| failed("the graph has no input".to_owned()))?;
        let outputs = model
            .output_ids()
            .iter()
            .map(|&id| {
                let name = model.node_info(id).and_then(|info| info.name().map(str::to_owned));
                (id, name.unwrap_or_default())
            })
            .collect();
        let mut options = RunOptions::default();
        if threads > 0 {
            options.thread_pool = Some(Arc::new(ThreadPool::with_num_threads(threads)));
        }
        let input = NdTensor::zeros([1, 3, height as usize, width as usize]);
        Ok(Self { model, input_id, outputs, input, options })
    }
}

impl Engine for RtenEngine {
    fn describe(&self) -> String {
        description()
    }

    fn input_size(&self) -> (u32, u32) {
        let [_, _, height, width] = self.input.shape();
        (width as u32, height as u32)
    }

    fn input(&mut self) -> &mut [f32] {
        // A tensor made by `zeros` is contiguous; an empty slice is never seen.
        self.input.data_mut().unwrap_or_default()
    }

    fn run(&mut self, read: &mut dyn FnMut(&[TensorView<'_>])) -> Result<(), EngineError> {
        let failed = |reason: String| EngineError::Run { engine: NAME, reason };
        let ids: Vec<NodeId> = self.outputs.iter().map(|(id, _)| *id).collect();
        let input = ValueOrView::from(self.input.view().as_dyn());
        let values = self
            .model
            .run(vec![(self.input_id, input)], &ids, Some(self.options.clone()))
            .map_err(|error| failed(error.to_string()))?;
        let mut tensors = Vec::with_capacity(values.len());
        for (value, (_, name)) in values.into_iter().zip(&self.outputs) {
            let tensor = value
                .into_tensor::<f32>()
                .ok_or_else(|| failed(format!("output '{name}' is not float32")))?;
            tensors.push((tensor.shape().to_vec(), tensor.into_data(), name));
        }
        let views: Vec<TensorView<'_>> =
            tensors.iter().map(|(shape, data, name)| TensorView { name, shape, data }).collect();
        read(&views);
        Ok(())
    }
}
