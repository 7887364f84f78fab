//! A run to record, made of numbers that are not round.
#![allow(dead_code, clippy::unwrap_used)]

use realnet_core::{
    BoundingBox, CameraCalibration, CameraModel, DepthMap, Detection, Distortion, DriveCommand,
    Frame, Intrinsics, Stamp, StopReason,
};
use realnet_io::picture::{self, Encoding};
use realnet_io::recording::{
    Content, NamedDetection, RecordError, Recorded, RunInfo, RunReader, RunWriter, StateSchema,
    Times,
};
use std::io::Write;

/// Schema of [`Step::state`].
pub const STATE: StateSchema<'static> = StateSchema {
    name: "test.State",
    json: r#"{"type": "object", "properties": {"frame": {"type": "integer"}}}"#,
};

pub fn info() -> RunInfo {
    RunInfo {
        parameters: "gap_m = 1.5 # wide ä\n".into(),
        versions: [("realnet".into(), "0.1.0".into()), ("detector".into(), "v2".into())].into(),
    }
}

pub fn names() -> Vec<String> {
    vec!["rc_car".into()]
}

/// A picture of 24x16 pixels, another for each number.
pub fn frames(stamp: Stamp, index: u64) -> Frame {
    let pixels = (0..24 * 16).flat_map(|i| {
        let (x, y) = (i % 24, i / 24);
        [x as u8 * 10, y as u8 * 15, (index as u8).wrapping_mul(7)]
    });
    Frame::rgb8(stamp, 24, 16, pixels.collect()).unwrap()
}

pub fn calibration() -> CameraCalibration {
    let intrinsics = Intrinsics { fx: 500.1, fy: 499.7, cx: 11.5, cy: 7.3 };
    let lens = Distortion::PlumbBob([-0.3, 0.1, 1e-4, -2e-4, 0.05]);
    CameraCalibration::new("front", CameraModel::new(24, 16, intrinsics, lens).unwrap())
}

/// What there is to record of one frame.
pub struct Step {
    pub index: u64,
    pub times: Times,
    pub picture: Vec<u8>,
    pub found: Vec<Detection>,
    pub depth: DepthMap,
    pub state: serde_json::Value,
    pub command: DriveCommand,
}

impl Step {
    /// Frame number `index` of 30 a second, which arrives 41 ms late.
    pub fn new(index: u64) -> Self {
        let stamp = Stamp::of_frame(index, 30.0);
        let times = Times { arrival: stamp.seconds_later(0.041), stamp };
        let shift = index as f32 / 7.0;
        let car = Detection {
            class_id: 0,
            confidence: 0.1 + 0.8 / (1.0 + shift),
            bbox: BoundingBox::new(1.1 + shift, 2.2, 13.3 + shift, 9.9),
        };
        let other = Detection { class_id: 5, confidence: f32::MIN_POSITIVE, ..car };
        let depths = (0..12).map(|i| if i == 5 { 0.0 } else { shift + i as f32 / 3.0 });
        Self {
            index,
            times,
            picture: picture::encode(&frames(stamp, index), Encoding::Jpeg { quality: 80 })
                .unwrap(),
            // Every third frame shows nothing.
            found: if index % 3 == 2 { vec![] } else { vec![car, other] },
            depth: DepthMap::new(stamp, 4, 3, depths.collect()).unwrap(),
            state: serde_json::json!({
                "frame": index, "range_m": f64::from(shift) / 3.0, "class": null, "text": "ö"
            }),
            command: DriveCommand {
                stamp: times.arrival,
                speed: 1.0 / 3.0 + f64::from(shift),
                steering_angle: -0.1,
                yaw_rate: 1e-300,
                stop: (index % 2 == 1).then_some(StopReason::StaleInput),
            },
        }
    }

    pub fn write<W: Write>(&self, run: &mut RunWriter<W>) -> Result<(), RecordError> {
        let arrival = self.times.arrival;
        if self.index == 0 {
            run.calibration(self.times, &calibration())?;
        }
        run.image(self.times, &self.picture)?;
        run.detections(self.times, &self.found, &names())?;
        run.depth(arrival, &self.depth)?;
        run.state(self.times, &self.state)?;
        run.command(arrival, &self.command)
    }

    /// What is to be read of it.
    pub fn expected(&self) -> Vec<Recorded> {
        let named = self.found.iter().map(|&detection| NamedDetection {
            class: if detection.class_id == 0 { "rc_car".into() } else { "5".into() },
            detection,
        });
        let mut contents = vec![
            Content::Image(self.picture.clone()),
            Content::Detections(named.collect()),
            Content::Depth(self.depth.clone()),
            Content::State(self.state.clone()),
            Content::Command(self.command),
        ];
        if self.index == 0 {
            contents.insert(0, Content::Calibration(calibration().into()));
        }
        let recorded = contents.into_iter().map(|content| {
            let stamp = match content {
                Content::Command(command) => command.stamp,
                _ => self.times.stamp,
            };
            Recorded { times: Times { stamp, ..self.times }, content }
        });
        recorded.collect()
    }
}

/// A whole recording of so many frames, and what is to be read of it.
pub fn write_run(count: u64) -> (Vec<u8>, Vec<Recorded>) {
    let mut run = RunWriter::new(Vec::new(), "test", &info(), STATE).unwrap();
    let mut expected = Vec::new();
    for step in (0..count).map(Step::new) {
        step.write(&mut run).unwrap();
        expected.extend(step.expected());
    }
    (run.finish().unwrap(), expected)
}

pub fn read_all(bytes: &[u8]) -> Vec<Recorded> {
    RunReader::new(bytes, "test").unwrap().map(Result::unwrap).collect()
}
