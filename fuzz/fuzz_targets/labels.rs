//! Any bytes are either refused as label rows, `data.yaml`, COCO ground truth
//! and COCO results, or give values that keep their promises.
#![no_main]

use libfuzzer_sys::fuzz_target;
use realnet_io::datasets::{CocoDataset, YoloDataset, coco, labels};
use std::path::Path;

const CLASSES: usize = 3;

fn check_labels(text: &str) {
    let Ok(read) = labels::parse(text, CLASSES) else { return };
    assert!(read.rows.len() + read.duplicates <= text.lines().count());
    let mut written = String::new();
    for row in &read.rows {
        assert!((row.class_id as usize) < CLASSES);
        assert!([row.cx, row.cy, row.w, row.h].iter().all(|v| (0.0..=1.0).contains(v)), "{row:?}");
        let bbox = row.to_pixels(1280, 720);
        assert!(bbox.x0 <= bbox.x1 && bbox.y0 <= bbox.y1, "{bbox:?}");
        written += &format!("{} {} {} {} {}\n", row.class_id, row.cx, row.cy, row.w, row.h);
    }
    match labels::parse(&written, CLASSES) {
        Ok(again) => assert_eq!(again.rows, read.rows),
        Err(error) => panic!("what was written is not read: {error}\n{written}"),
    }
}

fn check_yaml(text: &str) {
    let Ok(data) = YoloDataset::parse(text, Path::new("folder/data.yaml")) else { return };
    assert!(!data.names().is_empty());
    assert!(data.splits().all(|split| ["train", "val", "test"].contains(&split)));
}

fn check_coco(json: &[u8]) {
    if let Ok(data) = CocoDataset::parse(json) {
        assert_eq!(data.names.len(), data.category_ids.len());
        for (index, id) in data.category_ids.iter().enumerate() {
            assert_eq!(data.class_of(*id), u32::try_from(index).ok());
        }
        for annotation in &data.annotations {
            assert!((annotation.class_id as usize) < data.names.len());
            assert!(annotation.bbox[2] >= 0.0 && annotation.bbox[3] >= 0.0);
            assert!(data.images.iter().any(|image| image.id == annotation.image_id));
        }
    }
    if let Ok(results) = coco::parse_results(json) {
        assert!(results.iter().all(|r| r.bbox.iter().all(|v| v.is_finite())));
    }
}

fuzz_target!(|bytes: &[u8]| {
    if let Ok(text) = std::str::from_utf8(bytes) {
        check_labels(text);
        check_yaml(text);
    }
    check_coco(bytes);
});
