//! Boxes carried over real frames. The example `carry` prints the figures; here
//! they may not fall below the least that is promised.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

#[path = "carry_sequences/mod.rs"]
mod sequences;

use realnet_core::BoundingBox;
use realnet_range::carry::{BoxCarrier, BoxMotion, CarryOptions};
use realnet_vision::{Pyramid, Window};
use sequences::Frames;
use std::path::PathBuf;

/// The folder of data sets, if there is one with `name`.
fn data(name: &str) -> Option<PathBuf> {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared");
    let shared = std::env::var_os("REALNET_SHARED").map_or_else(|| beside.into(), PathBuf::from);
    let data = shared.join("data");
    if data.join(name).is_dir() {
        return Some(data);
    }
    println!("skipped: no {name} in {}", data.display());
    None
}

#[derive(Debug, Default)]
struct Figures {
    steps: usize,
    /// IoU with the truth of at least 0.5.
    right: usize,
    /// Accepted, with less.
    wrong: usize,
    /// Accepted in a picture that is upside down.
    upside_down: usize,
}

/// The true box of every `every`-th frame is carried from frame to frame, past
/// frames where that is refused.
fn run(frames: &Frames, every: usize, figures: &mut Figures) {
    let mut carrier = BoxCarrier::new(CarryOptions::default()).unwrap();
    let [mut last, mut next, mut turned] = [(); 3].map(|()| Pyramid::new(3, Window::default()));
    let mut state = (BoundingBox::default(), BoxMotion::NONE);
    for (i, (frame, truth)) in frames.iter().enumerate() {
        next.build(frame);
        if i > 0 && (every == 1 || i % every != 0) {
            figures.steps += 1;
            if i % 5 == 0 {
                turned.build(&sequences::upside_down(frame));
                let carried = carrier.carry(&last, &turned, &state.0, state.1);
                figures.upside_down += usize::from(carried.is_ok());
            }
            if let Ok(carried) = carrier.carry(&last, &next, &state.0, state.1) {
                let size = (frame.width() as f32, frame.height() as f32);
                let right = carried.bbox.clipped(size.0, size.1).iou(truth) >= 0.5;
                *(if right { &mut figures.right } else { &mut figures.wrong }) += 1;
                state = (carried.bbox, carried.motion);
                std::mem::swap(&mut last, &mut next);
            }
        }
        if i % every == 0 {
            state = (*truth, BoxMotion::NONE);
            last.build(frame);
        }
    }
}

impl Figures {
    fn hold(&self) {
        println!("{self:?}");
        assert!(self.right * 100 >= self.steps * 92, "{self:?}");
        assert!(self.wrong * 100 <= self.steps, "{self:?}");
        assert!(self.upside_down <= 1, "{self:?}");
    }
}

#[test]
fn a_car_filmed_with_blur_is_carried_over_15_frames() {
    let Some(data) = data("blurcar") else { return };
    let mut figures = Figures::default();
    run(&sequences::blurcar(&data).unwrap(), 15, &mut figures);
    assert_eq!(figures.steps, 93);
    figures.hold();
}

#[test]
fn large_steps_are_carried() {
    let Some(data) = data("rc-car") else { return };
    let mut figures = Figures::default();
    for name in ["seq2", "seq3", "seq4"] {
        run(&sequences::rc_car(&data, name).unwrap(), 1, &mut figures);
    }
    assert_eq!(figures.steps, 297);
    figures.hold();
}
