use super::{CLIP_FRAMES, DatasetSpec, KnownMount, Sampler, Split, VALIDATION};
use realnet_core::DepthMap;
use realnet_core::nalgebra::Vector3;

const SPEC: DatasetSpec = DatasetSpec { seed: 11, width: 160, height: 96, mount: None };

#[test]
fn a_sample_is_the_same_alone_and_in_a_row() {
    let mut row = Sampler::new(SPEC);
    let all: Vec<_> = (0..2 * CLIP_FRAMES).map(|index| row.sample(index)).collect();
    for index in [13, 2, 9, 0] {
        let alone = Sampler::new(SPEC).sample(index);
        assert_eq!(alone, all[index as usize], "{index}");
        assert_eq!(Sampler::new(SPEC).world_from_camera(index), alone.world_from_camera);
    }
    assert_ne!(all[0].frame.data(), all[1].frame.data());
    let other = Sampler::new(DatasetSpec { seed: 12, ..SPEC }).sample(0);
    assert_ne!(other.frame, all[0].frame);
    assert_ne!(all[0].camera, all[CLIP_FRAMES as usize].camera);
}

/// Over many clips: most pictures have vehicles at many ranges, boxes lie within the
/// picture, the depth in a box's middle region agrees with the label.
#[test]
fn samples_are_many_sided() {
    let mut sampler = Sampler::new(SPEC);
    let (mut labels, mut classes, mut empty) = (Vec::new(), [0; 4], 0);
    for clip in 0..60 {
        let sample = sampler.sample(clip * CLIP_FRAMES + clip % CLIP_FRAMES);
        assert_eq!((sample.clip, sample.step), (clip, clip % CLIP_FRAMES));
        empty += usize::from(sample.labels.is_empty());
        assert!(sample.depth.data().iter().all(|d| d.is_finite() && *d >= 0.0));
        for label in &sample.labels {
            let b = label.bbox;
            assert!(b.is_proper() && b == b.clipped(160.0, 96.0), "{b:?}");
            let inside = (b.y0 as u32..b.y1 as u32)
                .flat_map(|y| (b.x0 as u32..b.x1 as u32).map(move |x| (x, y)))
                .filter(|&(x, y)| {
                    sample
                        .depth
                        .at(x, y)
                        .is_some_and(|d| (f64::from(d) - label.depth_m).abs() < 0.4)
                });
            let share = inside.count() as f32 / b.area();
            assert!(share > 0.1, "{label:?}: {share}");
            classes[label.class_id as usize] += 1;
            labels.push(label.depth_m);
        }
        assert!(sample.depth.data().iter().any(|d| DepthMap::is_known(*d)));
    }
    labels.sort_by(f64::total_cmp);
    assert!(labels.len() > 70 && empty < 25, "{} {empty}", labels.len());
    assert!(classes.iter().all(|count| *count > 5), "{classes:?}");
    assert!(labels[0] < 0.8 && labels[labels.len() - 1] > 4.0, "{labels:?}");
}

/// The cameras sit where they are told to, over the same worlds' other lots.
#[test]
fn a_known_mount_is_kept() {
    let known = KnownMount { height_m: 0.5, pitch_rad: 0.3 };
    let mut sampler = Sampler::new(DatasetSpec { mount: Some(known), ..SPEC });
    let mut heights = Vec::new();
    for clip in 0..20 {
        let pose = sampler.world_from_camera(clip * CLIP_FRAMES);
        let (place, ahead) = (pose.translation(), pose.rotation() * Vector3::z());
        assert!((place.z - 0.5).abs() < 0.006 + 0.02 * 0.4, "{place}");
        // The body leans by up to 0.02 as well.
        assert!((-ahead.z.asin() - 0.3).abs() < 0.01 + 0.02 + 1e-3, "{ahead}");
        heights.push(place.z);
    }
    heights.dedup();
    assert!(heights.len() > 15, "{heights:?}");
}

#[test]
fn one_clip_in_five_is_for_validation() {
    let val = (0..100).filter(|clip| Split::of_clip(*clip) == Split::Val).count() as u64;
    assert_eq!(val, 100 / VALIDATION);
}
