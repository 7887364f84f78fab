use crate::random::{Rng, camera};
use proptest::prelude::*;
use realnet_core::{BoundingBox, CameraModel, DepthMap, Stamp};
use realnet_range::cues::{
    Attitude, DepthNoise, GroundFit, GroundFitError, GroundFitOptions, GroundPlane, GroundPrior,
    Uncertain,
};

/// A floor, a wall ahead (within the 8 m that the source sees, or not), boxes that stand on the floor, and holes.
struct World {
    camera: CameraModel,
    attitude: Attitude,
    height: f64,
    clutter: usize,
    noise: f64,
    offset: f64,
    flatness_rad: f64,
    wall: f64,
}

impl World {
    fn map(&self, rng: &mut Rng) -> DepthMap {
        let blocks: Vec<[f64; 4]> = (0..self.clutter)
            .map(|_| {
                let (x, width) = (rng.uniform(-0.5, 0.4), rng.uniform(0.05, 0.2));
                [x, x + width, rng.uniform(1.0, 3.0), rng.uniform(0.05, 0.5)]
            })
            .collect();
        let down = self.attitude.down();
        let mut data = Vec::new();
        for v in 0..self.camera.height() {
            for u in 0..self.camera.width() {
                let [x, y] = self.camera.unproject([f64::from(u), f64::from(v)]).unwrap();
                let fall = down.x * x + down.y * y + down.z;
                let mut z =
                    if fall > 0.0 { (self.height / fall).min(self.wall) } else { self.wall };
                for [left, right, at, tall] in &blocks {
                    let above = self.height - at * fall;
                    if x > *left && x < *right && *at < z && above < *tall {
                        z = *at;
                    }
                }
                let known = rng.uniform(0.0, 1.0) > 0.1 && z < 8.0;
                let z = z * (1.0 + self.noise * rng.normal()) + self.offset;
                data.push(if known { z as f32 } else { 0.0 });
            }
        }
        DepthMap::new(Stamp::ZERO, self.camera.width(), self.camera.height(), data).unwrap()
    }

    fn fit(&self, rng: &mut Rng, source: DepthNoise) -> Result<GroundPlane, GroundFitError> {
        // up to where the fit looks
        let off = |rng: &mut Rng| rng.normal().clamp(-2.8, 2.8);
        let prior = GroundPrior {
            camera_height_m: Uncertain::new(self.height + 0.02 * off(rng), 0.02),
            pitch_rad: Uncertain::new(self.attitude.pitch_rad + 0.03 * off(rng), 0.03),
            roll_rad: Uncertain::new(self.attitude.roll_rad + 0.02 * off(rng), 0.02),
        };
        let options = GroundFitOptions {
            pixel_noise: DepthNoise::new(0.0, 0.01),
            correlation_px: 1.0,
            max_samples: 2000,
            flatness_rad: self.flatness_rad,
            ..GroundFitOptions::default()
        };
        let map = self.map(rng);
        GroundFit::new(options).unwrap().fit(&map, &self.camera, &[], &prior, source)
    }
}

/// A quarter of the 640x480 picture's pixels, so that the worlds are quick.
fn small(lens: bool) -> CameraModel {
    camera(lens).scaled(160, 120).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn a_clean_floor_gives_the_exact_plane(
        lens in any::<bool>(), pitch in -0.1..0.4f64, roll in -0.1..0.1f64,
        height in 0.2..1.2f64, seed in any::<u64>()
    ) {
        let attitude = Attitude::new(pitch, roll);
        let world = World { camera: small(lens), attitude, height, clutter: 0, noise: 0.0, offset: 0.0, flatness_rad: 0.0, wall: 99.0 };
        let mut rng = Rng(seed);
        match world.fit(&mut rng, DepthNoise::NONE) {
            Ok(plane) => {
                prop_assert!((plane.pitch_rad.value - pitch).abs() < 1e-5, "{plane:?} {pitch}");
                prop_assert!((plane.roll_rad.value - roll).abs() < 1e-5, "{plane:?} {roll}");
                prop_assert!((plane.camera_height_m.value - height).abs() < 1e-5, "{plane:?}");
                let row = attitude.horizon_pixel(&world.camera, 0.0).unwrap()[1];
                prop_assert!((plane.horizon_row.value - row).abs() < 0.002);
            }
            // High up and nose up, little of the floor is in sight.
            Err(error) => prop_assert!(pitch < 0.05 || height > 0.9, "{error}"),
        }
    }
}

/// Squared normalised errors of pitch, roll and height over many worlds.
fn squared_errors(rng: &mut Rng, clutter: usize, wall: f64, flatness_rad: f64) -> [Vec<f64>; 3] {
    let mut squares = [Vec::new(), Vec::new(), Vec::new()];
    for index in 0..160 {
        let world = World {
            camera: small(index % 8 == 0),
            attitude: Attitude::new(rng.uniform(0.0, 0.3), rng.uniform(-0.05, 0.05)),
            height: rng.uniform(0.3, 0.8),
            clutter,
            noise: 0.01,
            offset: 0.0,
            flatness_rad,
            wall,
        };
        let Ok(plane) = world.fit(rng, DepthNoise::NONE) else { continue };
        let square = |found: Uncertain, truth: f64| ((found.value - truth) / found.std).powi(2);
        squares[0].push(square(plane.pitch_rad, world.attitude.pitch_rad));
        squares[1].push(square(plane.roll_rad, world.attitude.roll_rad));
        squares[2].push(square(plane.camera_height_m, world.height));
    }
    squares
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[test]
fn deviations_of_a_noisy_floor_are_consistent() {
    let mut rng = Rng(61);
    for squares in squared_errors(&mut rng, 0, 99.0, 0.0) {
        // of two estimates of the deviation the larger one is taken
        assert!((0.5..1.2).contains(&mean(&squares)), "{}", mean(&squares));
    }
}

#[test]
fn clutter_stays_within_the_deviations() {
    let mut rng = Rng(65);
    for squares in squared_errors(&mut rng, 3, 4.0, 0.003) {
        let beyond = squares.iter().filter(|&&square| square > 9.0).count();
        assert!(squares.len() > 150 && beyond <= 2, "{beyond} of {}", squares.len());
    }
}

#[test]
fn an_offset_of_the_source_is_in_the_deviation() {
    let mut rng = Rng(62);
    let mut squares = Vec::new();
    for _ in 0..160 {
        let world = World {
            camera: small(false),
            attitude: Attitude::new(rng.uniform(0.1, 0.3), 0.0),
            height: rng.uniform(0.4, 0.8),
            clutter: 0,
            noise: 0.01,
            offset: 0.05 * rng.normal(),
            flatness_rad: 0.0,
            wall: 4.0,
        };
        let Ok(plane) = world.fit(&mut rng, DepthNoise::new(0.05, 0.0)) else { continue };
        let error = plane.pitch_rad.value - world.attitude.pitch_rad;
        squares.push((error / plane.pitch_rad.std).powi(2));
    }
    assert!(squares.len() > 140, "{}", squares.len());
    assert!((0.5..1.3).contains(&mean(&squares)), "{}", mean(&squares));
}

#[test]
fn a_scale_of_the_source_moves_the_height_and_not_the_pitch() {
    let mut rng = Rng(63);
    let attitude = Attitude::new(0.2, 0.0);
    let world = World {
        camera: small(false),
        attitude,
        height: 0.5,
        clutter: 0,
        noise: 0.0,
        offset: 0.0,
        flatness_rad: 0.0,
        wall: 4.0,
    };
    let map = world.map(&mut rng);
    let scaled = map.data().iter().map(|z| 1.1 * z).collect();
    let scaled = DepthMap::new(Stamp::ZERO, map.width(), map.height(), scaled).unwrap();
    let prior = GroundPrior {
        camera_height_m: Uncertain::new(0.5, 0.01),
        pitch_rad: Uncertain::new(0.22, 0.03),
        roll_rad: Uncertain::new(0.0, 0.01),
    };
    let mut fit = GroundFit::new(GroundFitOptions::default()).unwrap();
    let source = DepthNoise::new(0.0, 0.1);
    let plane = fit.fit(&scaled, &world.camera, &[], &prior, source).unwrap();
    assert!((plane.pitch_rad.value - 0.2).abs() < 1e-4, "{plane:?}");
    assert!((plane.camera_height_m.value - 0.55).abs() < 1e-3, "{plane:?}");
    assert!((plane.camera_height_m.std - 0.055).abs() < 0.005, "{plane:?}");
    // The same map by a source that is sure of its scale contradicts the prior.
    let error = fit.fit(&scaled, &world.camera, &[], &prior, DepthNoise::NONE).unwrap_err();
    assert!(matches!(error, GroundFitError::Contradiction { name: "height", .. }), "{error}");
}

#[test]
fn where_there_is_no_ground_there_is_no_fit() {
    let camera = small(false);
    let prior = GroundPrior {
        camera_height_m: Uncertain::new(0.5, 0.02),
        pitch_rad: Uncertain::new(0.1, 0.03),
        roll_rad: Uncertain::new(0.0, 0.02),
    };
    let mut fit = GroundFit::new(GroundFitOptions::default()).unwrap();
    let mut error = |data: Vec<f32>, exclude: &[BoundingBox]| {
        let map = DepthMap::new(Stamp::ZERO, 160, 120, data).unwrap();
        fit.fit(&map, &camera, exclude, &prior, DepthNoise::NONE).unwrap_err()
    };
    let unknown = error(vec![0.0; 160 * 120], &[]);
    assert!(matches!(unknown, GroundFitError::TooFew { found: 0, .. }));
    // A wall meets the prior's floors along its foot only.
    let wall = error(vec![2.0; 160 * 120], &[]);
    assert!(matches!(wall, GroundFitError::NoPlane { .. }), "{wall}");
    let mut rng = Rng(64);
    let attitude = Attitude::new(0.1, 0.0);
    let world = World {
        camera,
        attitude,
        height: 0.5,
        clutter: 0,
        noise: 0.01,
        offset: 0.0,
        flatness_rad: 0.0,
        wall: 4.0,
    };
    let floor = world.map(&mut rng).into_data();
    let everything = BoundingBox::new(0.0, 0.0, 160.0, 120.0);
    assert!(matches!(error(floor.clone(), &[everything]), GroundFitError::TooFew { .. }));
    let wild = floor.iter().map(|_| rng.uniform(0.5, 5.0) as f32).collect();
    let wild = error(wild, &[]);
    let no_plane =
        |error| matches!(error, GroundFitError::NoPlane { .. } | GroundFitError::Rough { .. });
    assert!(no_plane(wild), "{wild}");
    let grass = World { noise: 0.1, ..world }.map(&mut rng).into_data();
    let grass = error(grass, &[]);
    assert!(matches!(grass, GroundFitError::Rough { limit: 2.5, .. }), "{grass}");
    let small_map = DepthMap::unknown(Stamp::ZERO, 80, 60).unwrap();
    let size = fit.fit(&small_map, &camera, &[], &prior, DepthNoise::NONE).unwrap_err();
    assert!(matches!(size, GroundFitError::Size { width: 80, .. }));
}
