//! The box of a target carried from one picture to another by optical flow.
//!
//! [`BoxCarrier`] takes a box from one picture to another, from frame to frame or
//! over a step of a second; what it cannot carry it refuses, with the reason. Over
//! frames: feed each result's [`BoxMotion`] back as the next prediction, and after a
//! refusal try the next frame from the last one that has a box; a blurred frame is
//! passed over that way.

mod align;
mod coarse;
mod fit;
mod view;

use align::Aligner;
use coarse::{CoarseSearch, PLACES};
use realnet_core::BoundingBox;
use realnet_vision::{FlowError, Pyramid};
use thiserror::Error;

/// How a box moves from one picture to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoxMotion {
    /// Shift of the box's centre in pixels, right and down.
    pub shift: [f32; 2],
    /// Its size after, of its size before.
    pub scale: f32,
}

impl BoxMotion {
    /// The box stays where it is.
    pub const NONE: Self = Self { shift: [0.0; 2], scale: 1.0 };

    /// The box after this motion; it may reach outside the picture.
    #[must_use]
    pub fn apply(&self, bbox: &BoundingBox) -> BoundingBox {
        let ((x, y), [dx, dy]) = (bbox.center(), self.shift);
        let (width, height) = (bbox.width() * self.scale, bbox.height() * self.scale);
        BoundingBox::from_center(x + dx, y + dy, width, height)
    }
}

impl BoxMotion {
    /// Whether two motions of a box with this longer side end in each other's reach.
    fn is_close(&self, other: Self, side: f32) -> bool {
        let [dx, dy] = [0, 1].map(|i| self.shift[i] - other.shift[i]);
        dx.hypot(dy) < 0.1 * side && (self.scale / other.scale).ln().abs() < 0.1
    }
}

/// Where and when [`BoxCarrier`] searches. Lengths are in sides of the box: its
/// longer side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchOptions {
    /// Farthest place from the prediction, in sides of the box, along each axis;
    /// 0.1 to 4. The cost grows with its square.
    pub radius: f32,
    /// Smallest and largest size tried, of the size before; 0.25 to 1 and 1 to 4.
    pub scales: (f32, f32),
    /// Sizes tried, evenly on a logarithmic scale; 1 to 15.
    pub steps: u32,
}

impl Default for SearchOptions {
    /// 1.5 sides; half to twice the area, in 5 steps.
    fn default() -> Self {
        let root = std::f32::consts::SQRT_2;
        Self { radius: 1.5, scales: (1.0 / root, root), steps: 5 }
    }
}

impl SearchOptions {
    fn ladder(&self) -> impl Iterator<Item = f32> + use<> {
        let (low, high) = (self.scales.0.ln(), self.scales.1.ln());
        let (steps, last) = (self.steps, self.steps.saturating_sub(1).max(1) as f32);
        let at =
            move |i| if steps == 1 { 1.0 } else { (low + (high - low) * i as f32 / last).exp() };
        (0..steps).map(at)
    }
}

/// How boxes are carried. Lengths are in sides of the box: its longer side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CarryOptions {
    /// Corners tracked inside the box, 8 to 400.
    pub max_points: usize,
    /// Points that must agree on one motion, 3 or more.
    pub min_inliers: usize,
    /// The share of the corners in the box that must agree, 0 to 1.
    pub min_share: f32,
    /// Points agree that are at most this far from the common motion, in sides of
    /// the box; 0.001 to 0.2.
    pub tolerance: f32,
    /// Least similarity of the box's content before and after, -1 to 1.
    pub min_similarity: f32,
    /// A motion found from the prediction alone is taken, without a search, from
    /// this similarity on.
    pub sure_similarity: f32,
    /// The search for boxes that are not where they were predicted; `None` never
    /// searches.
    pub search: Option<SearchOptions>,
}

impl Default for CarryOptions {
    fn default() -> Self {
        Self {
            max_points: 60,
            min_inliers: 6,
            min_share: 0.2,
            tolerance: 0.04,
            min_similarity: 0.5,
            sure_similarity: 0.85,
            search: Some(SearchOptions::default()),
        }
    }
}

/// What became of a point of the box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CarriedPoint {
    /// x and y in the first picture, in pixels; (0, 0) is the centre of the first.
    pub from: [f32; 2],
    /// x and y in the second picture.
    pub to: [f32; 2],
    /// Whether it moves with the box; the others are background, hidden or mistaken.
    pub inlier: bool,
}

/// A carried box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Carried {
    /// The box in the second picture; it may reach outside.
    pub bbox: BoundingBox,
    /// How it got there: the prediction for the next step if speed is constant.
    pub motion: BoxMotion,
    /// Corners that were looked for.
    pub corners: usize,
    /// Corners that were found again, there and back.
    pub tracked: usize,
    /// Corners that move with the box.
    pub inliers: usize,
    /// Correlation of the box's content before and after, -1 to 1.
    pub similarity: f32,
    /// Whether a search was run, because the prediction alone was not sure.
    pub searched: bool,
    /// Standard deviation of the centre in x and y, in pixels. Like `size_sd` it is
    /// that of this step alone: over several, variances add up.
    pub center_sd: [f32; 2],
    /// Standard deviation of width and height, as a share of them.
    pub size_sd: f32,
}

/// Why a box could not be carried.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum CarryError {
    /// An option is out of its range.
    #[error("{option} is {value}, allowed is {allowed}")]
    Option {
        /// Its name.
        option: &'static str,
        /// What was given.
        value: String,
        /// Its range.
        allowed: &'static str,
    },
    /// The two pyramids are not of as many levels.
    #[error("from a pyramid of {from} levels to one of {to}")]
    Levels {
        /// Levels of the first.
        from: usize,
        /// Levels of the second.
        to: usize,
    },
    /// The box or the prediction has an edge that is not a finite number, or no area.
    #[error("the box {bbox:?} moved by {prediction:?} is not a box")]
    Improper {
        /// Left, top, right and bottom edge.
        bbox: [f32; 4],
        /// The motion predicted.
        prediction: BoxMotion,
    },
    /// Less than a quarter of the box lies in the picture, or a side there is
    /// shorter than [`BoxCarrier::MIN_SIDE`].
    #[error(
        "of the box {bbox:?}, {visible:?} lies in the picture of {width}x{height} pixels: too little to carry"
    )]
    OutOfSight {
        /// The box.
        bbox: [f32; 4],
        /// Its part inside the picture.
        visible: [f32; 4],
        /// Pixels a row of the picture.
        width: u32,
        /// Rows of the picture.
        height: u32,
    },
    /// The box has no texture to follow.
    #[error("{corners} corners in the box, at least {needed} are needed")]
    NoTexture {
        /// Corners found.
        corners: usize,
        /// Corners needed.
        needed: usize,
    },
    /// Too few corners were found again in the second picture.
    #[error("{tracked} of {corners} corners were found again, at least {needed} are needed")]
    Lost {
        /// Corners looked for.
        corners: usize,
        /// Corners found again.
        tracked: usize,
        /// Corners needed.
        needed: usize,
    },
    /// The corners found again do not agree on one motion.
    #[error("{inliers} of {tracked} corners agree on a motion, at least {needed} must")]
    NoConsensus {
        /// Corners found again.
        tracked: usize,
        /// Corners that agree.
        inliers: usize,
        /// Corners that must.
        needed: usize,
    },
    /// Where the corners lead, the picture does not look like the box.
    #[error(
        "the content of the box has a correlation of {similarity:.2} with its like, at least {needed:.2} is needed"
    )]
    Unlike {
        /// Correlation of the content before and after.
        similarity: f32,
        /// What it must be.
        needed: f32,
    },
    /// The pictures do not suit.
    #[error(transparent)]
    Picture(#[from] FlowError),
}

/// Carries the box of a target from one picture to another by optical flow alone.
///
/// The box's part of both pictures is resampled so that its longer side has 96
/// pixels: cost, windows and tolerances go with the box, not with the picture.
/// Corners in the box are tracked by Lucas and Kanade's method, there and back,
/// from the predicted motion; the motion (shift and scale) most of them agree on
/// carries the box, if its content is still alike then. If not, an exhaustive
/// search over places and sizes at low resolution gives other motions to start
/// from, which covers fast panning and steps of more than the box's size, and the
/// most alike of those that pass is taken.
///
/// A target that turns by a large angle between the pictures is refused: its sides
/// are not the same surface any more.
///
/// No state but scratch is kept: the same arguments give the same answer.
///
/// ```
/// use realnet_core::{BoundingBox, Frame, Stamp};
/// use realnet_range::carry::{BoxCarrier, CarryOptions, BoxMotion};
/// use realnet_vision::{Pyramid, Window};
///
/// // Blots that move 9 pixels to the right and 4 down.
/// let picture = |dx: f32, dy: f32| {
///     let pixel = |i: u32| {
///         let (x, y) = ((i % 200) as f32 - dx, (i / 200) as f32 - dy);
///         let blots = (x * 0.3 + (y * 0.2).sin() * 3.0).sin() + (y * 0.25 + (x * 0.1).cos() * 4.0).cos();
///         (128.0 + 50.0 * blots) as u8
///     };
///     Frame::grey8(Stamp::ZERO, 200, 150, (0..200 * 150).map(pixel).collect())
/// };
/// let (mut from, mut to) = (Pyramid::new(3, Window::default()), Pyramid::new(3, Window::default()));
/// from.build(&picture(0.0, 0.0)?);
/// to.build(&picture(9.0, 4.0)?);
///
/// let mut carrier = BoxCarrier::new(CarryOptions::default())?;
/// let bbox = BoundingBox::new(60.0, 40.0, 130.0, 100.0);
/// let carried = carrier.carry(&from, &to, &bbox, BoxMotion::NONE)?;
/// assert!(carried.bbox.iou(&bbox.translated(9.0, 4.0)) > 0.95);
/// assert!(carried.center_sd[0] < 2.0); // pixels
///
/// let gone = BoundingBox::new(-90.0, 40.0, -20.0, 100.0);
/// let refused = carrier.carry(&from, &to, &gone, BoxMotion::NONE).unwrap_err();
/// assert!(refused.to_string().contains("too little to carry"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct BoxCarrier {
    options: CarryOptions,
    aligner: Aligner,
    coarse: CoarseSearch,
    points: Vec<CarriedPoint>,
}

/// The outcome of one starting motion.
type Attempt = Result<Carried, CarryError>;

impl BoxCarrier {
    /// Shorter sides of boxes are too few pixels to carry.
    pub const MIN_SIDE: f32 = 8.0;

    /// A carrier with these options.
    ///
    /// # Errors
    /// [`CarryError::Option`] when a number is out of its range.
    pub fn new(options: CarryOptions) -> Result<Self, CarryError> {
        options.check()?;
        Ok(Self {
            options,
            aligner: Aligner::new(&options)?,
            coarse: CoarseSearch::new(),
            points: Vec::new(),
        })
    }

    /// How it carries.
    #[must_use]
    pub fn options(&self) -> CarryOptions {
        self.options
    }

    /// The corners of the last [`BoxCarrier::carry`] that succeeded; empty if it
    /// did not.
    #[must_use]
    pub fn points(&self) -> &[CarriedPoint] {
        &self.points
    }

    /// Carries `bbox` from the picture `from` to the picture `to`, of the same size.
    /// `prediction` is where to look first: the motion of the last step, say, or
    /// [`BoxMotion::NONE`].
    ///
    /// # Errors
    /// [`CarryError`], with the reason of the start that came closest.
    pub fn carry(
        &mut self,
        from: &Pyramid,
        to: &Pyramid,
        bbox: &BoundingBox,
        prediction: BoxMotion,
    ) -> Result<Carried, CarryError> {
        self.points.clear();
        self.check(from, to, bbox, prediction)?;
        self.aligner.start(from, bbox, &self.options)?;
        let mut best = self.attempt(to, bbox, prediction, None);
        let Some(search) = self.options.search.filter(|_| !self.is_sure(&best)) else {
            return best;
        };
        let mut places = [None; PLACES];
        let found = self.coarse.run((from, to), bbox, prediction, &search);
        for (motion, place) in places.iter_mut().zip(found) {
            *motion = Some(place.motion);
        }
        let side = bbox.width().max(bbox.height());
        for start in places.into_iter().flatten() {
            // From there it would lead to the same place again.
            if best.as_ref().is_ok_and(|carried| carried.motion.is_close(start, side)) {
                continue;
            }
            best = self.attempt(to, bbox, start, Some(best));
            if self.is_sure(&best) {
                break;
            }
        }
        best.map(|carried| Carried { searched: true, ..carried })
    }

    fn is_sure(&self, attempt: &Attempt) -> bool {
        attempt.as_ref().is_ok_and(|carried| carried.similarity >= self.options.sure_similarity)
    }

    /// Aligns from one starting motion. Returns the better of the outcome and
    /// `before`, and keeps the points that belong to it.
    fn attempt(
        &mut self,
        to: &Pyramid,
        bbox: &BoundingBox,
        start: BoxMotion,
        before: Option<Attempt>,
    ) -> Attempt {
        let attempt = self.aligner.align(to, bbox, start, &self.options);
        match before {
            Some(before) if rank(&before) >= rank(&attempt) => before,
            _ => {
                self.points.clear();
                if attempt.is_ok() {
                    self.points.extend_from_slice(self.aligner.carried());
                }
                attempt
            }
        }
    }

    fn check(
        &self,
        from: &Pyramid,
        to: &Pyramid,
        bbox: &BoundingBox,
        prediction: BoxMotion,
    ) -> Result<(), CarryError> {
        let size = |pyramid: &Pyramid| pyramid.full().map(|level| (level.width(), level.height()));
        let (from_levels, to_levels) = (from.levels().len(), to.levels().len());
        let (from, to) = (size(from)?, size(to)?);
        if from != to {
            return Err(FlowError::Size { from, to }.into());
        }
        if from_levels != to_levels {
            return Err(CarryError::Levels { from: from_levels, to: to_levels });
        }
        let moved = prediction.apply(bbox);
        if !bbox.is_proper() || !moved.is_proper() || bbox.area() > 1e12 || moved.area() > 1e12 {
            return Err(CarryError::Improper { bbox: (*bbox).into(), prediction });
        }
        in_sight(bbox, from)
    }
}

/// Whether enough of a box lies in the picture.
fn in_sight(bbox: &BoundingBox, (width, height): (u32, u32)) -> Result<(), CarryError> {
    let visible = bbox.clipped(width as f32, height as f32);
    let sides = visible.width().min(visible.height());
    if sides >= BoxCarrier::MIN_SIDE && visible.area() >= 0.25 * bbox.area() {
        return Ok(());
    }
    Err(CarryError::OutOfSight { bbox: (*bbox).into(), visible: visible.into(), width, height })
}

/// Orders attempts: how alike, or how far it got.
fn rank(attempt: &Attempt) -> f32 {
    let share = |count: usize, of: usize| count as f32 / of.max(1) as f32;
    match *attempt {
        Ok(carried) => carried.similarity,
        Err(CarryError::Unlike { similarity, .. }) => similarity - 3.0,
        Err(CarryError::OutOfSight { .. }) => -5.0,
        Err(CarryError::NoConsensus { tracked, inliers, .. }) => share(inliers, tracked) - 7.0,
        Err(CarryError::Lost { corners, tracked, .. }) => share(tracked, corners) - 9.0,
        Err(_) => -10.0,
    }
}

impl CarryOptions {
    fn check(&self) -> Result<(), CarryError> {
        let refuse =
            |option, value: String, allowed| Err(CarryError::Option { option, value, allowed });
        if !(8..=400).contains(&self.max_points) {
            return refuse("max_points", self.max_points.to_string(), "8 to 400");
        }
        if !(3..=self.max_points).contains(&self.min_inliers) {
            return refuse("min_inliers", self.min_inliers.to_string(), "3 to max_points");
        }
        if !(0.0..=1.0).contains(&self.min_share) {
            return refuse("min_share", self.min_share.to_string(), "0 to 1");
        }
        if !(0.001..=0.2).contains(&self.tolerance) {
            return refuse(
                "tolerance",
                self.tolerance.to_string(),
                "0.001 to 0.2 sides of the box",
            );
        }
        for (option, value) in
            [("min_similarity", self.min_similarity), ("sure_similarity", self.sure_similarity)]
        {
            if !(-1.0..=1.0).contains(&value) {
                return refuse(option, value.to_string(), "-1 to 1");
            }
        }
        let Some(search) = self.search else { return Ok(()) };
        if !(0.1..=4.0).contains(&search.radius) {
            return refuse("search.radius", search.radius.to_string(), "0.1 to 4 sides of the box");
        }
        let (low, high) = search.scales;
        if !(0.25..=1.0).contains(&low) || !(1.0..=4.0).contains(&high) {
            return refuse("search.scales", format!("{low} to {high}"), "0.25 to 1 and 1 to 4");
        }
        if !(1..=15).contains(&search.steps) {
            return refuse("search.steps", search.steps.to_string(), "1 to 15");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
