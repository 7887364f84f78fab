//! Contact sheets: what a network is shown, for people to look at.

use crate::depth::{DepthSample, Normalization};
use crate::detect::DetectionSample;
use realnet_core::{DepthMap, Detection, Frame, FrameError, Stamp};
use realnet_io::annotate::{Annotator, depth_colors};

/// How samples are laid out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SheetOptions {
    /// Samples side by side, at least 1; default 4.
    pub columns: usize,
    /// Pixels between samples; default 4.
    pub gap: u32,
    /// Depths with the colours of the two ends, metres; default 0.5 to 10.
    pub depth_range: [f32; 2],
}

impl Default for SheetOptions {
    fn default() -> Self {
        Self { columns: 4, gap: 4, depth_range: [0.5, 10.0] }
    }
}

/// Samples with their boxes and class names (by class index), row by row.
///
/// # Errors
/// [`FrameError`] when there are no samples, or their sizes are not those they say.
pub fn detection_sheet(
    samples: &[DetectionSample],
    names: &[String],
    options: &SheetOptions,
) -> Result<Frame, FrameError> {
    // The font is built in; were it damaged, pictures would have no boxes.
    let annotator = Annotator::new(names.to_vec()).ok().map(Annotator::without_confidence);
    let mut cells = Vec::with_capacity(samples.len());
    for sample in samples {
        let size = sample.size;
        let plane = size as usize * size as usize;
        let mut frame =
            Frame::rgb8(Stamp::ZERO, size, size, interleaved(&sample.image, plane, |byte| *byte))?;
        let side = size as f32;
        let labels: Vec<_> = sample
            .targets
            .iter()
            .map(|target| Detection {
                class_id: target.class_id,
                confidence: 1.0,
                bbox: target.to_pixels(side, side),
            })
            .collect();
        if let Some(annotator) = &annotator {
            annotator.draw(&mut frame, &labels);
        }
        cells.push(frame);
    }
    grid(&cells, options)
}

/// Samples, each with its depth in metres beside it, in the colours of
/// [`depth_colors`]; row by row. `normalization` is the one they were made with.
///
/// # Errors
/// [`FrameError`] when there are no samples, or their sizes are not those they say.
pub fn depth_sheet(
    samples: &[DepthSample],
    normalization: &Normalization,
    options: &SheetOptions,
) -> Result<Frame, FrameError> {
    let [near, far] = options.depth_range;
    let mut cells = Vec::with_capacity(samples.len());
    for sample in samples {
        let (width, height) = (sample.width, sample.height);
        let plane = width as usize * height as usize;
        let mut values = sample.image.clone();
        let channels = values.chunks_exact_mut(plane.max(1));
        for ((channel, mean), std) in channels.zip(normalization.mean).zip(normalization.std) {
            channel.iter_mut().for_each(|value| *value = *value * std + mean);
        }
        let byte = |value: &f32| (value * 255.0 + 0.5) as u8;
        let picture = Frame::rgb8(Stamp::ZERO, width, height, interleaved(&values, plane, byte))?;
        let metres = sample.depth.iter().map(|depth| depth * sample.metres_per_unit).collect();
        let map = DepthMap::new(Stamp::ZERO, width, height, metres).map_err(|_| {
            let (expected, found) = (plane, sample.depth.len());
            FrameError::Length { width, height, channels: 1, expected, found }
        })?;
        let colors = depth_colors(&map, near, far)?;
        cells.push(grid(&[picture, colors], &SheetOptions { columns: 2, gap: 0, ..*options })?);
    }
    grid(&cells, options)
}

/// Planes to pixels.
fn interleaved<T>(planes: &[T], plane: usize, byte: impl Fn(&T) -> u8) -> Vec<u8> {
    let mut pixels = vec![0; planes.len()];
    for (channel, offset) in planes.chunks_exact(plane.max(1)).zip(0..3) {
        pixels
            .iter_mut()
            .skip(offset)
            .step_by(3)
            .zip(channel)
            .for_each(|(pixel, value)| *pixel = byte(value));
    }
    pixels
}

/// Pictures of the size of the first one (others are cut) in rows.
fn grid(cells: &[Frame], options: &SheetOptions) -> Result<Frame, FrameError> {
    const BACKGROUND: u8 = 24;
    let Some(first) = cells.first() else {
        return Err(FrameError::Empty { width: 0, height: 0 });
    };
    let columns = options.columns.clamp(1, cells.len());
    let rows = cells.len().div_ceil(columns);
    let (width, height, gap) =
        (first.width() as usize, first.height() as usize, options.gap as usize);
    let full_width = columns * width + (columns - 1) * gap;
    let full_height = rows * height + (rows - 1) * gap;
    let mut data = vec![BACKGROUND; 3 * full_width * full_height];
    for (place, cell) in cells.iter().enumerate() {
        let (left, top) = ((place % columns) * (width + gap), (place / columns) * (height + gap));
        let kept = 3 * width.min(cell.width() as usize);
        for (y, row) in cell.data().chunks_exact(cell.stride()).take(height).enumerate() {
            let at = 3 * ((top + y) * full_width + left);
            if let (Some(to), Some(row)) = (data.get_mut(at..at + kept), row.get(..kept)) {
                to.copy_from_slice(row);
            }
        }
    }
    Frame::rgb8(Stamp::ZERO, full_width as u32, full_height as u32, data)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::Target;
    use realnet_core::Intrinsics;

    #[test]
    fn cells_lie_in_rows_with_their_boxes() {
        let sample = |value: u8| DetectionSample {
            index: 0,
            path: "a.jpg".into(),
            size: 60,
            image: [vec![value; 3600], vec![0; 3600], vec![7; 3600]].concat(),
            targets: vec![Target { class_id: 0, cx: 0.5, cy: 0.5, w: 0.5, h: 0.5 }],
        };
        let samples: Vec<_> = (0..5).map(|i| sample(10 * i)).collect();
        let options = SheetOptions { columns: 3, gap: 2, ..SheetOptions::default() };
        let sheet = detection_sheet(&samples, &["car".to_owned()], &options).unwrap();
        assert_eq!((sheet.width(), sheet.height()), (184, 122));
        let at = |x: usize, y: usize| &sheet.data()[3 * (y * 184 + x)..][..3];
        assert_eq!(at(62 + 5, 58), [10, 0, 7]);
        assert_eq!(at(62 + 5, 62 + 58), [40, 0, 7]);
        assert_eq!(at(61, 5), [24; 3]);
        assert_eq!(at(130, 70), [24; 3]); // no sixth sample
        assert_eq!(at(15, 40), realnet_io::annotate::PALETTE[0]);
        assert!(detection_sheet(&[], &[], &options).is_err());
        let short = DetectionSample { image: vec![0; 5], ..sample(0) };
        assert!(detection_sheet(&[short], &[], &options).is_err());
    }

    #[test]
    fn depth_stands_beside_its_picture() {
        let sample = DepthSample {
            index: 0,
            path: "a.png".into(),
            width: 4,
            height: 2,
            image: [vec![1.0; 8], vec![-1.0; 8], vec![0.0; 8]].concat(),
            depth: vec![0.0, 0.25, 0.25, 0.25, 5.0, 5.0, 5.0, 5.0],
            metres_per_unit: 2.0,
            camera: Intrinsics { fx: 4.0, fy: 4.0, cx: 1.5, cy: 0.5 },
        };
        let normalization = Normalization { mean: [0.5; 3], std: [0.5; 3] };
        let options = SheetOptions::default();
        let sheet = depth_sheet(&[sample], &normalization, &options).unwrap();
        assert_eq!((sheet.width(), sheet.height()), (8, 2));
        assert_eq!(sheet.data()[..3], [255, 0, 128]);
        let near = &sheet.data()[3 * 5..][..3];
        let far = &sheet.data()[3 * 12..][..3];
        assert_eq!(sheet.data()[3 * 4..][..3], [40; 3]); // unknown
        assert!(near[0] > near[2] && far[2] > far[0], "{near:?} {far:?}");
    }
}
