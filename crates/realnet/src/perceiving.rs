//! The networks as the follower's eyes.

use realnet_core::{BoundingBox, CameraModel, DepthMap, Detection, Frame};
use realnet_nn::depth::DepthNet;
use realnet_nn::detector::Detector;
use realnet_pipeline::{DepthEstimator, NetworkError, ObjectDetector};

/// A YOLO network that finds objects for a [`Follower`](realnet_pipeline::Follower).
#[derive(Debug)]
pub struct YoloEyes(pub Detector);

impl ObjectDetector for YoloEyes {
    fn detect(
        &mut self,
        frame: &Frame,
        near: Option<&BoundingBox>,
    ) -> Result<Vec<Detection>, NetworkError> {
        let found = match near {
            Some(near) => self.0.detect_near(frame, near),
            None => self.0.detect(frame),
        };
        Ok(found?.to_vec())
    }
}

/// A depth network that ranges the pictures of one camera.
#[derive(Debug)]
pub struct DepthEyes {
    /// The network.
    pub network: DepthNet,
    /// The camera, at the frames' size.
    pub camera: CameraModel,
}

impl DepthEstimator for DepthEyes {
    fn depth(&mut self, frame: &Frame) -> Result<DepthMap, NetworkError> {
        Ok(self.network.depth(frame, Some(&self.camera))?)
    }
}
