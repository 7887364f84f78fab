//! Draws a contact sheet of augmented samples:
//! `sheets data.yaml sheet.png` for boxes, `sheets depth.yaml sheet.png 256 192` for depth.
#![allow(clippy::print_stdout)]

use realnet_data::{
    CanonicalFocal, DepthAugment, DepthPart, DepthSamples, DepthSet, DepthSetOptions,
    DetectionAugment, DetectionSamples, DetectionSet, Normalization, Samples, SetOptions,
    SheetOptions, SourceList, depth_sheet, detection_sheet, epoch_order,
};
use std::error::Error;
use std::path::Path;
use std::sync::Arc;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (data, out, size) = match &arguments[..] {
        [data, out] => (data, out, None),
        [data, out, width, height] => (data, out, Some((width.parse()?, height.parse()?))),
        _ => return Err("usage: sheets DATA.yaml SHEET.png [WIDTH HEIGHT]".into()),
    };
    let sheet = match size {
        None => {
            let options = SetOptions::default();
            let set = Arc::new(DetectionSet::open(Path::new(data), "train", 320, &options)?);
            println!("{}", set.report());
            let names = set.names().to_vec();
            let samples = DetectionSamples::training(set, DetectionAugment::default(), 1)?;
            let order = epoch_order(samples.len(), 1, 0);
            let shown: Result<Vec<_>, _> =
                order.into_iter().take(12).map(|i| samples.sample(0, i)).collect();
            detection_sheet(&shown?, &names, &SheetOptions::default())?
        }
        Some(size) => {
            let list = SourceList::open(Path::new(data))?;
            let options = DepthSetOptions::training(size);
            let set = Arc::new(DepthSet::open(&list, DepthPart::Train, &options)?);
            println!("{}", set.report());
            let canonical = CanonicalFocal::new(f64::from(size.0))?;
            let (augment, normalization) = (DepthAugment::default(), Normalization::IMAGENET);
            let samples = DepthSamples::training(set, augment, canonical, normalization, 1)?;
            let order = epoch_order(samples.len(), 1, 0);
            let shown: Result<Vec<_>, _> =
                order.into_iter().take(15).map(|i| samples.sample(0, i)).collect();
            let options = SheetOptions { columns: 3, ..SheetOptions::default() };
            depth_sheet(&shown?, &normalization, &options)?
        }
    };
    realnet_io::picture::write(Path::new(out), &sheet)?;
    Ok(())
}
