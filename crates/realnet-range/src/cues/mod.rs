//! Range cues: what one box says about the distance, each with its deviation.
