//! The depth network that a training begins with: an architecture by name, or weights.

use crate::cli::{
    failure::{OrBadInput, bad_input},
    train::weights::told,
};
use anyhow::{Context, Result};
use realnet::{
    depth::DepthCoding,
    weights::{Checkpoint, Tensor},
};
use realnet_train::{
    names::{self, Tensors},
    nets::{DepthNet, VnlBody, VnlConfig, VnlLiteConfig},
};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The name of the network for small computers.
pub(super) const LITE: &str = "vnl-lite";
/// Width and height of its input are multiples of this.
const LITE_STEP: u32 = 32;
/// The authors' networks.
const BODIES: [(&str, VnlBody); 3] = [
    ("vnl-mobilenetv2", VnlBody::MobileNetV2),
    ("vnl-resnext50", VnlBody::ResNext50),
    ("vnl-resnext101", VnlBody::ResNext101),
];

/// Which network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Network {
    Lite(VnlLiteConfig),
    Vnl(VnlConfig),
}

impl Network {
    /// By name, if it is one.
    pub(super) fn named(name: &str) -> Option<Self> {
        if name == LITE {
            return Some(Self::Lite(VnlLiteConfig::default()));
        }
        let (_, body) = BODIES.iter().find(|(known, _)| *known == name)?;
        Some(Self::Vnl(VnlConfig::new(*body)))
    }

    /// Its name.
    pub(super) fn name(&self) -> &'static str {
        match self {
            Self::Lite(_) => LITE,
            Self::Vnl(config) => {
                BODIES.iter().find(|(_, body)| *body == config.body).map_or("", |(name, _)| name)
            }
        }
    }

    /// Width and height of its input are multiples of this.
    pub(super) fn step(&self) -> u32 {
        match self {
            Self::Lite(_) => LITE_STEP,
            Self::Vnl(config) => config.stride() as u32,
        }
    }

    /// Classes of depth.
    pub(super) fn bins(&self) -> usize {
        match self {
            Self::Lite(config) => config.bins,
            Self::Vnl(config) => config.bins,
        }
    }

    /// The same with another number of classes.
    pub(super) fn with_bins(self, bins: usize) -> Self {
        match self {
            Self::Lite(config) => Self::Lite(VnlLiteConfig { bins, ..config }),
            Self::Vnl(config) => Self::Vnl(VnlConfig { bins, ..config }),
        }
    }
}

/// What a network was built from, as `args.toml` has it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Built {
    model: String,
    bins: usize,
    /// Channels, blocks and channels of the decoder of vnl-lite.
    #[serde(skip_serializing_if = "Option::is_none")]
    lite: Option<([usize; 5], [usize; 4], usize)>,
    min: f64,
    max: f64,
    scale: f64,
    /// Pixels of the network's input.
    focal: f64,
    mean: [f32; 3],
    std: [f32; 3],
}

impl Built {
    pub(super) fn new(network: &Network, coding: &DepthCoding) -> Self {
        let DepthCoding { min, max, scale, focal, mean, std } = *coding;
        let lite = match network {
            Network::Lite(VnlLiteConfig { widths, blocks, decoder, .. }) => {
                Some((*widths, *blocks, *decoder))
            }
            Network::Vnl(_) => None,
        };
        let (model, bins) = (network.name().to_owned(), network.bins());
        Self { model, bins, lite, min, max, scale, focal, mean, std }
    }

    /// The network and its coding.
    pub(super) fn read(&self) -> Result<(Network, DepthCoding)> {
        let network = match (Network::named(&self.model), self.lite) {
            (Some(Network::Lite(_)), Some((widths, blocks, decoder))) => {
                Network::Lite(VnlLiteConfig { widths, blocks, decoder, bins: self.bins })
            }
            (Some(network), _) => network.with_bins(self.bins),
            (None, _) => return Err(bad_input(format!("there is no network {}", self.model))),
        };
        let Self { min, max, scale, focal, mean, std, .. } = *self;
        let coding = DepthCoding { min, max, scale, focal, mean, std };
        coding.check().or_bad_input()?;
        Ok((network, coding))
    }
}

/// A network to begin with.
pub(super) struct Start {
    pub(super) network: Network,
    /// How the file's numbers are metres, if it tells.
    pub(super) coding: Option<DepthCoding>,
    /// Whether the number of classes is the file's, and so has to stay.
    pub(super) is_fixed: bool,
    weights: Option<(PathBuf, Tensors)>,
}

impl Start {
    /// An architecture by name, with the weights of a file or without; or the network of a
    /// file.
    pub(super) fn open(model: &str, weights: Option<&Path>) -> Result<Self> {
        let named = Network::named(model);
        let path = match (named, weights) {
            (Some(network), None) => {
                return Ok(Self { network, coding: None, is_fixed: false, weights: None });
            }
            (Some(_), Some(path)) => path,
            (None, None) => Path::new(model),
            (None, Some(_)) => {
                return Err(bad_input(
                    "--weights is for a --model by name; weights as --model are enough",
                ));
            }
        };
        if !path.exists() && named.is_none() {
            let names = BODIES.map(|(name, _)| name).join(", ");
            return Err(bad_input(format!(
                "{model}: no such file, and not one of {LITE}, {names}"
            )));
        }
        let name = || path.display().to_string();
        let Checkpoint { tensors, depth, .. } =
            Checkpoint::read(path).with_context(name).or_bad_input()?;
        let tensors = own_names(tensors);
        let (network, is_fixed) = match named {
            Some(network) => (network, false),
            None => {
                let network = lite(&tensors).map(Network::Lite);
                let network = network.or_else(|| VnlConfig::of(&tensors).map(Network::Vnl));
                let unknown = || format!("{}: not the weights of a depth network", name());
                (network.ok_or_else(|| bad_input(unknown()))?, true)
            }
        };
        // The authors' files do not tell it.
        let coding = depth.or_else(|| match network {
            Network::Vnl(_) => Some(DepthCoding::default()),
            Network::Lite(_) => None,
        });
        Ok(Self { network, coding, is_fixed, weights: Some((path.to_owned(), tensors)) })
    }

    /// Gives a network the weights; and what it is and where they come from, for people.
    pub(super) fn fill<N: DepthNet>(&self, network: N) -> Result<(N, Vec<String>)> {
        let parameters = network.num_params() as f64 / 1e6;
        let name = self.network.name();
        let mut words = vec![format!("{name}: {parameters:.2} million parameters")];
        let Some((path, tensors)) = &self.weights else {
            words.push("weights: random".to_owned());
            return Ok((network, words));
        };
        let (network, taken) = names::take(network, tensors)
            .with_context(|| path.display().to_string())
            .or_bad_input()?;
        words.extend(told(path, &taken));
        Ok((network, words))
    }
}

/// Names without what the authors' training program puts before all of them.
fn own_names(tensors: Tensors) -> Tensors {
    const PREFIX: &str = "depth_model.";
    if !tensors.keys().all(|name| name.starts_with(PREFIX)) {
        return tensors;
    }
    let own = |(name, tensor): (String, Tensor)| {
        (name.strip_prefix(PREFIX).unwrap_or(&name).to_owned(), tensor)
    };
    tensors.into_iter().map(own).collect()
}

/// The vnl-lite that the tensors are of.
fn lite(tensors: &Tensors) -> Option<VnlLiteConfig> {
    let first = |name: &str| tensors.get(name)?.shape().first().copied();
    let mut widths = [first("stem.conv.weight")?, 0, 0, 0, 0];
    let mut blocks = [0; 4];
    for (stage, (width, blocks)) in widths[1..].iter_mut().zip(&mut blocks).enumerate() {
        *width = first(&format!("stages.{stage}.0.c1.conv.weight"))?;
        let name = |block: usize| format!("stages.{stage}.{block}.c1.conv.weight");
        *blocks = (0..).take_while(|block| tensors.contains_key(&name(*block))).count();
    }
    let (decoder, bins) = (first("skip.conv.weight")?, first("head.weight")?);
    Some(VnlLiteConfig { widths, blocks, decoder, bins })
}
