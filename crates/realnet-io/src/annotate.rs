//! Boxes, labels, corners and their flow drawn on a frame.

mod depth;
mod flow;

pub use depth::{depth_colors, depth_error_colors};
pub use flow::{FlowMark, FlowSide, direction_color, side_by_side};

use ab_glyph::{Font, FontRef, GlyphId, InvalidFont, PxScale, ScaleFont, point};
use realnet_core::{BoundingBox, Detection, Frame, PixelFormat};

/// Class colours that stay apart with the common kinds of colour blindness: the
/// seven hues of Okabe and Ito (2008), then seven of Paul Tol's "muted" scheme.
/// Class `i` has colour `i % 14`.
pub const PALETTE: [[u8; 3]; 14] = [
    [86, 180, 233],
    [230, 159, 0],
    [0, 158, 115],
    [240, 228, 66],
    [204, 121, 167],
    [213, 94, 0],
    [0, 114, 178],
    [136, 204, 238],
    [204, 102, 119],
    [17, 119, 51],
    [221, 204, 119],
    [170, 68, 153],
    [68, 170, 153],
    [153, 153, 51],
];

/// The colour of a class.
#[must_use]
pub fn class_color(class_id: u32) -> [u8; 3] {
    PALETTE[class_id as usize % PALETTE.len()]
}

/// Draws detections; owns the class names and the font (Hack, built in).
#[derive(Debug)]
pub struct Annotator {
    names: Vec<String>,
    font: FontRef<'static>,
    with_confidence: bool,
}

/// Edges of a drawn area in whole pixels, right and bottom excluded.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Area {
    x0: i64,
    y0: i64,
    x1: i64,
    y1: i64,
}

impl Area {
    fn overlaps(&self, other: &Self) -> bool {
        self.x0 < other.x1 && other.x0 < self.x1 && self.y0 < other.y1 && other.y0 < self.y1
    }
}

/// Sizes that fit the picture.
#[derive(Clone, Copy, Debug)]
struct Style {
    line: i64,
    text: PxScale,
    margin: i64,
}

impl Style {
    fn of(frame: &Frame) -> Self {
        let mean = (frame.width() as f32 + frame.height() as f32) / 2.0;
        let text = (mean * 0.021).max(12.0);
        Self {
            line: (mean * 0.003).round().max(2.0) as i64,
            text: PxScale::from(text),
            margin: (text * 0.25).round() as i64,
        }
    }
}

impl Annotator {
    /// An annotator for these class names, by class index. A class without a
    /// name is drawn as its number.
    ///
    /// # Errors
    /// [`InvalidFont`] if the built-in font were damaged.
    pub fn new(names: Vec<String>) -> Result<Self, InvalidFont> {
        let font = FontRef::try_from_slice(epaint_default_fonts::HACK_REGULAR)?;
        Ok(Self { names, font, with_confidence: true })
    }

    /// Writes names alone: for labels, which have no confidence.
    #[must_use]
    pub fn without_confidence(self) -> Self {
        Self { with_confidence: false, ..self }
    }

    /// Draws boxes with name and confidence on `frame`; a grey frame becomes
    /// RGB first. Boxes are clipped to the picture, empty ones are left out, and
    /// every label lies inside the picture. The most confident is on top.
    pub fn draw(&self, frame: &mut Frame, detections: &[Detection]) {
        if frame.format() == PixelFormat::Grey8 {
            *frame = frame.to_rgb();
        }
        let style = Style::of(frame);
        let (width, height) = (frame.width() as f32, frame.height() as f32);
        let mut shown: Vec<(&Detection, Area)> = detections
            .iter()
            .map(|d| (d, d.bbox.clipped(width, height)))
            .filter(|(_, b)| b.is_proper())
            .map(|(d, b)| (d, whole_pixels(&b)))
            .collect();
        shown.sort_by(|a, b| a.0.confidence.total_cmp(&b.0.confidence));
        for (detection, area) in &shown {
            outline(frame, area, style.line, class_color(detection.class_id));
        }
        // The most confident first, so that it gets the best place …
        let mut placed: Vec<Area> = Vec::new();
        let mut labels = Vec::new();
        for (detection, area) in shown.iter().rev() {
            let text = self.text_of(detection);
            let label = self.place(frame, &style, area, &text, &placed);
            placed.push(label);
            labels.push((class_color(detection.class_id), label, text));
        }
        // … and last on the picture, so that nothing lies on it.
        for (color, label, text) in labels.iter().rev() {
            fill(frame, label, *color);
            self.write(frame, &style, label, text, readable_on(*color));
        }
    }

    fn text_of(&self, detection: &Detection) -> String {
        let name = match self.names.get(detection.class_id as usize) {
            Some(name) => name.clone(),
            None => detection.class_id.to_string(),
        };
        if self.with_confidence { format!("{name} {:.2}", detection.confidence) } else { name }
    }

    /// Where the label goes: above the box, else inside its top, below it or
    /// inside its bottom; the first place that is free of other labels.
    fn place(
        &self,
        frame: &Frame,
        style: &Style,
        area: &Area,
        text: &str,
        placed: &[Area],
    ) -> Area {
        let scaled = self.font.as_scaled(style.text);
        let width = self.text_width(style, text).ceil() as i64 + 2 * style.margin;
        let height = scaled.height().ceil() as i64 + style.margin;
        let (w, h) = (i64::from(frame.width()), i64::from(frame.height()));
        let x0 = area.x0.min(w - width).max(0);
        let at = |y: i64| {
            let y0 = y.min(h - height).max(0);
            Area { x0, y0, x1: (x0 + width).min(w), y1: (y0 + height).min(h) }
        };
        let above = at(area.y0 - height + style.line);
        let candidates = [above, at(area.y0), at(area.y1 - style.line), at(area.y1 - height)];
        let free = |a: &&Area| !placed.iter().any(|p| p.overlaps(a));
        *candidates.iter().find(free).unwrap_or(&above)
    }

    fn text_width(&self, style: &Style, text: &str) -> f32 {
        let font = self.font.as_scaled(style.text);
        let mut last: Option<GlyphId> = None;
        text.chars().fold(0.0, |x, c| {
            let id = font.glyph_id(c);
            let kern = last.replace(id).map_or(0.0, |l| font.kern(l, id));
            x + kern + font.h_advance(id)
        })
    }

    fn write(&self, frame: &mut Frame, style: &Style, label: &Area, text: &str, color: [u8; 3]) {
        let font = self.font.as_scaled(style.text);
        let mut x = (label.x0 + style.margin) as f32;
        let slack = (label.y1 - label.y0) as f32 - font.height();
        let baseline = (label.y0 as f32 + slack / 2.0 + font.ascent()).round();
        let mut last: Option<GlyphId> = None;
        for c in text.chars() {
            let id = font.glyph_id(c);
            x += last.replace(id).map_or(0.0, |l| font.kern(l, id));
            let glyph = id.with_scale_and_position(style.text, point(x, baseline));
            if let Some(outlined) = self.font.outline_glyph(glyph) {
                let bounds = outlined.px_bounds();
                let (left, top) = (bounds.min.x as i64, bounds.min.y as i64);
                outlined.draw(|dx, dy, coverage| {
                    blend(frame, left + i64::from(dx), top + i64::from(dy), color, coverage);
                });
            }
            x += font.h_advance(id);
        }
    }
}

/// A box on whole pixels, at least one pixel long.
fn whole_pixels(b: &BoundingBox) -> Area {
    let (x0, y0) = (b.x0.round() as i64, b.y0.round() as i64);
    Area { x0, y0, x1: (b.x1.round() as i64).max(x0 + 1), y1: (b.y1.round() as i64).max(y0 + 1) }
}

/// Black or white, whichever has the higher contrast by the relative luminance
/// of WCAG 2.
fn readable_on(color: [u8; 3]) -> [u8; 3] {
    let [r, g, b] = color.map(|c| {
        let c = f32::from(c) / 255.0;
        if c <= 0.040_45 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    });
    let luminance = 0.2126 * r + 0.7152 * g + 0.0722 * b;
    if luminance > 0.179 { [0; 3] } else { [255; 3] }
}

/// The frame of a box, drawn inwards.
fn outline(frame: &mut Frame, a: &Area, line: i64, color: [u8; 3]) {
    let line = line.min(a.x1 - a.x0).min(a.y1 - a.y0);
    fill(frame, &Area { y1: a.y0 + line, ..*a }, color);
    fill(frame, &Area { y0: a.y1 - line, ..*a }, color);
    fill(frame, &Area { x1: a.x0 + line, ..*a }, color);
    fill(frame, &Area { x0: a.x1 - line, ..*a }, color);
}

/// Fills the part of an area that lies in the picture.
fn fill(frame: &mut Frame, area: &Area, color: [u8; 3]) {
    let (width, height) = (i64::from(frame.width()), i64::from(frame.height()));
    let (x0, x1) = (area.x0.clamp(0, width) as usize, area.x1.clamp(0, width) as usize);
    let (y0, y1) = (area.y0.clamp(0, height) as usize, area.y1.clamp(0, height) as usize);
    if x0 >= x1 || y0 >= y1 {
        return;
    }
    let stride = frame.stride();
    for row in frame.data_mut().chunks_exact_mut(stride).take(y1).skip(y0) {
        for pixel in row.chunks_exact_mut(3).take(x1).skip(x0) {
            pixel.copy_from_slice(&color);
        }
    }
}

/// Mixes a colour into one pixel; nothing happens outside the picture.
fn blend(frame: &mut Frame, x: i64, y: i64, color: [u8; 3], share: f32) {
    let inside = |v: i64, n: u32| usize::try_from(v).ok().filter(|v| *v < n as usize);
    let (Some(x), Some(y)) = (inside(x, frame.width()), inside(y, frame.height())) else { return };
    let at = y * frame.stride() + x * 3;
    if let Some(pixel) = frame.data_mut().get_mut(at..at + 3) {
        let share = share.clamp(0.0, 1.0);
        for (old, new) in pixel.iter_mut().zip(color) {
            *old = (f32::from(*old) * (1.0 - share) + f32::from(new) * share).round() as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use realnet_core::Stamp;

    fn grey(width: u32, height: u32) -> Frame {
        Frame::rgb8(Stamp::ZERO, width, height, vec![100; (width * height * 3) as usize]).unwrap()
    }

    fn detection(class_id: u32, bbox: [f32; 4]) -> Detection {
        Detection { class_id, confidence: 0.5, bbox: bbox.into() }
    }

    #[test]
    fn a_box_is_drawn_on_its_edges_only() {
        let annotator = Annotator::new(vec!["car".into()]).unwrap();
        let mut frame = grey(320, 240);
        annotator.draw(&mut frame, &[detection(0, [50.0, 100.0, 150.0, 200.0])]);
        let at = |x: usize, y: usize| frame.data()[(y * 320 + x) * 3..][..3].to_vec();
        assert_eq!(at(50, 150), PALETTE[0]);
        assert_eq!(at(149, 150), PALETTE[0]);
        assert_eq!(at(150, 150), [100; 3]);
        assert_eq!(at(100, 199), PALETTE[0]);
        assert_eq!(at(100, 150), [100; 3]);
        // The label above the box holds dark text on the class colour.
        let label: Vec<_> = (85..100).map(|y| at(55, y)).collect();
        assert!(label.contains(&PALETTE[0].to_vec()));
    }

    #[test]
    fn labels_stay_inside_at_every_edge_and_apart_from_each_other() {
        let annotator = Annotator::new(vec!["a long class name".into()]).unwrap();
        let frame = grey(400, 300);
        let style = Style::of(&frame);
        let mut placed = Vec::new();
        for area in [
            Area { x0: 0, y0: 0, x1: 40, y1: 40 },
            Area { x0: 380, y0: 0, x1: 400, y1: 40 },
            Area { x0: 390, y0: 290, x1: 400, y1: 300 },
            Area { x0: 0, y0: 0, x1: 400, y1: 300 },
            Area { x0: 0, y0: 0, x1: 40, y1: 40 },
        ] {
            let label = annotator.place(&frame, &style, &area, "a long class name 0.50", &placed);
            assert!(label.x0 >= 0 && label.x1 <= 400 && label.y0 >= 0 && label.y1 <= 300);
            assert!(label.x1 > label.x0 && label.y1 > label.y0);
            assert!(!placed.iter().any(|p: &Area| p.overlaps(&label)), "{label:?}");
            placed.push(label);
        }
    }

    #[test]
    fn labels_go_without_confidence() {
        let annotator = Annotator::new(vec!["car".into()]).unwrap();
        assert_eq!(annotator.text_of(&detection(0, [0.0; 4])), "car 0.50");
        let annotator = annotator.without_confidence();
        assert_eq!(annotator.text_of(&detection(0, [0.0; 4])), "car");
        assert_eq!(annotator.text_of(&detection(3, [0.0; 4])), "3");
    }

    #[test]
    fn text_is_readable_on_every_colour() {
        assert_eq!(readable_on([255; 3]), [0; 3]);
        assert_eq!(readable_on([0; 3]), [255; 3]);
        assert_eq!(readable_on([0, 114, 178]), [255; 3]);
        assert_eq!(readable_on([240, 228, 66]), [0; 3]);
    }

    #[test]
    fn grey_frames_become_colour() {
        let mut frame = Frame::grey8(Stamp::from_nanos(7), 64, 64, vec![9; 4096]).unwrap();
        Annotator::new(vec![]).unwrap().draw(&mut frame, &[detection(70, [5.0, 20.0, 60.0, 60.0])]);
        assert_eq!((frame.format(), frame.stamp().nanos()), (PixelFormat::Rgb8, 7));
    }

    proptest! {
        #[test]
        fn any_box_on_any_picture(
            (w, h) in (1u32..80, 1u32..80),
            b in proptest::array::uniform4(prop_oneof![
                -200.0f32..200.0, Just(f32::NAN), Just(f32::INFINITY), Just(f32::MAX)
            ]),
            class_id in any::<u32>(),
        ) {
            let annotator = Annotator::new(vec!["person".into()]).unwrap();
            annotator.draw(&mut grey(w, h), &[detection(class_id, b), detection(0, b)]);
        }
    }
}
