//! The two networks of the follower, and the flags that choose them.

use super::engine_args::EngineArgs;
use super::failure::{OrBadInput, bad_input};
use super::model_args::{open_model, parse_share, start_detector};
use anyhow::Result;
use clap::Args;
use realnet::depth::{DepthModel, DepthNet, DepthOptions};
use realnet::{
    CameraModel, DepthEyes, Detector, DetectorModel, DetectorOptions, Runtime, YoloEyes, shipped,
};
use std::path::{Path, PathBuf};

#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Networks")]
pub(crate) struct NetworkArgs {
    /// The detector: YOLOv5 weights or a YOLO ONNX file [default: the program's own].
    #[arg(long, value_name = "FILE")]
    detector: Option<PathBuf>,
    /// The depth network: VNL or vnl-lite weights, or their ONNX file; 'none': ranges by the
    /// ground and the target's size alone [default: the program's own].
    #[arg(long, value_name = "FILE|none")]
    depth: Option<PathBuf>,
    /// Least confidence of a detection, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.25, value_parser = parse_share)]
    conf: f32,
    #[command(flatten)]
    engine: EngineArgs,
}

impl NetworkArgs {
    /// Whether a network is named.
    pub(crate) const fn is_given(&self) -> bool {
        self.detector.is_some() || self.depth.is_some()
    }

    /// The engine, for `sharing` networks at a time.
    pub(crate) fn runtime(&self, sharing: usize) -> Runtime {
        self.engine.start_sharing(sharing)
    }

    /// The least confidence that a detection must have.
    pub(crate) const fn confidence(&self) -> f32 {
        self.conf
    }

    /// Both, for the frames of a camera.
    pub(crate) fn start(
        &self,
        runtime: &Runtime,
        camera: CameraModel,
    ) -> Result<(YoloEyes, Option<DepthEyes>)> {
        let depth = self.depth(runtime)?.map(|network| DepthEyes { network, camera });
        Ok((YoloEyes(self.detector(runtime)?), depth))
    }

    /// The detector, on an engine.
    fn detector(&self, runtime: &Runtime) -> Result<Detector> {
        let options = DetectorOptions { confidence: self.conf, ..DetectorOptions::default() };
        let (path, model) = match &self.detector {
            Some(path) => (path.as_path(), open_model(path)?),
            None => {
                let (name, bytes) = (shipped::DETECTOR_NAME, shipped::DETECTOR);
                (Path::new(name), DetectorModel::from_vec(name, bytes.to_vec())?)
            }
        };
        start_detector(path, model, runtime, options)
    }

    /// The depth network, on an engine, if there is to be one.
    fn depth(&self, runtime: &Runtime) -> Result<Option<DepthNet>> {
        let (path, model) = match &self.depth {
            Some(path) if path.as_os_str() == "none" => return Ok(None),
            Some(path) => (path.as_path(), DepthModel::open(path).or_bad_input()?),
            None => {
                let (name, bytes) = (shipped::DEPTH_NAME, shipped::DEPTH);
                (Path::new(name), DepthModel::from_vec(name, bytes.to_vec())?)
            }
        };
        DepthNet::new(&model, runtime, &DepthOptions::default())
            .map(Some)
            .map_err(|error| bad_input(format!("{}: {error}", path.display())))
    }
}
