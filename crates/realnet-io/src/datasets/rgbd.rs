//! RGB-D sequences: colour pictures with depth maps and camera poses.
//!
//! | layout | files | depth scale | stamps |
//! |---|---|---|---|
//! | [`SevenScenes`](RgbdLayout::SevenScenes) | `frame-NNNNNN.color.png` (or `.jpg`), `.depth.png`, `.pose.txt` (4x4, camera to world) in one folder | 1000 | number by frame rate |
//! | [`Tum`](RgbdLayout::Tum) | `rgb.txt`, `depth.txt`, `groundtruth.txt`; or `rgb/` and `depth/` with stamps as names | 5000 | as written |
//! | [`Numbered`](RgbdLayout::Numbered) | `color/N.png` (or `rgb/N`), `depth/N.png` or `.pgm`, `pose.txt` | by the rule below | number by frame rate |
//! | [`Kitti`](RgbdLayout::Kitti) | `image/`, `groundtruth_depth/`, `intrinsics/` of a selection; or `image_02/data/N.png` and `proj_depth/groundtruth/image_02/N.png` of a drive | 256 | number by frame rate |
//! | [`Pairs`](RgbdLayout::Pairs) | `N.png` and `N_depth.png` (or `.pgm`) in one folder, `pose.txt` | by the rule below | number by frame rate |
//!
//! The depth scale is how many units make a metre. Files cannot tell it, so
//! numbered layouts go by their kind: a **PGM has millimetres (1000)**, as it
//! comes from a driver, a **PNG 5000**, as the TUM tools write it. PNG files in
//! millimetres (NYU, ScanNet) need [`RgbdOptions::depth_scale`] 1000.
//!
//! The camera may be told by a file beside the pictures, see [`RgbdFrame::camera`]:
//! `camera.yaml` (ROS), `intrinsics.txt` (`fx fy cx cy`, or the camera matrix), or those
//! of KITTI.
//!
//! `pose.txt` has one pose a line, camera to world, `tx ty tz qx qy qz qw`, for
//! the frames in rising order of their numbers. TUM depth maps are given to
//! colour pictures one to one, the closest stamps first, as the `associate.py`
//! of the benchmark does; poses are interpolated between the two samples around
//! a picture when both are near enough, or else the near one is taken.
//!
//! ```no_run
//! use realnet_io::datasets::rgbd::{RgbdOptions, RgbdSequence};
//!
//! let sequence = RgbdSequence::open("redkitchen/seq-01".as_ref(), &RgbdOptions::default())?;
//! for frame in sequence.frames() {
//!     let (color, depth) = frame.read()?;
//!     drop((frame.number, color.stamp(), depth, frame.world_from_camera));
//! }
//! # Ok::<(), realnet_io::datasets::rgbd::RgbdError>(())
//! ```

mod camera;
mod kitti;
mod numbered;
mod poses;
mod seven_scenes;
#[cfg(test)]
mod tests;
mod tum;

use crate::depth::{self, DepthFileError};
use crate::picture::{self, Limits, PictureError};
use realnet_core::{CameraModel, DepthMap, Frame, Intrinsics, Pose, PoseError, Stamp};
use std::collections::BTreeMap;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// How an RGB-D sequence lies on disk, see the [module](self).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RgbdLayout {
    /// One folder of `frame-NNNNNN.color.png`, `.depth.png`, `.pose.txt`.
    SevenScenes,
    /// The TUM RGB-D benchmark: lists with stamps.
    Tum,
    /// A folder of colour and one of depth, files named by number.
    Numbered,
    /// `N.png` with `N_depth.png` side by side.
    Pairs,
    /// Depth of KITTI: a selection, or a drive.
    Kitti,
}

impl fmt::Display for RgbdLayout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::SevenScenes => "7-Scenes",
            Self::Tum => "TUM",
            Self::Numbered => "numbered folders",
            Self::Pairs => "numbered pairs",
            Self::Kitti => "KITTI depth",
        })
    }
}

impl RgbdLayout {
    /// The intrinsics that are customary for this layout at a picture size, as a
    /// suggestion when nothing better is known. The data carry no calibration.
    ///
    /// At 640x480: 525, 525, 320, 240 for the colour camera of 7-Scenes and 525,
    /// 525, 319.5, 239.5 for TUM (the ROS default of the Kinect). `None` for
    /// other sizes and the numbered layouts, which have no convention.
    #[must_use]
    pub fn customary_intrinsics(self, width: u32, height: u32) -> Option<Intrinsics> {
        match (self, width, height) {
            (Self::SevenScenes, 640, 480) => {
                Some(Intrinsics { fx: 525.0, fy: 525.0, cx: 320.0, cy: 240.0 })
            }
            (Self::Tum, 640, 480) => {
                Some(Intrinsics { fx: 525.0, fy: 525.0, cx: 319.5, cy: 239.5 })
            }
            _ => None,
        }
    }
}

/// How a sequence is to be opened.
#[derive(Clone, Debug, PartialEq)]
pub struct RgbdOptions {
    /// The layout; `None` recognises it.
    pub layout: Option<RgbdLayout>,
    /// Frames a second where the data have no stamps; default 30. The frame
    /// with the lowest number has stamp 0.
    pub fps: f64,
    /// Depth units a metre; `None` takes the layout's.
    pub depth_scale: Option<f64>,
    /// Largest difference of the stamps of things that belong together (TUM),
    /// seconds; default 0.02.
    pub max_stamp_difference: f64,
    /// Size limits of the pictures.
    pub limits: Limits,
}

impl Default for RgbdOptions {
    fn default() -> Self {
        Self {
            layout: None,
            fps: 30.0,
            depth_scale: None,
            max_stamp_difference: 0.02,
            limits: Limits::default(),
        }
    }
}

/// Why an RGB-D sequence cannot be used.
#[derive(Debug, Error)]
pub enum RgbdError {
    /// A file or folder that cannot be read.
    #[error("cannot read {}: {reason}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// What the operating system said.
        reason: io::Error,
    },
    /// Nothing in the folder looks like a sequence.
    #[error(
        "{}: no RGB-D sequence here. Looked for frame-NNNNNN.color.png or .jpg (7-Scenes), rgb.txt \
         or rgb/ with stamps as names (TUM), color/ or rgb/ beside depth/ with numbered pictures, \
         N.png beside N_depth.png, and image/ beside groundtruth_depth/ or image_02/data/ beside \
         proj_depth/groundtruth/image_02/ (KITTI)",
        path.display()
    )]
    Unrecognised {
        /// The folder.
        path: PathBuf,
    },
    /// A folder of several sequences.
    #[error("{}: holds several sequences, open one of them: {}", path.display(), names.join(", "))]
    Several {
        /// The folder.
        path: PathBuf,
        /// Names of the subfolders.
        names: Vec<String>,
    },
    /// A layout was asked for that the folder does not have.
    #[error("{}: no colour pictures in the {layout} layout: {wanted} is missing", path.display())]
    NoFrames {
        /// The folder.
        path: PathBuf,
        /// The layout.
        layout: RgbdLayout,
        /// What was looked for.
        wanted: &'static str,
    },
    /// Two files for one thing.
    #[error("frame {number} has two {what} files, {} and {}", first.display(), second.display())]
    Twice {
        /// Number of the frame.
        number: u64,
        /// `colour` or `depth`.
        what: &'static str,
        /// One file.
        first: PathBuf,
        /// The other.
        second: PathBuf,
    },
    /// A bad line of a text file.
    #[error("{}:{line}: {message}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong.
        message: String,
    },
    /// A text file with a wrong number of values or lines.
    #[error("{}: {message}", path.display())]
    Count {
        /// The file.
        path: PathBuf,
        /// How many there are and how many there should be.
        message: String,
    },
    /// A pose that is no rigid transform.
    #[error("{}{}: {reason}", path.display(), line.map_or(String::new(), |l| format!(":{l}")))]
    Pose {
        /// The file.
        path: PathBuf,
        /// The line, where the file has one pose a line.
        line: Option<usize>,
        /// What is wrong.
        reason: PoseError,
    },
    /// An option with a value that is not possible.
    #[error("{option} of {value} is not possible, it must be {rule}")]
    Option {
        /// Which.
        option: &'static str,
        /// The value.
        value: f64,
        /// What it must be.
        rule: &'static str,
    },
    /// A camera file that cannot be used.
    #[error("{}: {message}", path.display())]
    Camera {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// A frame without a depth file was asked for its depth.
    #[error("frame {name} has no depth map")]
    NoDepth {
        /// Name of the frame.
        name: String,
    },
    /// Colour and depth are not of one size.
    #[error(
        "{} is {}x{}, but {} is {}x{}: depth must be registered to colour, pixel by pixel",
        depth.display(), depth_size.0, depth_size.1, color.display(), color_size.0, color_size.1
    )]
    Size {
        /// The colour file.
        color: PathBuf,
        /// Its width and height.
        color_size: (u32, u32),
        /// The depth file.
        depth: PathBuf,
        /// Its width and height.
        depth_size: (u32, u32),
    },
    /// A colour picture that cannot be read.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// A depth file that cannot be read.
    #[error(transparent)]
    Depth(#[from] DepthFileError),
}

/// One frame of a sequence: where its parts are.
#[derive(Clone, Debug, PartialEq)]
pub struct RgbdFrame {
    /// Number of the frame: as in its file names, or the place in the list (from
    /// 0) for TUM.
    pub number: u64,
    /// Name of the frame: the file name of its colour picture.
    pub name: String,
    /// Time of exposure of the colour picture.
    pub stamp: Stamp,
    /// The colour picture.
    pub color_path: PathBuf,
    /// The depth map, if there is one.
    pub depth_path: Option<PathBuf>,
    /// Time of exposure of the depth map where the data have one of its own
    /// (TUM); it may differ from [`RgbdFrame::stamp`] by
    /// [`RgbdOptions::max_stamp_difference`].
    pub depth_stamp: Option<Stamp>,
    /// Where the camera was (optical frame: z forward, x right, y down), if that
    /// is known.
    pub world_from_camera: Option<Pose>,
    /// The file that tells its camera, if there is one, see [`RgbdFrame::camera`].
    pub camera_path: Option<PathBuf>,
    depth_scale: f64,
    limits: Limits,
}

impl RgbdFrame {
    /// Reads the colour picture, RGB, with the stamp of the frame.
    ///
    /// # Errors
    /// [`RgbdError::Picture`].
    pub fn color(&self) -> Result<Frame, RgbdError> {
        let frame = picture::read_with(&self.color_path, &self.limits, Vec::new())?;
        Ok(frame.with_stamp(self.stamp))
    }

    /// Reads the depth map, metres, with the stamp of the frame it belongs to.
    ///
    /// # Errors
    /// [`RgbdError::NoDepth`] or [`RgbdError::Depth`].
    pub fn depth(&self) -> Result<DepthMap, RgbdError> {
        let Some(path) = &self.depth_path else {
            return Err(RgbdError::NoDepth { name: self.name.clone() });
        };
        Ok(depth::read(path, self.depth_scale, &self.limits)?.with_stamp(self.stamp))
    }

    /// Reads the camera of [`RgbdFrame::camera_path`] for pictures of `width` x `height`
    /// pixels; `None` without one. A `.yaml` is the calibration of ROS, scaled to the size;
    /// `calib_cam_to_cam.txt` that of KITTI; another `.txt` has `fx fy cx cy`, or the nine
    /// numbers of the camera matrix row by row, in pixels of the picture.
    ///
    /// # Errors
    /// [`RgbdError::Read`] or [`RgbdError::Camera`].
    pub fn camera(&self, width: u32, height: u32) -> Result<Option<CameraModel>, RgbdError> {
        let Some(path) = &self.camera_path else { return Ok(None) };
        camera::read(path, &self.color_path, (width, height)).map(Some)
    }

    /// Reads the colour picture, and the depth map if there is one, and checks
    /// that both have one size.
    ///
    /// # Errors
    /// [`RgbdError::Picture`], [`RgbdError::Depth`] or [`RgbdError::Size`].
    pub fn read(&self) -> Result<(Frame, Option<DepthMap>), RgbdError> {
        let color = self.color()?;
        let Some(path) = &self.depth_path else { return Ok((color, None)) };
        let depth = self.depth()?;
        let color_size = (color.width(), color.height());
        let depth_size = (depth.width(), depth.height());
        if color_size != depth_size {
            let (color, depth) = (self.color_path.clone(), path.clone());
            return Err(RgbdError::Size { color, color_size, depth, depth_size });
        }
        Ok((color, Some(depth)))
    }
}

/// An RGB-D sequence: its frames by rising stamp.
#[derive(Clone, Debug, PartialEq)]
pub struct RgbdSequence {
    folder: PathBuf,
    layout: RgbdLayout,
    depth_scale: f64,
    frames: Vec<RgbdFrame>,
}

impl RgbdSequence {
    /// Lists the frames of a folder and reads their poses; pictures are read by
    /// [`RgbdFrame`]. There is at least one frame.
    ///
    /// # Errors
    /// [`RgbdError`] with the file or folder and what is wrong.
    pub fn open(folder: &Path, options: &RgbdOptions) -> Result<Self, RgbdError> {
        check("a frame rate", options.fps, options.fps > 0.0, "above 0")?;
        let difference = options.max_stamp_difference;
        check("a stamp difference", difference, difference >= 0.0, "0 or more seconds")?;
        if let Some(scale) = options.depth_scale {
            check("a depth scale", scale, scale > 0.0, "above 0 units a metre")?;
        }
        let layout = match options.layout {
            Some(layout) => layout,
            None => recognise(folder)?,
        };
        let raw = match layout {
            RgbdLayout::SevenScenes => seven_scenes::list(folder)?,
            RgbdLayout::Tum => tum::list(folder, options.max_stamp_difference)?,
            RgbdLayout::Numbered => numbered::list_folders(folder)?,
            RgbdLayout::Pairs => numbered::list_pairs(folder)?,
            RgbdLayout::Kitti => kitti::list(folder)?,
        };
        let camera_path = camera::beside(folder);
        let first = raw.first().map_or(0, |f| f.number);
        let depth_scale = options.depth_scale.unwrap_or_else(|| default_scale(layout, &raw));
        let frame = |raw: RawFrame| RgbdFrame {
            number: raw.number,
            name: name_of(&raw.color),
            stamp: raw
                .stamp
                .unwrap_or_else(|| Stamp::of_frame(raw.number.saturating_sub(first), options.fps)),
            color_path: raw.color,
            depth_path: raw.depth,
            depth_stamp: raw.depth_stamp,
            world_from_camera: raw.pose,
            camera_path: raw.camera_file.or_else(|| camera_path.clone()),
            depth_scale,
            limits: options.limits,
        };
        let frames = raw.into_iter().map(frame).collect();
        Ok(Self { folder: folder.to_path_buf(), layout, depth_scale, frames })
    }

    /// The folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Its layout.
    #[must_use]
    pub fn layout(&self) -> RgbdLayout {
        self.layout
    }

    /// Depth units a metre.
    #[must_use]
    pub fn depth_scale(&self) -> f64 {
        self.depth_scale
    }

    /// The frames by rising stamp.
    #[must_use]
    pub fn frames(&self) -> &[RgbdFrame] {
        &self.frames
    }
}

/// A frame as a layout lists it.
#[derive(Clone, Debug, Default)]
struct RawFrame {
    number: u64,
    stamp: Option<Stamp>,
    color: PathBuf,
    depth: Option<PathBuf>,
    depth_stamp: Option<Stamp>,
    pose: Option<Pose>,
    camera_file: Option<PathBuf>,
}

fn check(
    option: &'static str,
    value: f64,
    good: bool,
    rule: &'static str,
) -> Result<(), RgbdError> {
    if good && value.is_finite() { Ok(()) } else { Err(RgbdError::Option { option, value, rule }) }
}

fn default_scale(layout: RgbdLayout, frames: &[RawFrame]) -> f64 {
    let is_pgm = |p: &PathBuf| picture::extension(p).as_deref() == Some("pgm");
    match layout {
        RgbdLayout::SevenScenes => 1000.0,
        RgbdLayout::Tum => 5000.0,
        RgbdLayout::Kitti => 256.0,
        RgbdLayout::Numbered | RgbdLayout::Pairs => {
            match frames.iter().find_map(|f| f.depth.as_ref()) {
                Some(path) if is_pgm(path) => 1000.0,
                _ => 5000.0,
            }
        }
    }
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// Which layout a folder has.
fn recognise(folder: &Path) -> Result<RgbdLayout, RgbdError> {
    let entries = entries(folder)?;
    if entries.iter().any(|e| seven_scenes::is_color(&e.name)) {
        return Ok(RgbdLayout::SevenScenes);
    }
    if tum::is_here(folder)? {
        return Ok(RgbdLayout::Tum);
    }
    if numbered::has_folders(folder)? {
        return Ok(RgbdLayout::Numbered);
    }
    if numbered::has_pairs(&entries) {
        return Ok(RgbdLayout::Pairs);
    }
    if kitti::is_here(folder) {
        return Ok(RgbdLayout::Kitti);
    }
    let path = folder.to_path_buf();
    let mut names: Vec<String> = entries
        .into_iter()
        .filter(|e| e.name.to_ascii_lowercase().starts_with("seq") && e.path.is_dir())
        .map(|e| e.name)
        .collect();
    if names.is_empty() {
        return Err(RgbdError::Unrecognised { path });
    }
    names.sort_by(|a, b| natord::compare(a, b).then_with(|| a.cmp(b)));
    Err(RgbdError::Several { path, names })
}

/// A file or folder inside a folder.
struct Entry {
    name: String,
    path: PathBuf,
}

/// What a folder holds, by name, hidden files left out.
fn entries(folder: &Path) -> Result<Vec<Entry>, RgbdError> {
    let failed = |reason| RgbdError::Read { path: folder.to_path_buf(), reason };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if !name.starts_with('.') {
            found.push(Entry { name, path: entry.path() });
        }
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(found)
}

fn read_text(path: &Path) -> Result<String, RgbdError> {
    std::fs::read_to_string(path)
        .map_err(|reason| RgbdError::Read { path: path.to_path_buf(), reason })
}

/// Puts a file into a table by number; two files for one number are an error.
fn insert(
    table: &mut BTreeMap<u64, PathBuf>,
    what: &'static str,
    number: u64,
    path: PathBuf,
) -> Result<(), RgbdError> {
    match table.insert(number, path.clone()) {
        None => Ok(()),
        Some(first) => Err(RgbdError::Twice { number, what, first, second: path }),
    }
}
