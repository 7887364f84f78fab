//! A data set of pictures with depth, checked.

use super::source::{DepthPart, DepthSource, SourceCamera, SourceList};
use crate::cache::{Cache, in_parallel};
use crate::check::{CheckReport, Finding, Problem};
use crate::detect::reason;
use crate::warp::render_depth;
use crate::{DataError, SampleError, SetOptions};
use realnet_core::nalgebra::Matrix3;
use realnet_core::{CameraModel, DepthMap, Frame, Intrinsics, OptionError, PixelFormat};
use realnet_io::datasets::rgbd::{RgbdError, RgbdFrame};
use realnet_io::picture::PictureError;
use realnet_vision::{Filter, Letterbox, Region, resize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// How depth sets are read.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthSetOptions {
    /// Input of the network, (width, height) in pixels.
    pub size: (u32, u32),
    /// Pictures are kept in memory so many times as large as the network sees them whole,
    /// though not larger than they are: room for zooming in. 1 for validation, where
    /// pictures then are, to the byte, what a network gets at run time; default 1.25.
    pub oversample: f64,
    /// Threads, memory and limits.
    pub set: SetOptions,
}

impl DepthSetOptions {
    /// To learn from, for a network with an input of (width, height) pixels.
    #[must_use]
    pub fn training(size: (u32, u32)) -> Self {
        Self { size, oversample: 1.25, set: SetOptions::default() }
    }

    /// To measure with.
    #[must_use]
    pub fn validation(size: (u32, u32)) -> Self {
        Self { oversample: 1.0, ..Self::training(size) }
    }

    fn check(&self) -> Result<(), OptionError> {
        for (name, side) in [("width", self.size.0), ("height", self.size.1)] {
            let ok = (8..=4096).contains(&side);
            OptionError::check(name, f64::from(side), ok, "from 8 to 4096 pixels")?;
        }
        let ok = (1.0..=4.0).contains(&self.oversample);
        OptionError::check("oversample", self.oversample, ok, "from 1 to 4")
    }
}

/// A picture, its depth in metres (0 is unknown) pixel by pixel, and its camera.
#[derive(Clone, Debug, PartialEq)]
pub struct RgbdPicture {
    /// The picture.
    pub frame: Frame,
    /// The depth of its pixels.
    pub depth: DepthMap,
    /// The camera, for the size of the picture.
    pub camera: CameraModel,
}

/// A picture as it is kept: RGB, about as large as the network sees it.
#[derive(Debug)]
pub(crate) struct Kept {
    pub(crate) frame: Frame,
    pub(crate) depth: DepthMap,
    pub(crate) camera: Intrinsics,
}

impl Kept {
    fn bytes(&self) -> usize {
        self.frame.data().len() + 4 * self.depth.data().len()
    }
}

/// Where a picture comes from.
#[derive(Clone, Debug)]
struct Origin {
    frame: RgbdFrame,
    camera: Option<SourceCamera>,
    max_depth: Option<f32>,
    /// Folder of its source.
    source: PathBuf,
}

/// Pictures with depth, all of which were read once and found good.
///
/// A lens stays in the picture: neither the picture nor the depth map is rectified, and
/// [`DepthSample::camera`](crate::DepthSample::camera) is the camera without it. At run
/// time a network gets pictures with their lens, too.
#[derive(Debug)]
pub struct DepthSet {
    size: (u32, u32),
    oversample: f64,
    /// `None` for pictures that were given in memory.
    origins: Vec<Option<Origin>>,
    keys: Vec<usize>,
    report: CheckReport,
    cache: Cache<Kept>,
}

/// Why a picture is left out, or the set is refused.
enum Trouble {
    Finding(Finding),
    Refused(Box<DataError>),
}

impl DepthSet {
    /// Reads and checks one part of the sources.
    ///
    /// All pictures and depth maps are decoded, by several threads, and kept in memory as
    /// far as [`SetOptions::cache_bytes`] allows. Pictures that are missing, broken, or
    /// without any known depth are left out and counted, see [`DepthSet::report`].
    ///
    /// # Errors
    /// [`DataError`] for a source that cannot be listed, [`DataError::NoCamera`] or
    /// [`DataError::Camera`] for one whose camera is not known or does not fit,
    /// [`DataError::NothingLeft`], [`DataError::Option`].
    pub fn open(
        list: &SourceList,
        part: DepthPart,
        options: &DepthSetOptions,
    ) -> Result<Self, DataError> {
        options.check()?;
        let mut origins = Vec::new();
        for source in &list.sources {
            let DepthSource { path, camera, max_depth, .. } = source;
            let (camera, max_depth) = (*camera, *max_depth);
            for frame in source.frames(part, &options.set.limits)? {
                origins.push(Origin { frame, camera, max_depth, source: path.clone() });
            }
        }
        let cache = Cache::new(options.set.cache_bytes);
        let threads = crate::threads(options.set.threads);
        let results = in_parallel(origins.len(), threads, |index| {
            let Some(origin) = origins.get(index) else { return Ok(None) };
            let (picture, finding) = clean(origin.read()?, origin)?;
            let kept = Arc::new(fitted(picture, options.size, options.oversample));
            cache.offer(index, &kept, kept.bytes());
            Ok(finding)
        });
        let mut report = CheckReport { pictures: origins.len(), ..CheckReport::default() };
        let mut keys = Vec::new();
        for (key, (result, origin)) in results.into_iter().zip(&origins).enumerate() {
            match result {
                Ok(Ok(finding)) => {
                    report.findings.extend(finding);
                    keys.push(key);
                }
                Ok(Err(Trouble::Finding(finding))) => report.findings.push(finding),
                Ok(Err(Trouble::Refused(error))) => return Err(*error),
                Err(panic) => {
                    let path = &origin.frame.color_path;
                    report.findings.push(Finding::new(Problem::BrokenImage, path, panic));
                }
            }
        }
        let origins = keys.iter().filter_map(|&key| origins.get(key).cloned()).map(Some).collect();
        Self::build(options, origins, keys, report, cache)
    }

    /// A set of pictures in memory, checked as those of files are.
    ///
    /// # Errors
    /// As [`DepthSet::open`].
    pub fn from_memory(
        pictures: Vec<RgbdPicture>,
        options: &DepthSetOptions,
    ) -> Result<Self, DataError> {
        options.check()?;
        let cache = Cache::new(usize::MAX);
        let mut report = CheckReport { pictures: pictures.len(), ..CheckReport::default() };
        let (mut keys, mut origins) = (Vec::new(), Vec::new());
        for (key, picture) in pictures.into_iter().enumerate() {
            let path = PathBuf::from(format!("picture {key}"));
            match usable(picture, &path, None) {
                Ok((picture, finding)) => {
                    report.findings.extend(finding);
                    let kept = Arc::new(fitted(picture, options.size, options.oversample));
                    cache.offer(key, &kept, kept.bytes());
                    keys.push(key);
                    origins.push(None);
                }
                Err(finding) => report.findings.push(finding),
            }
        }
        Self::build(options, origins, keys, report, cache)
    }

    fn build(
        options: &DepthSetOptions,
        origins: Vec<Option<Origin>>,
        keys: Vec<usize>,
        mut report: CheckReport,
        cache: Cache<Kept>,
    ) -> Result<Self, DataError> {
        report.usable = keys.len();
        report.cached = cache.used();
        if keys.is_empty() {
            return Err(DataError::NothingLeft { report: Box::new(report) });
        }
        let DepthSetOptions { size, oversample, .. } = *options;
        Ok(Self { size, oversample, origins, keys, report, cache })
    }

    /// Usable pictures.
    #[must_use]
    pub fn len(&self) -> usize {
        self.keys.len()
    }

    /// Never true: a set without usable pictures is refused.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.keys.is_empty()
    }

    /// Input of the network, (width, height) in pixels.
    #[must_use]
    pub fn size(&self) -> (u32, u32) {
        self.size
    }

    /// The file of a picture; `None` for one given in memory, and beyond the last one.
    #[must_use]
    pub fn path(&self, index: usize) -> Option<&Path> {
        let origin = self.origins.get(index)?.as_ref()?;
        Some(&origin.frame.color_path)
    }

    /// What was found when the set was read, to be shown before training.
    #[must_use]
    pub fn report(&self) -> &CheckReport {
        &self.report
    }

    /// The picture of an index as it is kept.
    pub(crate) fn kept(&self, index: usize) -> Result<Arc<Kept>, SampleError> {
        let path = self.path(index).map(Path::to_path_buf).unwrap_or_default();
        let failed = |reason: String| SampleError { index, path: path.clone(), reason };
        let Some(&key) = self.keys.get(index) else {
            return Err(failed(format!("the set has {} pictures", self.keys.len())));
        };
        self.cache.get_or(key, Kept::bytes, || {
            let Some(Some(origin)) = self.origins.get(index) else {
                return Err(failed("it is no longer in memory".to_owned()));
            };
            let read = origin.read().and_then(|picture| clean(picture, origin));
            match read {
                Ok((picture, _)) => Ok(fitted(picture, self.size, self.oversample)),
                Err(Trouble::Finding(finding)) => Err(failed(finding.detail)),
                Err(Trouble::Refused(error)) => Err(failed(error.to_string())),
            }
        })
    }
}

impl Origin {
    fn read(&self) -> Result<RgbdPicture, Trouble> {
        let path = &self.frame.color_path;
        let finding =
            |problem, detail: String| Trouble::Finding(Finding::new(problem, path, detail));
        let frame = match self.frame.color() {
            Ok(frame) => frame,
            Err(RgbdError::Picture(PictureError::Read { reason, .. }))
                if reason.kind() == std::io::ErrorKind::NotFound =>
            {
                return Err(finding(Problem::MissingImage, reason.to_string()));
            }
            Err(RgbdError::Picture(error)) => {
                return Err(finding(Problem::BrokenImage, reason(&error)));
            }
            Err(error) => return Err(finding(Problem::BrokenImage, error.to_string())),
        };
        let (width, height) = (frame.width(), frame.height());
        let depth = match self.frame.depth() {
            Ok(depth) => depth,
            Err(RgbdError::NoDepth { .. }) => {
                return Err(finding(Problem::NoDepth, "no depth map".to_owned()));
            }
            Err(error) => return Err(finding(Problem::BrokenDepth, error.to_string())),
        };
        let refused = |error| Trouble::Refused(Box::new(error));
        let camera = match &self.camera {
            Some(camera) => camera
                .at(width, height)
                .map_err(|message| refused(DataError::Camera { path: path.clone(), message }))?,
            None => match self.frame.camera(width, height) {
                Ok(Some(camera)) => camera,
                Ok(None) => return Err(refused(DataError::NoCamera { path: self.source.clone() })),
                Err(error) => return Err(finding(Problem::BadCamera, error.to_string())),
            },
        };
        Ok(RgbdPicture { frame, depth, camera })
    }
}

/// What can be learned from of a picture that was read.
fn clean(picture: RgbdPicture, origin: &Origin) -> Result<(RgbdPicture, Option<Finding>), Trouble> {
    usable(picture, &origin.frame.color_path, origin.max_depth).map_err(Trouble::Finding)
}

/// The picture with all that is no depth made unknown; or why it cannot be used.
fn usable(
    mut picture: RgbdPicture,
    path: &Path,
    max_depth: Option<f32>,
) -> Result<(RgbdPicture, Option<Finding>), Finding> {
    let size = (picture.frame.width(), picture.frame.height());
    let found = (picture.depth.width(), picture.depth.height());
    let camera = (picture.camera.width(), picture.camera.height());
    if found != size {
        let detail = format!(
            "the picture has {}x{} pixels, its depth map {}x{}",
            size.0, size.1, found.0, found.1
        );
        return Err(Finding::new(Problem::SizeMismatch, path, detail));
    }
    if camera != size {
        let detail = format!(
            "the picture has {}x{} pixels, its camera is for {}x{}",
            size.0, size.1, camera.0, camera.1
        );
        return Err(Finding::new(Problem::BadCamera, path, detail));
    }
    let most = max_depth.unwrap_or(f32::INFINITY);
    let (mut strange, mut known) = (0usize, 0usize);
    for depth in picture.depth.data_mut() {
        if DepthMap::is_known(*depth) && *depth <= most {
            known += 1;
        } else {
            strange += usize::from(!depth.is_finite() || *depth < 0.0);
            *depth = DepthMap::UNKNOWN;
        }
    }
    if known == 0 {
        let detail = match max_depth {
            Some(most) => format!("no depth is known up to {most} m"),
            None => "no depth is known".to_owned(),
        };
        return Err(Finding::new(Problem::DepthUnknown, path, detail));
    }
    let finding = (strange > 0).then(|| {
        let detail = format!("{strange} of {} depths", picture.depth.data().len());
        Finding::new(Problem::DepthNotFinite, path, detail)
    });
    Ok((picture, finding))
}

/// Gives pixels of a smaller map that know no depth the median of what is known in their
/// footprint: of LiDAR's sparse points, nearly all would be lost between the pixels.
fn fill_from_footprints(depths: &mut [f32], map: &DepthMap, (width, height): (u32, u32)) {
    let footprint = |place: u32, count: u32, full: u32| {
        let edge = |place: u32| (u64::from(place) * u64::from(full) / u64::from(count)) as u32;
        edge(place)..edge(place + 1)
    };
    let mut known = Vec::new();
    for (y, row) in (0..height).zip(depths.chunks_exact_mut(width as usize)) {
        for (x, depth) in (0..width).zip(row) {
            if DepthMap::is_known(*depth) {
                continue;
            }
            known.clear();
            let columns = footprint(x, width, map.width());
            for line in footprint(y, height, map.height()).map(|line| map.row(line)) {
                let part = line.get(columns.start as usize..columns.end as usize);
                known.extend(part.unwrap_or(&[]).iter().filter(|d| DepthMap::is_known(**d)));
            }
            known.sort_unstable_by(f32::total_cmp);
            *depth = known.get(known.len() / 2).copied().unwrap_or(DepthMap::UNKNOWN);
        }
    }
}

/// As it is kept.
fn fitted(picture: RgbdPicture, size: (u32, u32), oversample: f64) -> Kept {
    let RgbdPicture { frame, depth, camera } = picture;
    let frame = if frame.format() == PixelFormat::Rgb8 { frame } else { frame.to_rgb() };
    let full = (frame.width(), frame.height());
    let seen = Letterbox::fit(Region::whole(&frame), size).scaled_size();
    let target = if oversample <= 1.0 {
        seen
    } else {
        let side =
            |seen: u32, full: u32| ((f64::from(seen) * oversample).round() as u32).min(full).max(1);
        (side(seen.0, full.0), side(seen.1, full.1))
    };
    if target == full {
        return Kept { frame, depth, camera: camera.intrinsics() };
    }
    let [sx, sy] =
        [f64::from(full.0) / f64::from(target.0), f64::from(full.1) / f64::from(target.1)];
    let scale = Matrix3::new(sx, 0.0, 0.0, 0.0, sy, 0.0, 0.0, 0.0, 1.0);
    let mut depths = Vec::with_capacity(target.0 as usize * target.1 as usize);
    render_depth(&depth, &scale, target, |value| depths.push(value));
    fill_from_footprints(&mut depths, &depth, target);
    // The sides are at least 1 and the values as many as pixels, so none of these fails.
    match (
        resize(&frame, target.0, target.1, Filter::Triangle),
        DepthMap::new(depth.stamp(), target.0, target.1, depths),
        camera.scaled(target.0, target.1),
    ) {
        (Ok(frame), Ok(depth), Ok(camera)) => Kept { frame, depth, camera: camera.intrinsics() },
        _ => Kept { frame, depth, camera: camera.intrinsics() },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::Stamp;

    /// One point in sixteen, as of a LiDAR, and none where it has no points.
    #[test]
    fn sparse_depths_survive_a_reduction() {
        let (width, height) = (64_u32, 32_u32);
        let depth = |x: u32, y: u32| {
            if x % 4 == 3 && y % 4 == 3 && x < 32 { 2.0 + f32::from(y as u8) } else { 0.0 }
        };
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let data = pixels.map(|(x, y)| depth(x, y)).collect();
        let map = DepthMap::new(Stamp::ZERO, width, height, data).unwrap();
        let mut depths = vec![0.0; 16 * 8];
        depths[5] = 9.0;
        fill_from_footprints(&mut depths, &map, (16, 8));
        assert_eq!(depths[5], 9.0, "what is known stays");
        for (place, depth) in depths.iter().enumerate().filter(|(place, _)| *place != 5) {
            let (x, y) = (place % 16, place / 16);
            let wanted = if x < 8 { 2.0 + (4 * y + 3) as f32 } else { 0.0 };
            assert_eq!(*depth, wanted, "{x}, {y}");
        }
    }
}
