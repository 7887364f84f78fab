//! Letterboxing: a picture of any shape on a network's fixed input.

use crate::{
    VisionError,
    resize::{Filter, Resizer, shares},
};
use realnet_core::{BoundingBox, Frame, PixelFormat};

/// A rectangle of whole pixels inside a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl Region {
    /// The whole frame.
    #[must_use]
    pub fn whole(frame: &Frame) -> Self {
        Self { x: 0, y: 0, width: frame.width(), height: frame.height() }
    }

    fn inside(&self, frame: &Frame) -> bool {
        let fits = |start: u32, length: u32, size: u32| {
            length > 0 && start.checked_add(length).is_some_and(|end| end <= size)
        };
        fits(self.x, self.width, frame.width()) && fits(self.y, self.height, frame.height())
    }
}

/// How a region of a frame was fitted into a network's input: scaled by one
/// factor, centred, and surrounded with grey.
///
/// The size and the bars follow Ultralytics' `letterbox` with `auto=False`:
/// `r = min(W / w, H / h)`, sides `round(w r)`, `round(h r)`, and of an odd
/// remainder the smaller half on the left and on top.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Letterbox {
    region: Region,
    width: u32,
    height: u32,
    left: u32,
    top: u32,
}

impl Letterbox {
    /// The grey of the bars, 114 of 255.
    pub const GREY: u8 = 114;

    /// Fits `region` into `target` = (width, height). No side may be 0.
    #[must_use]
    pub fn fit(region: Region, target: (u32, u32)) -> Self {
        let (rw, rh) = (f64::from(region.width), f64::from(region.height));
        let ratio = (f64::from(target.0) / rw).min(f64::from(target.1) / rh);
        let side = |length: f64, limit: u32| {
            ((length * ratio).round_ties_even() as u32).clamp(1, limit.max(1))
        };
        let (width, height) = (side(rw, target.0), side(rh, target.1));
        let bar = |limit: u32, side: u32| (limit - side) / 2;
        Self { region, width, height, left: bar(target.0, width), top: bar(target.1, height) }
    }

    /// Width of the bar on the left, in input pixels.
    #[must_use]
    pub fn left(&self) -> u32 {
        self.left
    }

    /// Height of the bar on top, in input pixels.
    #[must_use]
    pub fn top(&self) -> u32 {
        self.top
    }

    /// Size of the scaled picture between the bars, in input pixels.
    #[must_use]
    pub fn scaled_size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// A box in pixels of the network's input as a box in pixels of the whole
    /// frame, clipped to the region that was looked at.
    #[must_use]
    pub fn frame_from_input(&self, input: &BoundingBox) -> BoundingBox {
        let (rw, rh) = (self.region.width as f32, self.region.height as f32);
        let (sx, sy) = (rw / self.width as f32, rh / self.height as f32);
        let (left, top) = (self.left as f32, self.top as f32);
        BoundingBox::new(
            (input.x0 - left) * sx,
            (input.y0 - top) * sy,
            (input.x1 - left) * sx,
            (input.y1 - top) * sy,
        )
        .clipped(rw, rh)
        .translated(self.region.x as f32, self.region.y as f32)
    }

    /// A box in pixels of the whole frame as a box in pixels of the network's input.
    #[must_use]
    pub fn input_from_frame(&self, frame: &BoundingBox) -> BoundingBox {
        let sx = self.width as f32 / self.region.width as f32;
        let sy = self.height as f32 / self.region.height as f32;
        let local = frame.translated(-(self.region.x as f32), -(self.region.y as f32));
        let (left, top) = (self.left as f32, self.top as f32);
        BoundingBox::new(
            local.x0 * sx + left,
            local.y0 * sy + top,
            local.x1 * sx + left,
            local.y1 * sy + top,
        )
    }
}

/// Writes letterboxed frames straight into a network's input.
#[derive(Debug)]
pub struct Letterboxer {
    width: u32,
    height: u32,
    rows: Resizer,
}

impl Letterboxer {
    /// For a network with an input of `width` x `height` pixels; `filter` makes the
    /// frame fit.
    ///
    /// # Errors
    /// [`VisionError::EmptyTarget`] when a side is 0.
    pub fn new(width: u32, height: u32, filter: Filter) -> Result<Self, VisionError> {
        if width == 0 || height == 0 {
            return Err(VisionError::EmptyTarget { width, height });
        }
        Ok(Self { width, height, rows: Resizer::new(filter) })
    }

    /// The network's input size, (width, height).
    #[must_use]
    pub fn target(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// Fits `region` of `frame` (the whole when `None`) into `input`: planes of
    /// red, green and blue, each of `height` rows of `width` values from 0 to 1.
    /// A grey frame gives three equal planes.
    ///
    /// # Errors
    /// [`VisionError::Region`] when the region is not inside the frame,
    /// [`VisionError::Output`] when `input` is not `3 * height * width` long.
    pub fn run(
        &mut self,
        frame: &Frame,
        region: Option<Region>,
        input: &mut [f32],
    ) -> Result<Letterbox, VisionError> {
        let region = region.unwrap_or_else(|| Region::whole(frame));
        if !region.inside(frame) {
            return Err(VisionError::Region {
                region,
                width: frame.width(),
                height: frame.height(),
            });
        }
        let (width, plane) = (self.width as usize, self.width as usize * self.height as usize);
        if input.len() != 3 * plane {
            return Err(VisionError::Output { expected: 3 * plane, found: input.len() });
        }
        let letterbox = Letterbox::fit(region, (self.width, self.height));
        let (left, top) = (letterbox.left as usize, letterbox.top as usize);
        let scaled = letterbox.scaled_size();
        let (scaled_width, scaled_height) = (scaled.0 as usize, scaled.1 as usize);
        let grey = f32::from(Letterbox::GREY) / 255.0;

        for plane in input.chunks_exact_mut(plane) {
            let (above, rest) = plane.split_at_mut(top * width);
            let (middle, below) = rest.split_at_mut(scaled_height * width);
            above.fill(grey);
            below.fill(grey);
            if scaled_width < width {
                for row in middle.chunks_exact_mut(width) {
                    row[..left].fill(grey);
                    row[left + scaled_width..].fill(grey);
                }
            }
        }
        self.rows.run(frame, region, scaled, |y, planes| {
            let start = (top + y) * width + left;
            for channel in 0..3 {
                let source = match frame.format() {
                    PixelFormat::Rgb8 => &planes[channel * scaled_width..][..scaled_width],
                    PixelFormat::Grey8 => planes,
                };
                shares(source, &mut input[channel * plane + start..][..scaled_width]);
            }
        });
        Ok(letterbox)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use realnet_core::Stamp;

    fn fit(w: u32, h: u32, target: (u32, u32)) -> Letterbox {
        Letterbox::fit(Region { x: 0, y: 0, width: w, height: h }, target)
    }

    #[test]
    fn bars_follow_the_reference() {
        // bus.jpg and zidane.jpg, sizes from the reference run
        let bus = fit(810, 1080, (640, 640));
        assert_eq!((bus.left(), bus.top(), bus.scaled_size()), (80, 0, (480, 640)));
        let zidane = fit(1280, 720, (640, 640));
        assert_eq!((zidane.left(), zidane.top(), zidane.scaled_size()), (0, 140, (640, 360)));
        // an odd remainder of 5 rows: 2 above, 3 below, as round(2.5 - 0.1), round(2.5 + 0.1)
        let odd = fit(100, 95, (100, 100));
        assert_eq!((odd.top(), odd.scaled_size()), (2, (100, 95)));
        // even a hair of a picture keeps one pixel
        assert_eq!(fit(10_000, 1, (320, 320)).scaled_size(), (320, 1));
    }

    #[test]
    fn bars_are_grey_and_the_picture_is_scaled() {
        let mut letterboxer = Letterboxer::new(8, 8, Filter::default()).unwrap();
        let frame = Frame::grey8(Stamp::ZERO, 16, 8, vec![255; 128]).unwrap();
        let mut input = vec![-1.0; 3 * 64];
        let letterbox = letterboxer.run(&frame, None, &mut input).unwrap();
        assert_eq!((letterbox.top(), letterbox.scaled_size()), (2, (8, 4)));
        for plane in input.chunks_exact(64) {
            for (i, &v) in plane.iter().enumerate() {
                let expected = if (2..6).contains(&(i / 8)) { 1.0 } else { 114.0 / 255.0 };
                assert!((v - expected).abs() < 1e-6, "{i}: {v}");
            }
        }
    }

    #[test]
    fn bad_sizes_are_refused() {
        let frame = Frame::grey8(Stamp::ZERO, 4, 4, vec![0; 16]).unwrap();
        let mut letterboxer = Letterboxer::new(8, 8, Filter::default()).unwrap();
        let region = Region { x: 3, y: 0, width: 2, height: 2 };
        assert!(matches!(
            letterboxer.run(&frame, Some(region), &mut [0.0; 192]),
            Err(VisionError::Region { .. })
        ));
        let far = Region { x: u32::MAX, y: 0, width: 2, height: 2 };
        assert!(letterboxer.run(&frame, Some(far), &mut [0.0; 192]).is_err());
        assert!(matches!(
            letterboxer.run(&frame, None, &mut [0.0; 191]),
            Err(VisionError::Output { expected: 192, found: 191 })
        ));
        assert!(Letterboxer::new(0, 8, Filter::default()).is_err());
    }

    #[test]
    fn a_region_is_the_crop() {
        let data: Vec<u8> = (0..40 * 30 * 3).map(|i| (i * 7 % 251) as u8).collect();
        let frame = Frame::rgb8(Stamp::ZERO, 40, 30, data).unwrap();
        let region = Region { x: 5, y: 3, width: 20, height: 22 };
        let crop: Vec<u8> = (3..25)
            .flat_map(|y| frame.data()[(y * 40 + 5) * 3..(y * 40 + 25) * 3].to_vec())
            .collect();
        let crop = Frame::rgb8(Stamp::ZERO, 20, 22, crop).unwrap();
        let (mut a, mut b) = (vec![0.0; 3 * 256], vec![0.0; 3 * 256]);
        let mut letterboxer = Letterboxer::new(16, 16, Filter::default()).unwrap();
        letterboxer.run(&frame, Some(region), &mut a).unwrap();
        letterboxer.run(&crop, None, &mut b).unwrap();
        assert_eq!(a, b);
    }

    proptest! {
        #[test]
        fn boxes_go_there_and_back(
            (w, h) in (16u32..2000, 16u32..2000), (x, y) in (0u32..500, 0u32..500),
            fx in 0.0f32..0.5, fy in 0.0f32..0.5,
        ) {
            let region = Region { x, y, width: w, height: h };
            let letterbox = Letterbox::fit(region, (640, 384));
            let b = BoundingBox::from_corner(
                x as f32 + fx * w as f32, y as f32 + fy * h as f32, w as f32 / 3.0, h as f32 / 3.0,
            );
            let back = letterbox.frame_from_input(&letterbox.input_from_frame(&b));
            for (a, b) in <[f32; 4]>::from(b).into_iter().zip(<[f32; 4]>::from(back)) {
                prop_assert!((a - b).abs() < 0.02, "{} {}", a, b);
            }
        }
    }
}
