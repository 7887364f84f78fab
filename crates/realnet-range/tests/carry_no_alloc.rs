//! Once it has seen the sizes that occur, the carrier allocates nothing: with and
//! without a search, accepted or refused.
#![allow(missing_docs, clippy::unwrap_used)]

#[path = "../../realnet-core/tests/counting/mod.rs"]
mod counting;

use counting::count;
use realnet_core::{BoundingBox, Frame, Stamp};
use realnet_range::carry::{BoxCarrier, BoxMotion, CarryOptions, SearchOptions};
use realnet_vision::{Pyramid, Window};

/// Blots of several sizes, moved and enlarged as one.
fn picture(shift: (f32, f32), scale: f32) -> Pyramid {
    let pixel = |i: u32| {
        let (x, y) = (((i % 320) as f32 - shift.0) / scale, ((i / 320) as f32 - shift.1) / scale);
        let waves = (x * 0.31 + y * 0.17).sin() * (y * 0.23 - x * 0.11).cos()
            + (x * 0.071).sin() * (y * 0.053).sin()
            + ((x * 0.013).sin() * 9.0 + (y * 0.017).cos() * 7.0).sin();
        (127.0 + 40.0 * waves) as u8
    };
    let frame = Frame::grey8(Stamp::ZERO, 320, 240, (0..320 * 240).map(pixel).collect()).unwrap();
    let mut pyramid = Pyramid::new(3, Window::default());
    pyramid.build(&frame);
    pyramid
}

#[test]
fn carrying_is_free_of_allocation() {
    let from = picture((0.0, 0.0), 1.0);
    let steps = [
        picture((4.0, -3.0), 1.03),
        picture((60.0, 30.0), 1.0),
        picture((-20.0, 45.0), 0.9),
        picture((0.0, 0.0), 5.0),
    ];
    let boxes = [
        BoundingBox::new(100.0, 80.0, 190.0, 140.0),
        BoundingBox::new(60.0, 50.0, 110.0, 150.0),
        BoundingBox::new(-400.0, 0.0, -300.0, 50.0),
        BoundingBox::new(250.0, 10.0, 360.0, 60.0),
    ];
    let search = Some(SearchOptions { steps: 9, ..SearchOptions::default() });
    let options = CarryOptions { search, ..CarryOptions::default() };
    let mut carrier = BoxCarrier::new(options).unwrap();
    let mut pass = || {
        let mut outcomes = [0; 3];
        for to in &steps {
            for bbox in &boxes {
                let outcome = match carrier.carry(&from, to, bbox, BoxMotion::NONE) {
                    Ok(carried) => usize::from(carried.searched),
                    Err(_) => 2,
                };
                outcomes[outcome] += 1;
            }
        }
        outcomes
    };
    let first = pass();
    let before = count();
    let second = pass();
    assert_eq!(count(), before);
    assert_eq!(first, second);
    assert!(first.iter().all(|n| *n > 0), "{first:?}");
}
