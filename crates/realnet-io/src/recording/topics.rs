//! The topics of a recording and their schemas.

use super::StateSchema;
use foxglove::messages::{CameraCalibration, CompressedImage, ImageAnnotations, RawImage};
use foxglove::{Encode, Schema};

const DETECTIONS_SCHEMA: &str = r#"{
  "title": "realnet.Detections",
  "description": "What a detector found in the frame whose exposure time is the publish time.",
  "type": "object",
  "properties": {
    "detections": {
      "type": "array",
      "items": {
        "type": "object",
        "properties": {
          "class_id": {"type": "integer", "description": "Index of the class."},
          "class": {"type": "string", "description": "Name of the class."},
          "confidence": {"type": "number", "description": "0 to 1."},
          "box": {
            "type": "array",
            "items": {"type": "number"},
            "description": "Left, top, right, bottom edge in pixels of the frame."
          }
        }
      }
    }
  }
}"#;

const COMMAND_SCHEMA: &str = r#"{
  "title": "realnet.Command",
  "description": "What the vehicle was told at the publish time.",
  "type": "object",
  "properties": {
    "speed_mps": {"type": "number", "description": "Metres a second, positive forward."},
    "steering_rad": {"type": "number", "description": "Virtual front wheel, positive to the left."},
    "yaw_rate_radps": {"type": "number", "description": "Radians a second, positive to the left."},
    "stop": {"type": ["string", "null"], "description": "Why it stops, if it does."}
  }
}"#;

/// What a message is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Topic {
    Image,
    Calibration,
    Detections,
    Annotations,
    Depth,
    State,
    Command,
}

impl Topic {
    /// All of them, in the order of their numbers.
    pub(super) const ALL: [Self; 7] = [
        Self::Image,
        Self::Calibration,
        Self::Detections,
        Self::Annotations,
        Self::Depth,
        Self::State,
        Self::Command,
    ];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Image => "/camera/image",
            Self::Calibration => "/camera/calibration",
            Self::Detections => "/detections",
            Self::Annotations => "/detections/annotations",
            Self::Depth => "/depth",
            Self::State => "/target",
            Self::Command => "/command",
        }
    }

    /// The encoding of its messages.
    pub(super) const fn encoding(self) -> &'static str {
        match self {
            Self::Image | Self::Calibration | Self::Annotations | Self::Depth => "protobuf",
            Self::Detections | Self::State | Self::Command => "json",
        }
    }

    /// Its schema; that of the state is the caller's.
    pub(super) fn schema(self, state: StateSchema<'_>) -> Schema {
        let json = |name: &str, text: &str| {
            Some(Schema::new(name, "jsonschema", text.as_bytes().to_vec()))
        };
        let schema = match self {
            Self::Image => CompressedImage::get_schema(),
            Self::Calibration => CameraCalibration::get_schema(),
            Self::Annotations => ImageAnnotations::get_schema(),
            Self::Depth => RawImage::get_schema(),
            Self::Detections => json("realnet.Detections", DETECTIONS_SCHEMA),
            Self::State => json(state.name, state.json),
            Self::Command => json("realnet.Command", COMMAND_SCHEMA),
        };
        // The messages of this crate all have one.
        schema.unwrap_or_else(|| Schema::new("", "", &b""[..]))
    }

    /// The topic of a channel of a file; `None` for one of another program.
    pub(super) fn of(name: &str, schema: &str, encoding: &str) -> Option<Self> {
        let any_state = StateSchema { name: schema, json: "" };
        Self::ALL.into_iter().find(|topic| {
            topic.name() == name
                && topic.encoding() == encoding
                && topic.schema(any_state).name == schema
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_are_known_by_topic_schema_and_encoding() {
        let state = StateSchema { name: "example.State", json: r#"{"type":"object"}"# };
        for (number, topic) in Topic::ALL.into_iter().enumerate() {
            assert_eq!(topic as usize, number);
            let schema = topic.schema(state);
            assert!(!schema.name.is_empty() && !schema.data.is_empty(), "{topic:?}");
            assert_eq!(Topic::of(topic.name(), &schema.name, topic.encoding()), Some(topic));
            assert_eq!(Topic::of(topic.name(), &schema.name, "cdr"), None);
            if schema.encoding == "jsonschema" {
                let json: serde_json::Value = serde_json::from_slice(&schema.data).unwrap();
                assert_eq!(json["type"], "object", "{topic:?}");
            }
        }
        assert_eq!(Topic::of("/camera/image", "sensor_msgs/CompressedImage", "protobuf"), None);
        assert_eq!(Topic::of("/other", "foxglove.RawImage", "protobuf"), None);
    }
}
