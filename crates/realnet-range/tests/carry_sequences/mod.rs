//! Real frames with the box of their target.

use realnet_core::{BoundingBox, Frame};
use realnet_io::picture;
use std::error::Error;
use std::path::Path;

/// Frames in order, each with the true box.
pub type Frames = Vec<(Frame, BoundingBox)>;

/// `blurcar` in the folder `data`: `boxes.csv` with `frame,x0,y0,x1,y1` beside the
/// pictures, both in order.
pub fn blurcar(data: &Path) -> Result<Frames, Box<dyn Error>> {
    let folder = data.join("blurcar");
    let table = std::fs::read_to_string(folder.join("boxes.csv"))?;
    let entries = std::fs::read_dir(folder.join("images"))?;
    let mut pictures =
        entries.map(|entry| Ok(entry?.path())).collect::<std::io::Result<Vec<_>>>()?;
    pictures.sort();
    let mut frames = Vec::new();
    for (line, path) in table.lines().skip(1).zip(&pictures) {
        let numbers: Vec<f32> = line.split(',').map(str::parse).collect::<Result<_, _>>()?;
        let [_, x0, y0, x1, y1] = numbers[..] else { return Err(line.into()) };
        frames.push((picture::read(path)?, BoundingBox::new(x0, y0, x1, y1)));
    }
    Ok(frames)
}

/// A sequence of `rc-car` in the folder `data`: 100 pictures with YOLO labels.
pub fn rc_car(data: &Path, name: &str) -> Result<Frames, Box<dyn Error>> {
    let folder = data.join("rc-car").join(name);
    let mut frames = Vec::new();
    for number in 0..100 {
        let frame = picture::read(&folder.join(format!("images/{number:06}.jpg")))?;
        let label = std::fs::read_to_string(folder.join(format!("labels/{number:06}.txt")))?;
        let numbers: Vec<f32> =
            label.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
        let [_, cx, cy, w, h] = numbers[..] else { return Err(label.into()) };
        let (width, height) = (frame.width() as f32, frame.height() as f32);
        let bbox = BoundingBox::from_center(cx * width, cy * height, w * width, h * height);
        frames.push((frame, bbox));
    }
    Ok(frames)
}

/// The frame with its rows in reverse.
pub fn upside_down(frame: &Frame) -> Frame {
    let mut turned = frame.clone();
    let rows = frame.data().chunks_exact(frame.stride()).rev();
    for (to, from) in turned.data_mut().chunks_exact_mut(frame.stride()).zip(rows) {
        to.copy_from_slice(from);
    }
    turned
}
