//! Where the depth to be judged comes from.

use super::data::Sample;
use crate::cli::{
    camera_args::CameraArgs,
    engine_args::EngineArgs,
    failure::{OrBadInput, bad_input},
};
use anyhow::{Context, Result};
use realnet::{
    CameraModel, DepthMap, Filter, Frame, Stage,
    depth::{DepthModel, DepthNet, DepthOptions, DepthSize, Detail},
    picture::Limits,
};
use serde::Serialize;
use std::{
    path::{Path, PathBuf},
    time::Instant,
};

/// How the network is to be run.
pub(super) struct NetworkArgs {
    pub(super) size: Option<(u32, u32)>,
    pub(super) full: bool,
    pub(super) filter: Filter,
}

/// A network, or the depth maps of another program.
pub(super) enum Estimator {
    Network { net: Box<DepthNet>, model: PathBuf, full: bool },
    Files { folder: PathBuf, scale: f64 },
}

/// What an [`Estimator`] needs of a picture, found to be good.
pub(super) enum Prepared {
    Camera(CameraModel),
    Map(DepthMap),
}

/// An [`Estimator`] for the protocol.
#[derive(Debug, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub(super) enum Words {
    Network {
        model: String,
        engine: String,
        /// Width and height of the network's input.
        input: (u32, u32),
        output: &'static str,
        /// In pixels of the input: what the depths are right for before the camera counts.
        focal: f64,
    },
    Predictions {
        folder: String,
        /// Units a metre.
        scale: f64,
    },
}

impl Estimator {
    /// The network in a file.
    pub(super) fn network(path: &Path, engine: &EngineArgs, args: &NetworkArgs) -> Result<Self> {
        let model = DepthModel::open(path).or_bad_input()?;
        let options = DepthOptions {
            size: args.size,
            detail: if args.full { Detail::Full } else { Detail::Fast },
            output: DepthSize::Frame,
            filter: args.filter,
        };
        let net = DepthNet::new(&model, &engine.start(), &options)
            .map_err(|error| bad_input(format!("{}: {error}", path.display())))?;
        let (net, model, full) = (Box::new(net), path.to_owned(), args.full);
        Ok(Self::Network { net, model, full })
    }

    /// The files of a folder, `scale` units a metre.
    pub(super) fn files(folder: &Path, scale: f64) -> Result<Self> {
        if !folder.is_dir() {
            return Err(bad_input(format!("{}: there is no such folder", folder.display())));
        }
        Ok(Self::Files { folder: folder.to_owned(), scale })
    }

    pub(super) fn words(&self) -> Words {
        match self {
            Self::Network { net, model, full, .. } => Words::Network {
                model: model.display().to_string(),
                engine: net.engine(),
                input: net.input_size(),
                output: if *full { "full" } else { "fast" },
                focal: net.coding().focal,
            },
            Self::Files { folder, scale } => {
                Words::Predictions { folder: folder.display().to_string(), scale: *scale }
            }
        }
    }

    /// Finds what a picture needs; an error is that picture's own.
    pub(super) fn prepare(
        &self,
        sample: &Sample,
        frame: &Frame,
        camera: &CameraArgs,
    ) -> Result<Prepared> {
        let (width, height) = (frame.width(), frame.height());
        let Self::Files { folder, scale } = self else {
            return Ok(Prepared::Camera(sample.camera(camera, width, height)?));
        };
        let path = folder.join(sample.name()).with_added_extension("png");
        let map = realnet_io::depth::read(&path, *scale, &Limits::default())
            .with_context(|| format!("no produced depth of {}", sample.color.display()))?;
        if (map.width(), map.height()) != (width, height) {
            return Err(bad_input(format!(
                "{}: {}x{} depths for a picture of {width}x{height}",
                path.display(),
                map.width(),
                map.height()
            )));
        }
        Ok(Prepared::Map(map))
    }

    /// The depth of a picture in its size; and, of a network, the milliseconds of
    /// fitting, inference and resizing.
    pub(super) fn run(
        &mut self,
        prepared: Prepared,
        frame: &Frame,
    ) -> Result<(DepthMap, Option<f64>)> {
        match (self, prepared) {
            (Self::Network { net, .. }, Prepared::Camera(camera)) => {
                let start = Instant::now();
                let mut end = start;
                let mut mark = |stage| {
                    if stage == Stage::Postprocess {
                        end = Instant::now();
                    }
                };
                let map = net.depth_marked(frame, Some(&camera), Vec::new(), &mut mark)?;
                Ok((map, Some((end - start).as_secs_f64() * 1e3)))
            }
            (_, Prepared::Map(map)) => Ok((map, None)),
            (Self::Files { .. }, Prepared::Camera(_)) => {
                Err(anyhow::anyhow!("files of depth need no camera"))
            }
        }
    }
}
