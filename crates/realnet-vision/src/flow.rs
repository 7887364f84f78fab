//! Where points of one picture are in another: pyramidal optical flow.

mod kernel;

use crate::pyramid::Level;
use crate::simd::Simd;
use crate::{FlowError, Pyramid};
use kernel::{Patch, Weights};
use realnet_core::Frame;

/// The size of the window that is compared, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    width: u8,
    height: u8,
}

impl Window {
    /// 11 x 11, for small bodies: less of what is around them.
    pub const SMALL: Self = Self { width: 11, height: 11 };

    /// The smallest and the greatest side of a window.
    pub const SIDES: (u32, u32) = (3, 255);

    /// A window of `width` x `height` pixels; odd sides have a pixel as their centre.
    ///
    /// # Errors
    /// [`FlowError::Window`] when a side is not in [`Window::SIDES`].
    pub fn new(width: u32, height: u32) -> Result<Self, FlowError> {
        let side = |side: u32| u8::try_from(side).ok().filter(|s| u32::from(*s) >= Self::SIDES.0);
        match (side(width), side(height)) {
            (Some(width), Some(height)) => Ok(Self { width, height }),
            _ => Err(FlowError::Window { width, height }),
        }
    }

    /// Width and height.
    #[must_use]
    pub fn size(self) -> (usize, usize) {
        (usize::from(self.width), usize::from(self.height))
    }
}

impl Default for Window {
    /// 21 x 21.
    fn default() -> Self {
        Self { width: 21, height: 21 }
    }
}

/// How points are tracked. The defaults are those of OpenCV's
/// `calcOpticalFlowPyrLK`, with a forward-backward check of half a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowOptions {
    /// The window that is compared at each level.
    pub window: Window,
    /// The highest pyramid level; 0 tracks at full size only. Pictures too small
    /// for it have fewer levels, see [`Pyramid`].
    pub max_level: usize,
    /// Most steps at each level, 1 to 100.
    pub max_iterations: u32,
    /// A step of at most this length, in pixels of the level, is the last one.
    pub epsilon: f32,
    /// A window is flat when the smaller eigenvalue of its gradient matrix, per
    /// pixel of the window and in OpenCV's units, is below this.
    pub min_eigenvalue: f32,
    /// Track back to the first picture as well, and refuse points that end more
    /// than this many pixels from where they started. `None` tracks one way, at
    /// half the cost.
    pub max_round_trip: Option<f32>,
}

impl Default for FlowOptions {
    fn default() -> Self {
        Self {
            window: Window::default(),
            max_level: 3,
            max_iterations: 30,
            epsilon: 0.01,
            min_eigenvalue: 1e-4,
            max_round_trip: Some(0.5),
        }
    }
}

/// What became of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TrackStatus {
    /// Found.
    Tracked,
    /// Its window left the picture, or was outside from the start.
    Outside,
    /// Its window has no texture, or texture in one direction only.
    Flat,
    /// Tracked back, it ends elsewhere, or nowhere.
    RoundTrip,
    /// The point or its initial flow is not a finite number.
    NotFinite,
}

/// A point in the other picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Track {
    /// x and y in pixels; where [`TrackStatus`] is not `Tracked`, the last guess.
    pub point: [f32; 2],
    /// Whether `point` can be used, and why not.
    pub status: TrackStatus,
    /// Mean absolute difference of the two windows, in grey values; NaN where
    /// the point was not found.
    pub error: f32,
    /// Distance in pixels between the point and where it comes back to; NaN
    /// where that was not asked for or not found.
    pub round_trip: f32,
}

impl Track {
    /// Whether the point was found.
    #[must_use]
    pub fn is_tracked(&self) -> bool {
        self.status == TrackStatus::Tracked
    }
}

/// Pyramidal Lucas-Kanade tracking of points, after J.-Y. Bouguet, "Pyramidal
/// implementation of the affine Lucas Kanade feature tracker", 2001 (without the
/// affine part), in the fixed point of OpenCV's `calcOpticalFlowPyrLK`.
///
/// Interpolation is OpenCV's bit by bit; sums over the window are exact integers
/// here and 32-bit floats there. Positions differ by rounding that a step or two
/// more or less can raise to some thousandths of a pixel.
///
/// Gradients are computed for the windows of the points alone, not for the whole
/// picture: for some hundreds of points this is less work, and it grows with the
/// points instead of the picture. Nothing is allocated but room for the tracks.
#[derive(Clone, Debug)]
pub struct LucasKanade {
    options: FlowOptions,
    patch: Patch,
    pub(crate) simd: Simd,
}

impl LucasKanade {
    /// A tracker with these options.
    ///
    /// # Errors
    /// [`FlowError::Option`] when a number is out of its range.
    pub fn new(options: FlowOptions) -> Result<Self, FlowError> {
        let refuse =
            |option, value: String, allowed| Err(FlowError::Option { option, value, allowed });
        if options.max_level > Pyramid::MAX_LEVEL {
            return refuse("max_level", options.max_level.to_string(), "0 to 15");
        }
        if !(1..=100).contains(&options.max_iterations) {
            return refuse("max_iterations", options.max_iterations.to_string(), "1 to 100");
        }
        if !(0.0..=10.0).contains(&options.epsilon) {
            return refuse("epsilon", options.epsilon.to_string(), "0 to 10 pixels");
        }
        if !(0.0..=f32::MAX).contains(&options.min_eigenvalue) {
            return refuse("min_eigenvalue", options.min_eigenvalue.to_string(), "0 or more");
        }
        if let Some(round_trip) = options.max_round_trip.filter(|r| !(0.0..=f32::MAX).contains(r)) {
            return refuse("max_round_trip", round_trip.to_string(), "0 or more pixels");
        }
        Ok(Self { options, patch: Patch::new(options.window), simd: Simd::best() })
    }

    /// How it tracks.
    #[must_use]
    pub fn options(&self) -> FlowOptions {
        self.options
    }

    /// An empty pyramid that suits these options.
    #[must_use]
    pub fn pyramid(&self) -> Pyramid {
        Pyramid::new(self.options.max_level, self.options.window)
    }

    /// Replaces the content of `tracks` by where each of `points` of the picture
    /// `from` is in the picture `to`. `initial`, one position in `to` for each
    /// point, is where the search starts; without it, at the point itself.
    ///
    /// The way back starts from the position found, moved by the initial flow
    /// reversed.
    ///
    /// # Errors
    /// [`FlowError::NoPicture`] when a pyramid is empty, [`FlowError::Size`] when
    /// they are of different sizes, [`FlowError::PyramidWindow`] when one was made
    /// for a smaller window, [`FlowError::InitialLength`] when there are not as many
    /// initial positions as points.
    pub fn track(
        &mut self,
        from: &Pyramid,
        to: &Pyramid,
        points: &[[f32; 2]],
        initial: Option<&[[f32; 2]]>,
        tracks: &mut Vec<Track>,
    ) -> Result<(), FlowError> {
        let size = |pyramid: &Pyramid| pyramid.full().map(|level| (level.width(), level.height()));
        let (from_size, to_size) = (size(from)?, size(to)?);
        if from_size != to_size {
            return Err(FlowError::Size { from: from_size, to: to_size });
        }
        for pyramid in [from, to] {
            let (expected, found) = (self.options.window.size(), pyramid.window().size());
            if found.0 < expected.0 || found.1 < expected.1 {
                return Err(FlowError::PyramidWindow { expected, found });
            }
        }
        if let Some(found) = initial.map(<[_]>::len).filter(|n| *n != points.len()) {
            return Err(FlowError::InitialLength { expected: points.len(), found });
        }
        tracks.clear();
        tracks.extend(points.iter().enumerate().map(|(i, &point)| {
            let start = initial.and_then(|initial| initial.get(i)).copied().unwrap_or(point);
            self.track_both_ways(from, to, point, start)
        }));
        Ok(())
    }

    fn track_both_ways(
        &mut self,
        from: &Pyramid,
        to: &Pyramid,
        point: [f32; 2],
        start: [f32; 2],
    ) -> Track {
        let mut track = self.track_point(from, to, point, start);
        let (Some(limit), true) = (self.options.max_round_trip, track.is_tracked()) else {
            return track;
        };
        let start = [0, 1].map(|i| track.point[i] - (start[i] - point[i]));
        let back = self.track_point(to, from, track.point, start);
        if back.is_tracked() {
            track.round_trip = (back.point[0] - point[0]).hypot(back.point[1] - point[1]);
        }
        if !back.is_tracked() || track.round_trip > limit {
            track.status = TrackStatus::RoundTrip;
        }
        track
    }

    fn track_point(
        &mut self,
        from: &Pyramid,
        to: &Pyramid,
        point: [f32; 2],
        start: [f32; 2],
    ) -> Track {
        let mut track = Track {
            point: start,
            status: TrackStatus::NotFinite,
            error: f32::NAN,
            round_trip: f32::NAN,
        };
        if !point.iter().chain(&start).all(|v| v.is_finite()) {
            return track;
        }
        let levels = from.levels().iter().zip(to.levels()).take(self.options.max_level + 1);
        let count = levels.len();
        for (index, (from, to)) in levels.enumerate().rev() {
            let scale = 1.0 / (1_u32 << index) as f32;
            let guess = if index + 1 == count {
                start.map(|v| v * scale)
            } else {
                track.point.map(|v| v * 2.0)
            };
            // What fails at a higher level may still be found at a lower one; the
            // last level decides.
            track = self.track_level((from, to), point.map(|v| v * scale), guess, index == 0);
        }
        track
    }

    /// Steps from `guess` towards the best match of the window around `point`.
    fn track_level(
        &mut self,
        (from, to): (&Level, &Level),
        point: [f32; 2],
        guess: [f32; 2],
        last: bool,
    ) -> Track {
        let (width, height) = self.options.window.size();
        let half = [(width - 1) as f32 * 0.5, (height - 1) as f32 * 0.5];
        let mut track = Track {
            point: guess,
            status: TrackStatus::Outside,
            error: f32::NAN,
            round_trip: f32::NAN,
        };
        let corner = |point: [f32; 2]| [point[0] - half[0], point[1] - half[1]];
        let Some((at, weights)) = self.place(from, corner(point)) else { return track };
        let area = (width * height) as f32;
        let unit = 1.0 / (1 << 20) as f32;
        let [xx, xy, yy] = self.patch.take(self.simd, from, at, weights).map(|s| s as f32 * unit);
        let determinant = xx * yy - xy * xy;
        let difference = xx - yy;
        let spread = (difference * difference + 4.0 * xy * xy).sqrt();
        let eigenvalue = (yy + xx - spread) / (2.0 * area);
        if eigenvalue < self.options.min_eigenvalue || determinant < f32::EPSILON {
            track.status = TrackStatus::Flat;
            return track;
        }
        let inverse = 1.0 / determinant;
        let epsilon = f64::from(self.options.epsilon) * f64::from(self.options.epsilon);
        let mut moving = corner(guess);
        let mut before = [0.0; 2];
        track.status = TrackStatus::Tracked;
        for iteration in 0..self.options.max_iterations {
            let Some((at, weights)) = self.place(to, moving) else {
                track.status = TrackStatus::Outside;
                return track;
            };
            let [x, y] = self.patch.compare(self.simd, to, at, weights).map(|s| s as f32 * unit);
            let step = [(xy * y - yy * x) * inverse, (xy * x - xx * y) * inverse];
            moving = [moving[0] + step[0], moving[1] + step[1]];
            track.point = [moving[0] + half[0], moving[1] + half[1]];
            let [sx, sy] = step.map(f64::from);
            if sx * sx + sy * sy <= epsilon {
                break;
            }
            // Steps that undo each other: the middle is as good as it gets.
            let undone = |i: usize| (step[i] + before[i]).abs() < 0.01;
            if iteration > 0 && undone(0) && undone(1) {
                track.point = [track.point[0] - step[0] * 0.5, track.point[1] - step[1] * 0.5];
                break;
            }
            before = step;
        }
        if last {
            match self.place(to, corner(track.point)) {
                Some((at, weights)) => {
                    track.error = self.patch.mean_difference(self.simd, to, at, weights);
                }
                None => track.status = TrackStatus::Outside,
            }
        }
        track
    }

    /// The pixel and the weights of a window's upper left corner; `None` when the
    /// window has no pixel in the picture.
    fn place(&self, level: &Level, corner: [f32; 2]) -> Option<((isize, isize), Weights)> {
        let (width, height) = self.options.window.size();
        let [x, y] = corner.map(f32::floor);
        let inside = x >= -(width as f32)
            && y >= -(height as f32)
            && x < level.width() as f32
            && y < level.height() as f32;
        let weights = || Weights::new(corner[0] - x, corner[1] - y);
        inside.then(|| ((x as isize, y as isize), weights()))
    }
}

/// Optical flow from each frame to the next: keeps the pyramids of the last two,
/// so that each frame's is built once.
///
/// ```
/// use realnet_core::{Frame, Stamp};
/// use realnet_vision::{Corner, CornerDetector, CornerOptions, FlowOptions, FlowTracker, Track};
///
/// // A checked pattern that moves two pixels to the right.
/// let frame = |shift: usize| {
///     let pixel = |i: usize| if ((i % 64 + 64 - shift) / 8 + i / 64 / 8) % 2 == 0 { 40 } else { 200 };
///     Frame::grey8(Stamp::ZERO, 64, 64, (0..64 * 64).map(pixel).collect())
/// };
/// let mut tracker = FlowTracker::new(FlowOptions::default())?;
/// let mut detector = CornerDetector::new(CornerOptions::default())?;
/// let (mut corners, mut tracks): (Vec<Corner>, Vec<Track>) = Default::default();
/// tracker.push(&frame(0)?);
/// detector.detect(tracker.present(), None, &mut corners)?;
/// let points: Vec<_> = corners.iter().map(|c| c.point).filter(|[x, _]| *x < 50.0).collect();
/// tracker.push(&frame(2)?);
/// tracker.track(&points, None, &mut tracks)?;
/// assert!(tracks[0].is_tracked());
/// assert!((tracks[0].point[0] - points[0][0] - 2.0).abs() < 0.1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct FlowTracker {
    method: LucasKanade,
    previous: Pyramid,
    present: Pyramid,
}

impl FlowTracker {
    /// A tracker that has seen no frame.
    ///
    /// # Errors
    /// As [`LucasKanade::new`].
    pub fn new(options: FlowOptions) -> Result<Self, FlowError> {
        let method = LucasKanade::new(options)?;
        let (previous, present) = (method.pyramid(), method.pyramid());
        Ok(Self { method, previous, present })
    }

    /// Takes the next frame; the present one becomes the previous one.
    pub fn push(&mut self, frame: &Frame) {
        std::mem::swap(&mut self.previous, &mut self.present);
        self.present.build(frame);
    }

    /// The last frame; empty before the first [`FlowTracker::push`].
    #[must_use]
    pub fn present(&self) -> &Pyramid {
        &self.present
    }

    /// The frame before the last; empty before the second [`FlowTracker::push`].
    #[must_use]
    pub fn previous(&self) -> &Pyramid {
        &self.previous
    }

    /// Tracks points of the previous frame to the present one, see
    /// [`LucasKanade::track`].
    ///
    /// # Errors
    /// As [`LucasKanade::track`]; [`FlowError::NoPicture`] before the second frame.
    pub fn track(
        &mut self,
        points: &[[f32; 2]],
        initial: Option<&[[f32; 2]]>,
        tracks: &mut Vec<Track>,
    ) -> Result<(), FlowError> {
        self.method.track(&self.previous, &self.present, points, initial, tracks)
    }
}

#[cfg(test)]
mod tests;
