//! Cameras of the Linux kernel (Video4Linux 2), MJPEG or YUYV.

use super::queue::Queue;
use super::{
    Produce, Release, Source, SourceError, SourceFrame, SourceKind, SourceOptions, unix_now,
};
use crate::{picture, yuv};
use realnet_core::{Frame, Stamp};
use rustix::time::{ClockId, clock_gettime};
use std::io;
use std::sync::Arc;
use std::time::Duration;
use v4l::buffer::{Flags, Metadata, Type};
use v4l::framesize::FrameSizeEnum;
use v4l::io::mmap::Stream;
use v4l::io::traits::CaptureStream;
use v4l::video::Capture;
use v4l::video::capture::Parameters;
use v4l::{Device, Format, FourCC};

const MJPEG: [u8; 4] = *b"MJPG";
const YUYV: [u8; 4] = *b"YUYV";

/// Broken frames in a row (bad cable, camera starting up) before that is an
/// error.
const MAX_BROKEN: u32 = 30;

/// How long a camera may take to start.
const START: Duration = Duration::from_secs(10);

/// How long one wait for a picture takes, in milliseconds: short, so that a
/// source that is stopped ends soon.
const PAUSE_MS: i32 = 200;

/// `POLLIN`: there is something to read.
const POLLIN: i16 = 1;

/// Opens `device`, which must deliver MJPEG or YUYV at the size asked for.
pub(super) fn open(device: &str, options: &SourceOptions) -> Result<Source, SourceError> {
    let failed = |message: String| SourceError::Camera { name: device.to_string(), message };
    let dev = Device::with_path(device).map_err(|e| match e.kind() {
        io::ErrorKind::NotFound => SourceError::NotFound { spec: device.to_string() },
        _ => failed(format!("cannot open: {e}")),
    })?;
    let offers = offers(&dev).map_err(|e| failed(format!("this is no camera: {e}")))?;
    let format = choose(&dev, &offers, options.size).map_err(failed)?;
    if let Some(fps) = options.fps {
        let params = Parameters::new(v4l::Fraction::new(1000, (fps * 1000.0).round() as u32));
        dev.set_params(&params).map_err(|e| failed(format!("{fps} frames a second: {e}")))?;
    }
    let fps = dev.params().ok().map(|p| p.interval).filter(|i| i.numerator > 0);
    let fps = fps.map(|i| f64::from(i.denominator) / f64::from(i.numerator));
    let mut stream = Stream::with_buffers(&dev, Type::VideoCapture, 4)
        .map_err(|e| failed(format!("cannot capture: {e}")))?;
    // For the first picture, which starts the camera; later ones are waited for
    // by `poll`, because a read that times out leaves its buffer queued.
    stream.set_timeout(START);
    let live = options.live.unwrap_or(true);
    let queue = Arc::new(Queue::new(options.ahead, live));
    queue.set_fps(fps);
    let producer = Box::new(Camera {
        stream,
        _device: dev,
        format,
        name: device.to_string(),
        limits: options.limits,
        queue: Arc::clone(&queue),
        index: 0,
        started: false,
        first_sequence: None,
        broken: 0,
        failed: false,
    });
    let wiring: (_, Release) = (queue, Arc::new(|| {}));
    Source::start(SourceKind::Camera, device.to_string(), live, None, options, wiring, producer)
}

/// What a camera offers in the formats that are understood.
struct Offer {
    fourcc: [u8; 4],
    sizes: Vec<FrameSizeEnum>,
}

fn offers(dev: &Device) -> io::Result<Vec<Offer>> {
    let formats = dev.enum_formats()?;
    let known = formats.into_iter().filter(|f| [MJPEG, YUYV].contains(&f.fourcc.repr));
    Ok(known
        .map(|f| Offer {
            fourcc: f.fourcc.repr,
            sizes: dev
                .enum_framesizes(f.fourcc)
                .map(|list| list.into_iter().map(|s| s.size).collect())
                .unwrap_or_default(),
        })
        .collect())
}

/// The sizes on offer, for people: `MJPG 640x480, 1280x720; YUYV 640x480`.
fn listed(offers: &[Offer]) -> String {
    let size = |s: &FrameSizeEnum| match s {
        FrameSizeEnum::Discrete(d) => format!("{}x{}", d.width, d.height),
        FrameSizeEnum::Stepwise(s) => format!(
            "{}x{} to {}x{} in steps of {}x{}",
            s.min_width, s.min_height, s.max_width, s.max_height, s.step_width, s.step_height
        ),
    };
    let offer = |o: &Offer| {
        let sizes = o.sizes.iter().map(size).collect::<Vec<_>>().join(", ");
        format!("{} {sizes}", String::from_utf8_lossy(&o.fourcc))
    };
    offers.iter().map(offer).collect::<Vec<_>>().join("; ")
}

/// True when a size is on offer; a camera that lists no sizes may have any.
fn has_size(offer: &Offer, width: u32, height: u32) -> bool {
    let stepped = |v: u32, min: u32, max: u32, step: u32| {
        (min..=max).contains(&v) && (v - min).is_multiple_of(step.max(1))
    };
    offer.sizes.is_empty()
        || offer.sizes.iter().any(|size| match size {
            FrameSizeEnum::Discrete(d) => (d.width, d.height) == (width, height),
            FrameSizeEnum::Stepwise(s) => {
                stepped(width, s.min_width, s.max_width, s.step_width)
                    && stepped(height, s.min_height, s.max_height, s.step_height)
            }
        })
}

/// Sets the format: the size asked for or the present one, compressed where the
/// camera can (raw video of more than VGA is too much for USB 2).
fn choose(dev: &Device, offers: &[Offer], size: Option<(u32, u32)>) -> Result<Format, String> {
    if offers.is_empty() {
        let formats = dev.enum_formats().unwrap_or_default();
        let found = formats.iter().map(|f| f.fourcc.to_string()).collect::<Vec<_>>().join(", ");
        return Err(format!("offers neither MJPEG nor YUYV, only: {found}"));
    }
    let present = dev.format().map_err(|e| format!("cannot read its format: {e}"))?;
    let (width, height) = size.unwrap_or((present.width, present.height));
    let mut fitting: Vec<&Offer> =
        offers.iter().filter(|o| size.is_none() || has_size(o, width, height)).collect();
    fitting.sort_by_key(|o| o.fourcc != MJPEG);
    for offer in fitting {
        let wanted = Format::new(width, height, FourCC::new(&offer.fourcc));
        let set = dev.set_format(&wanted).map_err(|e| format!("{width}x{height}: {e}"))?;
        // Drivers answer with the nearest that they can do.
        if set.fourcc.repr == offer.fourcc
            && (size.is_none() || (set.width, set.height) == (width, height))
        {
            return Ok(set);
        }
    }
    Err(format!("does not offer {width}x{height}; it offers {}", listed(offers)))
}

struct Camera {
    stream: Stream<'static>,
    _device: Device,
    format: Format,
    name: String,
    limits: picture::Limits,
    queue: Arc<Queue>,
    index: u64,
    /// True once the camera was asked for its first picture.
    started: bool,
    first_sequence: Option<u32>,
    broken: u32,
    failed: bool,
}

impl Produce for Camera {
    fn next(&mut self, mut spare: Vec<u8>) -> Option<Result<SourceFrame, SourceError>> {
        while !self.failed && !self.queue.is_stopped() {
            // Silence: the taker decides when that is too long.
            if self.started && matches!(self.stream.handle().poll(POLLIN, PAUSE_MS), Ok(0)) {
                continue;
            }
            self.started = true;
            let (bytes, meta) = match self.stream.next() {
                Ok((bytes, meta)) => (bytes, *meta),
                Err(e) if e.kind() == io::ErrorKind::TimedOut => {
                    self.failed = true;
                    let message = format!("no picture within {} s", START.as_secs());
                    return Some(Err(SourceError::Camera { name: self.name.clone(), message }));
                }
                Err(e) => {
                    self.failed = true;
                    let message = format!("capture failed (unplugged?): {e}");
                    return Some(Err(SourceError::Camera { name: self.name.clone(), message }));
                }
            };
            let stamp = stamp(&meta);
            // Some drivers leave the length at 0; then the whole buffer counts.
            let used = match meta.bytesused as usize {
                0 => bytes,
                length => bytes.get(..length).unwrap_or(bytes),
            };
            let sequence = *self.first_sequence.get_or_insert(meta.sequence);
            // The driver counts lost frames too.
            self.index = self.index.max(u64::from(meta.sequence.wrapping_sub(sequence)));
            let index = self.index;
            self.index += 1;
            let frame = if meta.flags.contains(Flags::ERROR) {
                Err("the driver calls the frame damaged".to_string())
            } else {
                convert(used, &self.format, &self.limits, std::mem::take(&mut spare))
            };
            match frame {
                Ok(frame) => {
                    self.broken = 0;
                    let frame = frame.with_stamp(stamp);
                    return Some(Ok(SourceFrame { frame, index, name: self.name.clone() }));
                }
                Err(reason) => {
                    self.broken += 1;
                    if self.broken >= MAX_BROKEN {
                        self.failed = true;
                        let message = format!("{MAX_BROKEN} broken frames in a row: {reason}");
                        return Some(Err(SourceError::Camera { name: self.name.clone(), message }));
                    }
                }
            }
        }
        None
    }
}

/// One captured buffer to an RGB frame.
fn convert(
    bytes: &[u8],
    format: &Format,
    limits: &picture::Limits,
    mut buffer: Vec<u8>,
) -> Result<Frame, String> {
    if format.fourcc.repr == MJPEG {
        return picture::decode(bytes, limits, buffer).map_err(|e| e.to_string());
    }
    let (width, height) = (format.width, format.height);
    let stride = (format.stride as usize).max(width as usize * 2);
    if !yuv::yuyv_to_rgb(bytes, width as usize, height as usize, stride, &mut buffer) {
        return Err(format!("{} bytes are no {width}x{height} YUYV frame", bytes.len()));
    }
    Frame::rgb8(Stamp::ZERO, width, height, buffer).map_err(|e| e.to_string())
}

/// The driver's capture stamp, moved from the monotonic clock to Unix time; the
/// time of arrival for a driver that stamps by another clock.
fn stamp(meta: &Metadata) -> Stamp {
    let now = unix_now();
    if meta.flags & Flags::TIMESTAMP_MASK != Flags::TIMESTAMP_MONOTONIC {
        return now;
    }
    let clock = clock_gettime(ClockId::Monotonic);
    let monotonic = clock.tv_sec.saturating_mul(1_000_000_000).saturating_add(clock.tv_nsec);
    let captured = meta
        .timestamp
        .sec
        .saturating_mul(1_000_000_000)
        .saturating_add(meta.timestamp.usec.saturating_mul(1000));
    // A stamp from the future is no stamp.
    let age = monotonic.saturating_sub(captured).max(0);
    Stamp::from_nanos(now.nanos().saturating_sub(age))
}

#[cfg(test)]
mod tests {
    use super::*;
    use v4l::framesize::{Discrete, Stepwise};

    fn offer() -> Offer {
        let stepwise = Stepwise {
            min_width: 32,
            max_width: 640,
            step_width: 16,
            min_height: 32,
            max_height: 480,
            step_height: 2,
        };
        let sizes = vec![
            FrameSizeEnum::Discrete(Discrete { width: 1280, height: 720 }),
            FrameSizeEnum::Stepwise(stepwise),
        ];
        Offer { fourcc: YUYV, sizes }
    }

    #[test]
    fn sizes_on_offer_are_known_and_listed() {
        let offer = offer();
        assert!(has_size(&offer, 1280, 720) && has_size(&offer, 640, 480));
        assert!(!has_size(&offer, 1280, 721) && !has_size(&offer, 41, 32));
        assert!(!has_size(&offer, 0, 0));
        assert_eq!(listed(&[offer]), "YUYV 1280x720, 32x32 to 640x480 in steps of 16x2");
    }

    #[test]
    fn both_formats_convert() {
        let limits = picture::Limits::default();
        let grey = Frame::grey8(Stamp::ZERO, 16, 8, vec![128; 128]).unwrap();
        let jpeg = picture::encode(&grey, picture::Encoding::Jpeg { quality: 90 }).unwrap();
        let format = Format::new(16, 8, FourCC::new(&MJPEG));
        let frame = convert(&jpeg, &format, &limits, Vec::new()).unwrap();
        assert_eq!((frame.width(), frame.height()), (16, 8));
        assert!(convert(&jpeg[..jpeg.len() / 2], &format, &limits, Vec::new()).is_err());
        let format = Format::new(16, 8, FourCC::new(&YUYV));
        let frame = convert(&[128; 256], &format, &limits, Vec::new()).unwrap();
        assert!(frame.data().iter().all(|v| *v == 130));
        let error = convert(&[128; 255], &format, &limits, Vec::new()).unwrap_err();
        assert!(error.contains("255 bytes"), "{error}");
    }

    #[test]
    fn driver_stamps_become_unix_time() {
        let mut meta = Metadata { flags: Flags::TIMESTAMP_MONOTONIC, ..Metadata::default() };
        let clock = clock_gettime(ClockId::Monotonic);
        meta.timestamp = v4l::Timestamp::new(clock.tv_sec - 2, 0);
        let age = unix_now().seconds_since(stamp(&meta));
        assert!((2.0..60.0).contains(&age), "{age}");
    }

    #[test]
    fn devices_that_do_not_exist_or_are_no_camera_are_named() {
        for device in ["/dev/video9876", "/dev/null"] {
            let error = open(device, &SourceOptions::default()).err().unwrap().to_string();
            assert!(error.contains(device), "{error}");
        }
    }
}
