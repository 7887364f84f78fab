//! The networks.

pub mod block;
pub mod vnl;
pub mod vnl_lite;
pub mod yolov5;

use burn::module::Module;
use burn::tensor::Tensor;
pub use vnl::{Vnl, VnlBody, VnlConfig};
pub use vnl_lite::{VnlLite, VnlLiteConfig};
pub use yolov5::{Form, YoloV5, YoloV5Config, YoloV5Size};

/// A network that sorts depths into bins.
pub trait DepthNet: Module {
    /// Logits of the bins: `[batch, bins, height / s, width / s]` with a whole `s`, for
    /// normalised pictures `[batch, 3, height, width]`.
    fn logits(&self, image: Tensor<4>) -> Tensor<4>;
}

impl DepthNet for VnlLite {
    fn logits(&self, image: Tensor<4>) -> Tensor<4> {
        self.forward(image)
    }
}

impl DepthNet for Vnl {
    fn logits(&self, image: Tensor<4>) -> Tensor<4> {
        self.forward(image)
    }
}
