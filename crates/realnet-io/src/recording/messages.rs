//! RealNet's types as messages, and back.

use super::topics::Topic;
use super::{Content, NamedDetection, Times};
use crate::annotate::class_color;
use foxglove::bytes::Bytes;
use foxglove::messages::{
    CameraCalibration as CalibrationMessage, Color, CompressedImage, ImageAnnotations, Point2,
    PointsAnnotation, RawImage, TextAnnotation, Timestamp, points_annotation::Type,
};
use prost::Message;
use realnet_core::nalgebra::{Matrix3, Matrix3x4};
use realnet_core::{
    BoundingBox, CameraCalibration, CameraModel, DepthMap, Detection, Distortion, DriveCommand,
    Intrinsics, StopReason,
};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Foxglove's name of a depth map in 32-bit floats, little-endian.
const DEPTH_ENCODING: &str = "32FC1";
/// Height of a label, pixels.
const FONT_SIZE: f64 = 14.0;
/// Width of the lines of a box, pixels.
const LINE_WIDTH: f64 = 2.0;

/// The picture format of the bytes, by Foxglove's name; `None` for other bytes.
pub(super) fn picture_format(bytes: &[u8]) -> Option<&'static str> {
    if bytes.starts_with(&[0xff, 0xd8, 0xff]) {
        Some("jpeg")
    } else if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
        Some("png")
    } else {
        None
    }
}

pub(super) fn image(
    timestamp: Timestamp,
    frame_id: &str,
    format: &str,
    picture: &[u8],
) -> CompressedImage {
    CompressedImage {
        timestamp: Some(timestamp),
        frame_id: frame_id.into(),
        data: Bytes::copy_from_slice(picture),
        format: format.into(),
    }
}

pub(super) fn calibration(
    timestamp: Timestamp,
    frame_id: &str,
    calibration: &CameraCalibration,
) -> CalibrationMessage {
    let camera = calibration.camera();
    // Without a model Foxglove takes the picture for that of a pinhole.
    let model = match camera.distortion() {
        Distortion::None => "",
        Distortion::PlumbBob(_) => "plumb_bob",
        Distortion::RationalPolynomial(_) => "rational_polynomial",
        Distortion::Equidistant(_) => "kannala_brandt",
    };
    CalibrationMessage {
        timestamp: Some(timestamp),
        frame_id: frame_id.into(),
        width: camera.width(),
        height: camera.height(),
        distortion_model: model.into(),
        d: camera.distortion().coefficients().to_vec(),
        k: camera.matrix().transpose().as_slice().to_vec(),
        r: calibration.rectification().transpose().as_slice().to_vec(),
        p: calibration.projection().transpose().as_slice().to_vec(),
    }
}

fn read_calibration(message: CalibrationMessage) -> Result<CameraCalibration, String> {
    let k: [f64; 9] = values("K", &message.k)?;
    let intrinsics = Intrinsics { fx: k[0], fy: k[4], cx: k[2], cy: k[5] };
    let distortion = match message.distortion_model.as_str() {
        "" => Distortion::None,
        "plumb_bob" => Distortion::PlumbBob(values("D", &message.d)?),
        "rational_polynomial" => Distortion::RationalPolynomial(values("D", &message.d)?),
        "kannala_brandt" => Distortion::Equidistant(values("D", &message.d)?),
        other => return Err(format!("unknown distortion model {other:?}")),
    };
    let camera = CameraModel::new(message.width, message.height, intrinsics, distortion)
        .map_err(|e| e.to_string())?;
    CameraCalibration::new(message.frame_id, camera)
        .with_rectification(
            Matrix3::from_row_slice(&values::<9>("R", &message.r)?),
            Matrix3x4::from_row_slice(&values::<12>("P", &message.p)?),
        )
        .map_err(|e| e.to_string())
}

fn values<const N: usize>(name: &str, given: &[f64]) -> Result<[f64; N], String> {
    given.try_into().map_err(|_| format!("{name} has {} values, expected {N}", given.len()))
}

pub(super) fn depth(timestamp: Timestamp, frame_id: &str, map: &DepthMap) -> RawImage {
    RawImage {
        timestamp: Some(timestamp),
        frame_id: frame_id.into(),
        width: map.width(),
        height: map.height(),
        encoding: DEPTH_ENCODING.into(),
        step: map.width().saturating_mul(4),
        data: map.data().iter().flat_map(|depth| depth.to_le_bytes()).collect(),
    }
}

fn read_depth(times: Times, message: &RawImage) -> Result<DepthMap, String> {
    let RawImage { width, height, encoding, step, data, .. } = message;
    if encoding != DEPTH_ENCODING {
        return Err(format!("depth is {encoding:?}, expected {DEPTH_ENCODING:?}"));
    }
    if Some(*step) != width.checked_mul(4) || !data.len().is_multiple_of(4) {
        return Err(format!("{} bytes in rows of {step} for {width}x{height} depths", data.len()));
    }
    let (depths, _) = data.as_chunks::<4>();
    let depths = depths.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    DepthMap::new(times.stamp, *width, *height, depths).map_err(|e| e.to_string())
}

/// A number of a JSON message: `null` where it is not finite.
#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(from = "Option<f64>", into = "Option<f64>")]
struct Number(f64);

impl From<Option<f64>> for Number {
    fn from(value: Option<f64>) -> Self {
        Self(value.unwrap_or(f64::NAN))
    }
}

impl From<Number> for Option<f64> {
    fn from(Number(value): Number) -> Self {
        value.is_finite().then_some(value)
    }
}

/// `f32` values go through `f64`, whose text is read back exactly.
impl From<f32> for Number {
    fn from(value: f32) -> Self {
        Self(f64::from(value))
    }
}

/// A message on `/detections`.
#[derive(Serialize, Deserialize)]
pub(super) struct DetectionsMessage<'a> {
    detections: Vec<DetectionMessage<'a>>,
}

#[derive(Serialize, Deserialize)]
struct DetectionMessage<'a> {
    class_id: u32,
    class: Cow<'a, str>,
    confidence: Number,
    #[serde(rename = "box")]
    bbox: [Number; 4],
}

fn class_name(class_id: u32, names: &[String]) -> Cow<'_, str> {
    match names.get(class_id as usize) {
        Some(name) => Cow::Borrowed(name),
        None => Cow::Owned(class_id.to_string()),
    }
}

pub(super) fn detections<'a>(found: &[Detection], names: &'a [String]) -> DetectionsMessage<'a> {
    let detections = found.iter().map(|found| DetectionMessage {
        class_id: found.class_id,
        class: class_name(found.class_id, names),
        confidence: found.confidence.into(),
        bbox: <[f32; 4]>::from(found.bbox).map(Number::from),
    });
    DetectionsMessage { detections: detections.collect() }
}

fn read_detections(message: DetectionsMessage<'_>) -> Vec<NamedDetection> {
    let detections = message.detections.into_iter().map(|found| NamedDetection {
        class: found.class.into_owned(),
        detection: Detection {
            class_id: found.class_id,
            confidence: found.confidence.0 as f32,
            bbox: BoundingBox::from(found.bbox.map(|Number(edge)| edge as f32)),
        },
    });
    detections.collect()
}

/// The boxes and labels of detections, in the colours of [`crate::annotate`].
/// Foxglove counts from the corner of the picture, as [`BoundingBox`] does.
pub(super) fn annotations(
    timestamp: Timestamp,
    found: &[Detection],
    names: &[String],
) -> ImageAnnotations {
    ImageAnnotations {
        timestamp: Some(timestamp),
        points: found.iter().map(|found| outline(timestamp, found)).collect(),
        texts: found.iter().map(|found| label(timestamp, found, names)).collect(),
        ..ImageAnnotations::default()
    }
}

fn outline(timestamp: Timestamp, found: &Detection) -> PointsAnnotation {
    let [x0, y0, x1, y1] = <[f32; 4]>::from(found.bbox).map(f64::from);
    let corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)];
    PointsAnnotation {
        timestamp: Some(timestamp),
        r#type: Type::LineLoop.into(),
        points: corners.map(|(x, y)| Point2 { x, y }).to_vec(),
        outline_color: Some(color(found.class_id)),
        thickness: LINE_WIDTH,
        ..PointsAnnotation::default()
    }
}

fn label(timestamp: Timestamp, found: &Detection, names: &[String]) -> TextAnnotation {
    let name = class_name(found.class_id, names);
    TextAnnotation {
        timestamp: Some(timestamp),
        position: Some(Point2 { x: found.bbox.x0.into(), y: found.bbox.y0.into() }),
        text: format!("{name} {:.2}", found.confidence),
        font_size: FONT_SIZE,
        text_color: Some(Color { r: 0.0, g: 0.0, b: 0.0, a: 1.0 }),
        background_color: Some(color(found.class_id)),
        ..TextAnnotation::default()
    }
}

fn color(class_id: u32) -> Color {
    let [r, g, b] = class_color(class_id).map(|value| f64::from(value) / 255.0);
    Color { r, g, b, a: 1.0 }
}

/// A message on `/command`.
#[derive(Serialize, Deserialize)]
pub(super) struct CommandMessage<'a> {
    speed_mps: Number,
    steering_rad: Number,
    yaw_rate_radps: Number,
    stop: Option<Cow<'a, str>>,
}

pub(super) fn command(command: &DriveCommand) -> CommandMessage<'static> {
    CommandMessage {
        speed_mps: Number(command.speed),
        steering_rad: Number(command.steering_angle),
        yaw_rate_radps: Number(command.yaw_rate),
        stop: command.stop.map(|reason| reason.name().into()),
    }
}

fn read_command(times: Times, message: &CommandMessage<'_>) -> Result<DriveCommand, String> {
    let reason = |name: &Cow<'_, str>| {
        let known = StopReason::ALL.into_iter().find(|reason| reason.name() == name);
        known.ok_or_else(|| format!("unknown reason to stop {name:?}"))
    };
    Ok(DriveCommand {
        stamp: times.stamp,
        speed: message.speed_mps.0,
        steering_angle: message.steering_rad.0,
        yaw_rate: message.yaw_rate_radps.0,
        stop: message.stop.as_ref().map(reason).transpose()?,
    })
}

/// What a message says; `None` for one that repeats another. The error is what
/// is wrong with it.
pub(super) fn decode(topic: Topic, times: Times, data: Bytes) -> Result<Option<Content>, String> {
    Ok(Some(match topic {
        Topic::Image => {
            let message = protobuf::<CompressedImage>(data)?;
            Content::Image(message.data.into())
        }
        Topic::Calibration => Content::Calibration(Box::new(read_calibration(protobuf(data)?)?)),
        Topic::Detections => Content::Detections(read_detections(json(&data)?)),
        Topic::Annotations => return Ok(None),
        Topic::Depth => Content::Depth(read_depth(times, &protobuf(data)?)?),
        Topic::State => Content::State(json(&data)?),
        Topic::Command => Content::Command(read_command(times, &json(&data)?)?),
    }))
}

fn protobuf<M: Message + Default>(data: Bytes) -> Result<M, String> {
    M::decode(data).map_err(|e| e.to_string())
}

fn json<'a, M: Deserialize<'a>>(data: &'a [u8]) -> Result<M, String> {
    serde_json::from_slice(data).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use realnet_core::Stamp;

    const TIMES: Times = Times { arrival: Stamp::ZERO, stamp: Stamp::from_nanos(7) };

    fn bytes_of(message: &impl Message) -> Bytes {
        message.encode_to_vec().into()
    }

    #[test]
    fn cameras_of_every_lens_come_back() {
        let intrinsics = Intrinsics { fx: 500.1, fy: 499.9, cx: 319.5, cy: 239.25 };
        for lens in [
            Distortion::None,
            Distortion::PlumbBob([-0.3, 0.1, 1e-4, -2e-4, 0.05]),
            Distortion::RationalPolynomial([0.1, 0.01, 1e-4, 1e-4, 0.0, 0.2, 0.01, 1e-3]),
            Distortion::Equidistant([0.01, -0.002, 3e-4, 0.0]),
        ] {
            let camera = CameraModel::new(640, 480, intrinsics, lens).unwrap();
            let given = CameraCalibration::new("front", camera)
                .with_rectification(
                    Matrix3::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0),
                    Matrix3x4::from_row_slice(&[0.5; 12]),
                )
                .unwrap();
            let message = calibration(Timestamp::MIN, "front", &given);
            let read = decode(Topic::Calibration, TIMES, bytes_of(&message)).unwrap();
            assert_eq!(read, Some(Content::Calibration(given.into())));
        }
    }

    #[test]
    fn what_is_no_camera_says_why() {
        let camera = CameraModel::new(
            4,
            3,
            Intrinsics { fx: 1.0, fy: 1.0, cx: 0.0, cy: 0.0 },
            Distortion::None,
        )
        .unwrap();
        let good = calibration(Timestamp::MIN, "", &CameraCalibration::new("", camera));
        let reason = |change: fn(&mut CalibrationMessage)| {
            let mut message = good.clone();
            change(&mut message);
            read_calibration(message).unwrap_err()
        };
        assert_eq!(reason(|m| m.k.truncate(4)), "K has 4 values, expected 9");
        assert_eq!(reason(|m| m.p.push(0.0)), "P has 13 values, expected 12");
        assert_eq!(
            reason(|m| m.distortion_model = "fisheye62".into()),
            "unknown distortion model \"fisheye62\""
        );
        assert!(reason(|m| m.width = 0).contains("0x3"));
    }

    #[test]
    fn depth_of_another_form_says_why() {
        let map = DepthMap::new(TIMES.stamp, 2, 1, vec![1.0, 2.0]).unwrap();
        let good = depth(Timestamp::MIN, "camera", &map);
        let reason = |change: fn(&mut RawImage)| {
            let mut message = good.clone();
            change(&mut message);
            read_depth(TIMES, &message).unwrap_err()
        };
        assert!(reason(|m| m.encoding = "16UC1".into()).contains("16UC1"));
        assert!(reason(|m| m.step = 12).contains("rows of 12"));
        assert!(reason(|m| m.data = m.data.slice(..7)).contains("7 bytes"));
        assert!(reason(|m| m.height = 2).contains("found 2"));
        assert!(reason(|m| m.width = u32::MAX).contains("rows of 8"));
    }

    #[test]
    fn numbers_that_are_not_finite_are_null() {
        let given =
            DriveCommand { speed: f64::INFINITY, yaw_rate: -0.0, ..DriveCommand::default() };
        let text = serde_json::to_string(&command(&given)).unwrap();
        assert_eq!(
            text,
            r#"{"speed_mps":null,"steering_rad":0.0,"yaw_rate_radps":-0.0,"stop":null}"#
        );
        match decode(Topic::Command, TIMES, text.into()).unwrap() {
            Some(Content::Command(read)) => assert!(read.speed.is_nan()),
            other => panic!("{other:?}"),
        }
        let unknown = r#"{"speed_mps":0,"steering_rad":0,"yaw_rate_radps":0,"stop":"why"}"#;
        let error = decode(Topic::Command, TIMES, unknown.into()).unwrap_err();
        assert_eq!(error, "unknown reason to stop \"why\"");
    }

    #[test]
    fn every_reason_to_stop_comes_back() {
        for reason in StopReason::ALL {
            let given = DriveCommand::stopped(TIMES.stamp, reason);
            let text = serde_json::to_vec(&command(&given)).unwrap();
            let read = decode(Topic::Command, TIMES, text.into()).unwrap();
            assert_eq!(read, Some(Content::Command(given)));
        }
    }

    #[test]
    fn annotations_are_where_the_boxes_are() {
        let bbox = BoundingBox::new(10.0, 20.0, 50.0, 40.0);
        let found = [Detection { class_id: 1, confidence: 0.876, bbox }];
        let message = annotations(Timestamp::MIN, &found, &["a".into(), "rc_car".into()]);
        let corners: Vec<_> = message.points[0].points.iter().map(|p| (p.x, p.y)).collect();
        assert_eq!(corners, [(10.0, 20.0), (50.0, 20.0), (50.0, 40.0), (10.0, 40.0)]);
        assert_eq!(message.texts[0].text, "rc_car 0.88");
    }

    proptest! {
        #[test]
        fn detections_come_back_to_the_bit(
            class_id: u32, confidence in any_finite(), edges in prop::array::uniform4(any_finite())
        ) {
            let found = Detection { class_id, confidence, bbox: edges.into() };
            let text = serde_json::to_vec(&detections(&[found], &["car".into()])).unwrap();
            let read = match decode(Topic::Detections, TIMES, text.into()).unwrap() {
                Some(Content::Detections(mut read)) => read.remove(0),
                other => panic!("{other:?}"),
            };
            let bits = |d: &Detection| {
                let [x0, y0, x1, y1] = <[f32; 4]>::from(d.bbox);
                [d.confidence, x0, y0, x1, y1].map(f32::to_bits)
            };
            prop_assert_eq!(bits(&read.detection), bits(&found));
            prop_assert_eq!(read.detection.class_id, class_id);
            let name = if class_id == 0 { "car".into() } else { class_id.to_string() };
            prop_assert_eq!(read.class, name);
        }

        #[test]
        fn depth_comes_back_to_the_bit(bits in prop::collection::vec(any::<u32>(), 6)) {
            let data = bits.iter().map(|&bits| f32::from_bits(bits)).collect();
            let map = DepthMap::new(TIMES.stamp, 3, 2, data).unwrap();
            let message = depth(Timestamp::MIN, "camera", &map);
            let read = match decode(Topic::Depth, TIMES, bytes_of(&message)).unwrap() {
                Some(Content::Depth(read)) => read,
                other => panic!("{other:?}"),
            };
            prop_assert_eq!((read.stamp(), read.width(), read.height()), (TIMES.stamp, 3, 2));
            let read: Vec<u32> = read.data().iter().map(|depth| depth.to_bits()).collect();
            prop_assert_eq!(read, bits);
        }
    }

    fn any_finite() -> impl Strategy<Value = f32> {
        any::<u32>().prop_map(f32::from_bits).prop_filter("finite", |v| v.is_finite())
    }
}
