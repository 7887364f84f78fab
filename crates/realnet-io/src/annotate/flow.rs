//! Corners and their flow drawn on a frame.

use super::{Annotator, Area, Style, blend, fill, outline, readable_on, whole_pixels};
use ab_glyph::{Font, ScaleFont};
use realnet_core::{BoundingBox, Frame, FrameError, PixelFormat, Stamp};

/// What becomes of a point from one picture to the next, to be drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowMark {
    /// x and y in the earlier picture; (0, 0) is the centre of the first pixel.
    pub from: [f32; 2],
    /// x and y in the later picture; `None` for a point that was lost.
    pub to: Option<[f32; 2]>,
    /// Its colour.
    pub color: [u8; 3],
}

/// Which of the two pictures is drawn on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlowSide {
    /// The earlier picture: each point a dot where it starts.
    Before,
    /// The later picture: a line from where each point was, with a dot where it
    /// is; a cross where a point was lost.
    After,
}

/// The colour of a direction in the picture, as a wheel of hues: right is red,
/// down green-yellow, left cyan and up violet; lightness is about even.
#[must_use]
pub fn direction_color([dx, dy]: [f32; 2]) -> [u8; 3] {
    let turn = dy.atan2(dx) / std::f32::consts::TAU;
    let turn = if turn.is_finite() { turn.rem_euclid(1.0) } else { 0.0 };
    // Hue, at full saturation, mixed with a little white.
    [0.0, 2.0 / 3.0, 1.0 / 3.0].map(|offset: f32| {
        let distance = ((turn + offset).rem_euclid(1.0) * 6.0 - 3.0).abs() - 1.0;
        (255.0 * (0.2 + 0.8 * distance.clamp(0.0, 1.0))).round() as u8
    })
}

/// Two frames side by side with a white seam, grey ones as RGB; the shorter is
/// filled up in white at its lower end. The stamp is that of `right`.
///
/// # Errors
/// [`FrameError`] when the width exceeds 32 bits.
pub fn side_by_side(left: &Frame, right: &Frame) -> Result<Frame, FrameError> {
    let (left, right) = (left.to_rgb(), right.to_rgb());
    let seam = ((left.height() as f32) * 0.01).round().max(2.0) as u32;
    let width = left.width().saturating_add(seam).saturating_add(right.width());
    let height = left.height().max(right.height());
    let mut data = vec![255; width as usize * height as usize * 3];
    let rows = data.chunks_exact_mut(width as usize * 3);
    let row = |frame: &Frame, y: usize| -> std::ops::Range<usize> {
        let stride = frame.stride();
        if y < frame.height() as usize { y * stride..(y + 1) * stride } else { 0..0 }
    };
    for (y, out) in rows.enumerate() {
        for (frame, start) in [(&left, 0), (&right, left.stride() + seam as usize * 3)] {
            if let Some(source) = frame.data().get(row(frame, y))
                && let Some(target) = out.get_mut(start..start + source.len())
            {
                target.copy_from_slice(source);
            }
        }
    }
    let stamp: Stamp = right.stamp();
    Frame::rgb8(stamp, width, height, data)
}

impl Annotator {
    /// Draws points and their flow on one of the two pictures they belong to; a
    /// grey frame becomes RGB first. What lies outside the picture or is not a
    /// finite number is left out. Sizes go with the picture, and a dark rim keeps
    /// every mark visible on any background.
    pub fn draw_flow(&self, frame: &mut Frame, marks: &[FlowMark], side: FlowSide) {
        if frame.format() == PixelFormat::Grey8 {
            *frame = frame.to_rgb();
        }
        let mean = (frame.width() as f32 + frame.height() as f32) / 2.0;
        let radius = (mean * 0.0036).max(2.5);
        let line = (mean * 0.0014).max(0.9);
        // Rims first: none lies on a neighbour's mark.
        for rim in [true, false] {
            for mark in marks {
                let pen = |radius: f32| match rim {
                    true => Pen { radius: radius + 0.75, color: [0; 3], share: 0.55 },
                    false => Pen { radius, color: mark.color, share: 1.0 },
                };
                match (side, mark.to) {
                    (FlowSide::Before, _) => stroke(frame, mark.from, mark.from, &pen(radius)),
                    (FlowSide::After, Some(to)) => {
                        stroke(frame, mark.from, to, &pen(line));
                        stroke(frame, to, to, &pen(radius));
                    }
                    (FlowSide::After, None) => {
                        let [x, y] = mark.from;
                        let arm = radius * 1.1;
                        for (dx, dy) in [(arm, arm), (arm, -arm)] {
                            let (a, b) = ([x - dx, y - dy], [x + dx, y + dy]);
                            stroke(frame, a, b, &pen(line));
                        }
                    }
                }
            }
        }
    }

    /// Draws one box with a text of its own on `frame`; a grey frame becomes RGB
    /// first. A box outside the picture is left out.
    pub fn draw_box(&self, frame: &mut Frame, bbox: &BoundingBox, color: [u8; 3], text: &str) {
        if frame.format() == PixelFormat::Grey8 {
            *frame = frame.to_rgb();
        }
        let style = Style::of(frame);
        let shown = bbox.clipped(frame.width() as f32, frame.height() as f32);
        if !shown.is_proper() {
            return;
        }
        let area = whole_pixels(&shown);
        outline(frame, &area, style.line, color);
        let label = self.place(frame, &style, &area, text, &[]);
        fill(frame, &label, color);
        self.write(frame, &style, &label, text, readable_on(color));
    }

    /// Writes a line of text on a dark band at the lower left of `frame`; a grey
    /// frame becomes RGB first. Text that is too long for the picture is cut off
    /// at its edge.
    pub fn draw_caption(&self, frame: &mut Frame, text: &str) {
        if frame.format() == PixelFormat::Grey8 {
            *frame = frame.to_rgb();
        }
        let style = Style::of(frame);
        let height = self.font.as_scaled(style.text).height().ceil() as i64 + style.margin;
        let width = self.text_width(&style, text).ceil() as i64 + 2 * style.margin;
        let (w, h) = (i64::from(frame.width()), i64::from(frame.height()));
        let band = Area { x0: 0, y0: (h - height).max(0), x1: width.min(w), y1: h };
        for y in band.y0..band.y1 {
            for x in band.x0..band.x1 {
                blend(frame, x, y, [0; 3], 0.65);
            }
        }
        self.write(frame, &style, &band, text, [255; 3]);
    }
}

/// A round brush.
struct Pen {
    /// Pixels.
    radius: f32,
    color: [u8; 3],
    /// How much of the colour covers what is below, 0 to 1.
    share: f32,
}

/// Draws the points that are at most the pen's radius from the segment `a` to
/// `b` (a dot when they are equal), with soft edges one pixel wide. Only pixels
/// of the picture near the segment are visited.
fn stroke(frame: &mut Frame, a: [f32; 2], b: [f32; 2], pen: &Pen) {
    if !a.iter().chain(&b).all(|v| v.is_finite() && v.abs() < 1e6) {
        return;
    }
    let reach = pen.radius + 0.5;
    let span = |low: f32, high: f32, size: u32| {
        // Both within 1e6 of the picture.
        let (low, high) = ((low - reach).ceil() as i64, (high + reach).floor() as i64);
        low.max(0)..=high.min(i64::from(size) - 1)
    };
    let ([ax, ay], [dx, dy]) = (a, [b[0] - a[0], b[1] - a[1]]);
    let square = dx * dx + dy * dy;
    for y in span(ay.min(b[1]), ay.max(b[1]), frame.height()) {
        // The part of the segment that is near this row.
        let (from, to) = if dy.abs() > 1e-6 {
            let at = |y: f32| ((y - ay) / dy).clamp(0.0, 1.0);
            (at(y as f32 - reach), at(y as f32 + reach))
        } else {
            (0.0, 1.0)
        };
        let (x0, x1) = (ax + from * dx, ax + to * dx);
        for x in span(x0.min(x1), x0.max(x1), frame.width()) {
            let (px, py) = (x as f32 - ax, y as f32 - ay);
            let along =
                if square > 0.0 { ((px * dx + py * dy) / square).clamp(0.0, 1.0) } else { 0.0 };
            let distance = (px - along * dx).hypot(py - along * dy);
            let coverage = (reach - distance).clamp(0.0, 1.0) * pen.share;
            if coverage > 0.0 {
                blend(frame, x, y, pen.color, coverage);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn grey(width: u32, height: u32) -> Frame {
        Frame::rgb8(Stamp::ZERO, width, height, vec![100; (width * height * 3) as usize]).unwrap()
    }

    fn annotator() -> Annotator {
        Annotator::new(Vec::new()).unwrap()
    }

    fn at(frame: &Frame, x: u32, y: u32) -> [u8; 3] {
        let start = (y * frame.width() + x) as usize * 3;
        frame.data()[start..start + 3].try_into().unwrap()
    }

    fn stroked(a: [f32; 2], b: [f32; 2], radius: f32) -> Frame {
        let mut frame = grey(40, 30);
        stroke(&mut frame, a, b, &Pen { radius, color: [255; 3], share: 1.0 });
        frame
    }

    #[test]
    fn a_dot_covers_its_area() {
        for (x, y) in [(20.0, 15.0), (20.5, 15.25), (19.7, 14.9)] {
            let frame = stroked([x, y], [x, y], 3.0);
            let covered: f32 =
                frame.data().chunks_exact(3).map(|p| (f32::from(p[0]) - 100.0) / 155.0).sum();
            let area = std::f32::consts::PI * 9.0;
            assert!((covered - area).abs() < 0.03 * area, "{covered} of {area} at {x} {y}");
        }
        assert_eq!(at(&stroked([20.0, 15.0], [20.0, 15.0], 3.0), 20, 15), [255; 3]);
    }

    #[test]
    fn a_line_is_what_all_its_pixels_say() {
        // Against the same coverage computed for every pixel of the picture.
        for (a, b) in [
            ([3.0, 4.0], [30.0, 5.0]),
            ([3.0, 4.0], [5.0, 28.0]),
            ([35.0, 25.0], [-50.0, -60.0]),
            ([-10.0, 7.0], [60.0, 7.0]),
            ([12.3, -9.0], [12.3, 90.0]),
        ] {
            let frame = stroked(a, b, 1.5);
            for y in 0..30 {
                for x in 0..40 {
                    let (px, py) = (x as f32 - a[0], y as f32 - a[1]);
                    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
                    let t = ((px * dx + py * dy) / (dx * dx + dy * dy)).clamp(0.0, 1.0);
                    let share = (2.0 - (px - t * dx).hypot(py - t * dy)).clamp(0.0, 1.0);
                    let wanted = 100.0 + 155.0 * share;
                    let found = f32::from(at(&frame, x, y)[0]);
                    assert!((found - wanted).abs() <= 1.0, "{a:?} {b:?} {x} {y}: {found} {wanted}");
                }
            }
        }
    }

    #[test]
    fn both_sides_of_a_pair_of_pictures() {
        let color = [230, 159, 0];
        let marks = [
            FlowMark { from: [50.0, 60.0], to: Some([90.0, 60.0]), color },
            FlowMark { from: [50.0, 120.0], to: None, color },
        ];
        let (mut before, mut after) = (grey(320, 240), grey(320, 240));
        annotator().draw_flow(&mut before, &marks, FlowSide::Before);
        annotator().draw_flow(&mut after, &marks, FlowSide::After);
        assert_eq!([at(&before, 50, 60), at(&before, 50, 120)], [color; 2]);
        assert_eq!(at(&before, 90, 60), [100; 3]);
        assert_eq!([at(&after, 90, 60), at(&after, 70, 60), at(&after, 52, 122)], [color; 3]);
        // A cross is open between its arms, and a rim is darker than the picture.
        assert_eq!(at(&after, 50, 125), [100; 3]);
        assert!(at(&after, 90, 57)[0] < 100);
    }

    #[test]
    fn directions_have_their_colours() {
        let strongest = |c: [u8; 3]| (0..3).max_by_key(|i| c[*i]).unwrap();
        assert_eq!(direction_color([1.0, 0.0]), [255, 51, 51]);
        assert_eq!(direction_color([-1.0, 0.0]), [51, 255, 255]);
        assert_eq!(strongest(direction_color([0.0, 1.0])), 1);
        assert_eq!(strongest(direction_color([0.0, -1.0])), 2);
        assert_eq!(direction_color([0.0, 0.0]), direction_color([f32::NAN, 1.0]));
    }

    #[test]
    fn frames_side_by_side() {
        let left = Frame::grey8(Stamp::ZERO, 2, 1, vec![7, 8]).unwrap();
        let right = Frame::rgb8(Stamp::from_nanos(5), 1, 2, vec![1, 2, 3, 4, 5, 6]).unwrap();
        let both = side_by_side(&left, &right).unwrap();
        assert_eq!((both.width(), both.height(), both.stamp().nanos()), (5, 2, 5));
        let white = [255; 3];
        let row = |y| (0..5).map(|x| at(&both, x, y)).collect::<Vec<_>>();
        assert_eq!(row(0), [[7; 3], [8; 3], white, white, [1, 2, 3]]);
        assert_eq!(row(1), [white, white, white, white, [4, 5, 6]]);
    }

    #[test]
    fn captions_and_boxes_are_drawn_where_they_belong() {
        let mut frame = grey(320, 240);
        annotator().draw_caption(&mut frame, "frame 7");
        assert_eq!(at(&frame, 1, 238), [35; 3]);
        assert_eq!(at(&frame, 300, 238), [100; 3]);
        assert!((0..80).any(|x| (222..240).any(|y| at(&frame, x, y)[0] > 200)), "no text");
        let mut frame = grey(320, 240);
        let bbox = BoundingBox::new(100.0, 100.0, 200.0, 200.0);
        annotator().draw_box(&mut frame, &bbox, [1, 2, 3], "target");
        assert_eq!([at(&frame, 100, 150), at(&frame, 199, 150)], [[1, 2, 3]; 2]);
        assert_eq!(at(&frame, 150, 150), [100; 3]);
    }

    proptest! {
        #[test]
        fn anything_on_any_picture(
            (w, h) in (1u32..60, 1u32..60),
            v in proptest::array::uniform4(prop_oneof![
                -200.0f32..200.0, Just(f32::NAN), Just(f32::INFINITY), Just(f32::MAX), Just(0.0)
            ]),
            lost: bool,
        ) {
            let mut frame = grey(w, h);
            let to = (!lost).then_some([v[2], v[3]]);
            let marks = [FlowMark { from: [v[0], v[1]], to, color: [9; 3] }];
            for side in [FlowSide::Before, FlowSide::After] {
                annotator().draw_flow(&mut frame, &marks, side);
            }
            annotator().draw_box(&mut frame, &v.into(), [9; 3], "a target");
            annotator().draw_caption(&mut frame, "a caption that is too long for most of them");
        }
    }
}
