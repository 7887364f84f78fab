//! Colour pictures with true depth, whatever layout they came in.

use super::kitti;
use crate::cli::{
    camera_args::{CameraArgs, fit, read_camera},
    failure::{OrBadInput, bad_input},
};
use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use realnet::{
    CameraModel, DepthMap, Distortion, Frame, Intrinsics,
    datasets::rgbd::{RgbdError, RgbdLayout, RgbdOptions, RgbdSequence},
    eval::DepthCrop,
    picture::{self, Limits},
};
use std::{
    collections::{HashMap, HashSet},
    path::{Path, PathBuf},
};

/// How the data lie on disk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(super) enum Format {
    /// By what is there; PNG depth of numbered pictures has 5000 units a metre.
    #[default]
    Auto,
    /// NYU Depth V2 as rgb/N.jpg and depth/N.png in millimetres.
    Nyu,
    /// frame-NNNNNN.color.png, .depth.png, .pose.txt.
    #[value(name = "7scenes")]
    SevenScenes,
    /// The TUM RGB-D benchmark.
    Tum,
    /// color/N.png or rgb/N.png beside depth/N.png, as `realnet sim --dataset` writes.
    Numbered,
    /// N.png beside N_depth.png.
    Pairs,
    /// KITTI depth: val_selection_cropped, or a drive with proj_depth inside.
    Kitti,
}

impl Format {
    fn layout(self) -> Option<RgbdLayout> {
        match self {
            Self::Auto | Self::Kitti => None,
            Self::Nyu | Self::Numbered => Some(RgbdLayout::Numbered),
            Self::SevenScenes => Some(RgbdLayout::SevenScenes),
            Self::Tum => Some(RgbdLayout::Tum),
            Self::Pairs => Some(RgbdLayout::Pairs),
        }
    }
}

/// Which pictures of the data.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Pictures")]
pub(super) struct SelectArgs {
    /// Only the pictures that this file lists: a number, a name or a path a line, such as the
    /// val.txt of `realnet train depth`.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["from", "to"])]
    pub(super) split: Option<PathBuf>,
    /// The first number, as in the names of the pictures.
    #[arg(long, value_name = "N")]
    pub(super) from: Option<u64>,
    /// The last number.
    #[arg(long, value_name = "N")]
    pub(super) to: Option<u64>,
    /// Only the first N of them.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) limit: Option<u32>,
}

/// The data as they were found.
#[derive(Debug)]
pub(super) struct Data {
    pub(super) samples: Vec<Sample>,
    /// In words, for the protocol.
    pub(super) layout: String,
    pub(super) is_kitti: bool,
    pub(super) is_nyu: bool,
    /// The kind of truth that the layout itself tells.
    pub(super) truth: Option<&'static str>,
    /// Whether PNG files were taken to have 5000 units a metre by custom alone.
    pub(super) scale_is_guessed: bool,
    /// Pictures without a depth file.
    pub(super) without_depth: usize,
}

/// A picture and its true depth.
#[derive(Clone, Debug)]
pub(super) struct Sample {
    /// The folder it is from, when there are several.
    pub(super) sequence: Option<String>,
    pub(super) number: u64,
    pub(super) color: PathBuf,
    pub(super) depth: PathBuf,
    /// Units a metre.
    pub(super) scale: f64,
    pub(super) camera: OwnCamera,
}

/// What the data tell about a picture's camera.
#[derive(Clone, Debug)]
pub(super) enum OwnCamera {
    Unknown,
    /// From `camera.yaml` in the folder of the sequence.
    File(PathBuf, CameraModel),
    /// Customary for the named data, for pictures of 640x480.
    Customary(&'static str, Intrinsics),
    /// A file with the nine numbers of a matrix.
    Matrix(PathBuf),
}

/// Of the colour camera, from the toolbox of NYU Depth V2, at 640x480.
const NYU: Intrinsics =
    Intrinsics { fx: 518.857_9, fy: 519.469_61, cx: 325.582_45, cy: 253.736_17 };

impl OwnCamera {
    fn of(sequence: &RgbdSequence, format: Format) -> Result<Self> {
        let file = sequence.folder().join("camera.yaml");
        if file.is_file() {
            let camera = read_camera(&file)?;
            return Ok(Self::File(file, camera));
        }
        if format == Format::Nyu {
            return Ok(Self::Customary("NYU Depth V2", NYU));
        }
        let name = match sequence.layout() {
            RgbdLayout::SevenScenes => "7-Scenes",
            RgbdLayout::Tum => "TUM RGB-D",
            _ => return Ok(Self::Unknown),
        };
        let customary = sequence.layout().customary_intrinsics(640, 480);
        Ok(customary.map_or(Self::Unknown, |own| Self::Customary(name, own)))
    }

    /// In words, for the protocol.
    pub(super) fn words(&self) -> String {
        match self {
            Self::Unknown => "unknown".to_owned(),
            Self::File(..) => "camera.yaml of the data".to_owned(),
            Self::Customary(name, Intrinsics { fx, fy, cx, cy }) => {
                format!("customary of {name}: {fx} {fy} {cx} {cy} at 640x480")
            }
            Self::Matrix(_) => "intrinsics of the data".to_owned(),
        }
    }
}

impl Sample {
    /// The colour picture's name without extension, with its folder if there are several.
    pub(super) fn name(&self) -> PathBuf {
        let stem = PathBuf::from(self.color.file_stem().unwrap_or_default());
        self.sequence.as_ref().map_or(stem.clone(), |sequence| Path::new(sequence).join(stem))
    }

    /// Picture and true depth, which must be of one size.
    pub(super) fn read(&self) -> Result<(Frame, DepthMap)> {
        let frame = picture::read(&self.color)?;
        let truth = realnet_io::depth::read(&self.depth, self.scale, &Limits::default())?;
        let size = (truth.width(), truth.height());
        if size != (frame.width(), frame.height()) {
            return Err(RgbdError::Size {
                color: self.color.clone(),
                color_size: (frame.width(), frame.height()),
                depth: self.depth.clone(),
                depth_size: size,
            }
            .into());
        }
        Ok((frame, truth))
    }

    fn no_camera(&self) -> anyhow::Error {
        bad_input(format!(
            "{}: no camera is known for it: give --fx (and --fy, --cx, --cy), or --camera \
             camera.yaml",
            self.color.display()
        ))
    }

    /// The camera of the flags, else of the data.
    pub(super) fn camera(&self, args: &CameraArgs, width: u32, height: u32) -> Result<CameraModel> {
        if let Some(camera) = args.given(width, height)? {
            return Ok(camera);
        }
        match &self.camera {
            OwnCamera::File(path, camera) => fit(camera, path, width, height),
            OwnCamera::Matrix(path) => kitti::camera(path, width, height),
            OwnCamera::Customary(name, intrinsics) => {
                let camera = CameraModel::new(640, 480, *intrinsics, Distortion::None);
                fit(&camera.or_bad_input()?, Path::new(name), width, height)
            }
            OwnCamera::Unknown => Err(self.no_camera()),
        }
    }
}

impl Data {
    /// Lists a folder: a sequence, or a folder of sequences.
    pub(super) fn open(
        folder: &Path,
        format: Format,
        depth_scale: Option<f64>,
        truth: Option<&str>,
    ) -> Result<Self> {
        if format == Format::Kitti || format == Format::Auto && kitti::is_here(folder) {
            let kind = kitti::Truth::of(truth)?;
            return Ok(Self {
                samples: kitti::list(folder, kind, depth_scale.unwrap_or(kitti::SCALE))?,
                layout: "KITTI depth".to_owned(),
                is_kitti: true,
                is_nyu: false,
                truth: Some(kind.words()),
                scale_is_guessed: false,
                without_depth: 0,
            });
        }
        let sequences = sequences(folder, format, depth_scale)?;
        let several = sequences.len() > 1;
        let mut samples = Vec::new();
        let mut without_depth = 0;
        let (mut layouts, mut scale_is_guessed) = (Vec::new(), false);
        for sequence in &sequences {
            let camera = OwnCamera::of(sequence, format)?;
            let layout = sequence.layout();
            scale_is_guessed |= depth_scale.is_none()
                && sequence.depth_scale() == 5000.0
                && !matches!(layout, RgbdLayout::SevenScenes | RgbdLayout::Tum)
                && !matches!(camera, OwnCamera::File(..));
            let words = layout.to_string();
            if !layouts.contains(&words) {
                layouts.push(words);
            }
            let name = sequence.folder().file_name().unwrap_or_default().to_string_lossy();
            for frame in sequence.frames() {
                let Some(depth) = frame.depth_path.clone() else {
                    without_depth += 1;
                    continue;
                };
                samples.push(Sample {
                    sequence: several.then(|| name.clone().into_owned()),
                    number: frame.number,
                    color: frame.color_path.clone(),
                    depth,
                    scale: sequence.depth_scale(),
                    camera: camera.clone(),
                });
            }
        }
        let is_nyu = format == Format::Nyu;
        Ok(Self {
            samples,
            layout: if is_nyu { "NYU Depth V2".to_owned() } else { layouts.join(", ") },
            is_kitti: false,
            is_nyu,
            truth: None,
            scale_is_guessed,
            without_depth,
        })
    }

    /// Keeps the pictures of `folder` that were asked for.
    pub(super) fn select(&mut self, folder: &Path, args: &SelectArgs) -> Result<()> {
        if let Some(path) = &args.split {
            self.keep_listed(folder, path)?;
        }
        let (from, to) = (args.from.unwrap_or(0), args.to.unwrap_or(u64::MAX));
        if from > to {
            return Err(bad_input(format!("--from {from} is after --to {to}")));
        }
        self.samples.retain(|sample| (from..=to).contains(&sample.number));
        if let Some(limit) = args.limit {
            self.samples.truncate(limit as usize);
        }
        Ok(())
    }

    /// Whether the data tell a camera for each picture.
    pub(super) fn check_cameras(&self) -> Result<()> {
        let without = |sample: &&Sample| matches!(sample.camera, OwnCamera::Unknown);
        self.samples.iter().find(without).map_or(Ok(()), |sample| Err(sample.no_camera()))
    }

    fn keep_listed(&mut self, folder: &Path, path: &Path) -> Result<()> {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read {}", path.display()))
            .or_bad_input()?;
        // A picture is called by its path, its name, its file's name or its number.
        let mut called: HashMap<PathBuf, Vec<usize>> = HashMap::new();
        let mut numbered: HashMap<u64, Vec<usize>> = HashMap::new();
        for (index, sample) in self.samples.iter().enumerate() {
            let (name, file) = (sample.name(), sample.color.file_name().unwrap_or_default());
            called.entry(name).or_default().push(index);
            called.entry(one_path(&sample.color)).or_default().push(index);
            called.entry(PathBuf::from(file)).or_default().push(index);
            numbered.entry(sample.number).or_default().push(index);
        }
        let folder = one_path(folder);
        let mut kept: HashSet<usize> = HashSet::new();
        for (line, words) in (1..).zip(text.lines()) {
            let words = words.split('#').next().unwrap_or_default().trim();
            let name = if Path::new(words).is_absolute() {
                one_path(Path::new(words))
            } else {
                PathBuf::from(words)
            };
            // A list of `realnet train depth` may name pictures of several data sets.
            if words.is_empty() || name.is_absolute() && !name.starts_with(&folder) {
                continue;
            }
            let by_number = words.parse().ok().and_then(|number: u64| numbered.get(&number));
            let found = called.get(&name).into_iter().chain(by_number).flatten();
            let before = kept.len();
            kept.extend(found);
            if kept.len() == before {
                return Err(bad_input(format!(
                    "{}:{line}: no picture with depth is called '{words}', or it stands twice",
                    path.display()
                )));
            }
        }
        let mut index = 0..;
        self.samples.retain(|_| index.next().is_some_and(|index| kept.contains(&index)));
        Ok(())
    }

    /// The part of the picture that `eigen` means for these data.
    pub(super) fn eigen_crop(&self) -> Option<DepthCrop> {
        match (self.is_kitti, self.is_nyu) {
            (true, _) => Some(DepthCrop::Eigen),
            (_, true) => Some(DepthCrop::Nyu),
            _ => None,
        }
    }
}

/// The one path of a file that has many, by links and by `..`.
fn one_path(path: &Path) -> PathBuf {
    std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned())
}

/// The sequence of a folder, or those of its subfolders.
fn sequences(folder: &Path, format: Format, depth_scale: Option<f64>) -> Result<Vec<RgbdSequence>> {
    let default_scale = if format == Format::Nyu { Some(1000.0) } else { None };
    let options = RgbdOptions {
        layout: format.layout(),
        depth_scale: depth_scale.or(default_scale),
        ..RgbdOptions::default()
    };
    let first = match RgbdSequence::open(folder, &options) {
        Ok(sequence) => return Ok(vec![sequence]),
        Err(error) if is_elsewhere(&error) => error,
        Err(error) => return Err(error).or_bad_input(),
    };
    let entries = std::fs::read_dir(folder)
        .with_context(|| format!("cannot list the folder {}", folder.display()))
        .or_bad_input()?;
    let mut folders: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    folders.retain(|path| path.is_dir());
    folders.sort();
    let mut found = Vec::new();
    for path in folders {
        match RgbdSequence::open(&path, &options) {
            Ok(sequence) => found.push(sequence),
            Err(error) if is_elsewhere(&error) => {}
            Err(error) => return Err(error).or_bad_input(),
        }
    }
    if found.is_empty() { Err(first).or_bad_input() } else { Ok(found) }
}

/// Whether a folder is just no sequence.
fn is_elsewhere(error: &RgbdError) -> bool {
    matches!(
        error,
        RgbdError::Unrecognised { .. } | RgbdError::Several { .. } | RgbdError::NoFrames { .. }
    )
}
