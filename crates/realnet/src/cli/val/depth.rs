//! `realnet val depth`.

mod data;
mod estimate;
mod kitti;
mod page;
mod report;

use crate::cli::{
    camera_args::CameraArgs,
    command_line,
    engine_args::EngineArgs,
    failure::{Outcome, bad_input, report as report_error, say},
    interrupt,
    model_args::{FilterFlag, parse_positive, parse_size},
    output::Output,
    progress,
};
use anyhow::Result;
use clap::{ArgGroup, Args, ValueEnum};
use data::{Data, Format, SelectArgs};
use estimate::{Estimator, NetworkArgs};
use page::Page;
use realnet::{
    CameraModel, DepthMap,
    eval::{DepthCrop, DepthMetrics, DepthProtocol, NormalMetrics, Pooling},
};
use realnet_pose::{NormalOptions, SurfaceNormals};
use report::{FrameErrors, Normals, Protocol, Report, Selection};
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(group = ArgGroup::new("estimator").required(true).args(["model", "predictions"]))]
pub(crate) struct DepthArgs {
    /// The data: a folder of colour pictures with depth maps, or a folder of such folders.
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// How the data lie on disk.
    #[arg(long, value_enum, default_value_t = Format::Auto)]
    format: Format,
    /// Depth units a metre of the data [default: by the format: 1000, 5000 or 256].
    #[arg(long, value_name = "UNITS", value_parser = parse_positive)]
    depth_scale: Option<f64>,
    /// The network: VNL or vnl-lite weights (.pt, .safetensors) or a depth ONNX file by RealNet.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Depth maps of another program instead: a PNG named like each picture.
    #[arg(long, value_name = "DIR")]
    predictions: Option<PathBuf>,
    /// Units a metre of those maps.
    #[arg(
        long,
        value_name = "UNITS",
        default_value_t = 1000.0,
        requires = "predictions",
        value_parser = parse_positive
    )]
    predictions_scale: f64,
    /// Input size of the network: N or WIDTHxHEIGHT [default: the file's own].
    #[arg(long, value_name = "N|WxH", requires = "model", value_parser = parse_size)]
    imgsz: Option<(u32, u32)>,
    /// Which of the network's outputs.
    #[arg(long, value_enum, default_value_t = DetailFlag::Fast)]
    detail: DetailFlag,
    /// How a frame is fitted into the network's input.
    #[arg(long, value_enum, default_value_t = FilterFlag::Triangle)]
    resize: FilterFlag,
    /// Compare surface normals too, of planes fitted to 7x7 depths, where the truth is inside crop
    /// and range; takes a camera.
    #[arg(long)]
    normals: bool,
    /// Write a page with pictures, metrics.json and images.csv into this directory.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// One JSON object on standard output, and nothing else there.
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    select: SelectArgs,
    #[command(flatten)]
    protocol: ProtocolArgs,
    #[command(flatten)]
    camera: CameraArgs,
    #[command(flatten)]
    engine: EngineArgs,
}

#[derive(Debug, Args)]
#[command(next_help_heading = "Protocol, printed with every result")]
struct ProtocolArgs {
    /// What the truth is: raw or improved for KITTI, else any words.
    #[arg(long, value_name = "WORDS")]
    truth: Option<String>,
    /// The part of the picture; eigen is that of KITTI or of NYU, by --format.
    #[arg(long, value_enum, default_value_t = CropFlag::None)]
    crop: CropFlag,
    /// Truth at or beyond is left out, produced depth lowered to it [default: 80 for KITTI, else
    /// 10].
    #[arg(long, value_name = "M", value_parser = parse_positive)]
    cap: Option<f64>,
    /// Truth at or below is left out, produced depth raised to it.
    #[arg(long, value_name = "M", default_value_t = 0.001, value_parser = parse_positive)]
    min_depth: f64,
    /// Multiply each map by the ratio of the medians, truth over produced.
    #[arg(long)]
    median_scaling: bool,
    /// Whether the figures are means of the images' or pool all pixels.
    #[arg(long, value_enum, default_value_t = PoolingFlag::PerImage)]
    pooling: PoolingFlag,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum CropFlag {
    None,
    /// Of the data: eigen-kitti or eigen-nyu.
    Eigen,
    Garg,
    EigenKitti,
    EigenNyu,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum PoolingFlag {
    PerImage,
    Pooled,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum DetailFlag {
    /// The coarsest, the fastest.
    Fast,
    /// The finest.
    Full,
}

impl ProtocolArgs {
    fn protocol(&self, data: &Data) -> Result<DepthProtocol> {
        let crop = match self.crop {
            CropFlag::None => DepthCrop::Full,
            CropFlag::Garg => DepthCrop::Garg,
            CropFlag::EigenKitti => DepthCrop::Eigen,
            CropFlag::EigenNyu => DepthCrop::Nyu,
            CropFlag::Eigen => data.eigen_crop().ok_or_else(|| {
                bad_input(
                    "--crop eigen: Eigen's crop of KITTI and that of NYU differ: say eigen-kitti \
                     or eigen-nyu, or the --format",
                )
            })?,
        };
        let own = || format!("as in the files ({})", data.layout);
        let truth = match data.truth {
            Some(kind) => kind.to_owned(),
            None => self.truth.clone().unwrap_or_else(own),
        };
        Ok(DepthProtocol {
            truth,
            crop,
            min_depth: self.min_depth,
            max_depth: self.cap.unwrap_or(if data.is_kitti { 80.0 } else { 10.0 }),
            median_scaling: self.median_scaling,
            pooling: match self.pooling {
                PoolingFlag::PerImage => Pooling::PerImage,
                PoolingFlag::Pooled => Pooling::Pixels,
            },
        })
    }
}

/// What the run gathers besides the metrics.
#[derive(Default)]
struct Gathered {
    frames: Vec<FrameErrors>,
    /// Pictures that could not be read or have no produced depth.
    bad: usize,
    ms: Vec<f64>,
    normals: NormalMetrics,
    surfaces: Option<(CameraModel, SurfaceNormals)>,
}

impl Gathered {
    /// Compares the surfaces of two depth maps of a camera.
    fn compare_normals(
        &mut self,
        camera: CameraModel,
        truth: &DepthMap,
        produced: &DepthMap,
        protocol: &DepthProtocol,
    ) -> Result<()> {
        let kept = self.surfaces.take().filter(|(of, _)| *of == camera);
        let (_, surfaces) =
            self.surfaces.insert(kept.unwrap_or_else(|| {
                (camera, SurfaceNormals::new(&camera, NormalOptions::default()))
            }));
        let [mut wanted, produced] = [surfaces.of(truth)?, surfaces.of(produced)?];
        let (rows, columns) = protocol.crop.window(truth.width(), truth.height());
        let range = protocol.min_depth..protocol.max_depth;
        wanted.retain(|x, y| {
            let depth = truth.row(y).get(x as usize).copied().map_or(0.0, f64::from);
            rows.contains(&y) && columns.contains(&x) && range.contains(&depth)
        });
        self.normals.add(wanted.angles(&produced));
        Ok(())
    }
}

pub(crate) fn run(args: &DepthArgs) -> Result<Outcome> {
    let truth = args.protocol.truth.as_deref();
    let mut data = Data::open(&args.data, args.format, args.depth_scale, truth)?;
    data.select(&args.data, &args.select)?;
    if data.samples.is_empty() {
        let folder = args.data.display();
        return Err(bad_input(format!("{folder}: no picture with a depth map was chosen")));
    }
    if data.without_depth > 0 {
        say(format!("{} pictures have no depth map and are left out", data.without_depth));
    }
    if data.scale_is_guessed {
        say("PNG depth is taken to have 5000 units a metre; millimetres need --depth-scale 1000");
    }
    if (args.model.is_some() || args.normals) && !args.camera.is_given() {
        data.check_cameras()?;
    }
    let protocol = args.protocol.protocol(&data)?;
    let mut metrics = DepthMetrics::new(protocol).map_err(bad_input)?;
    let network = NetworkArgs {
        size: args.imgsz,
        full: args.detail == DetailFlag::Full,
        filter: args.resize.into(),
    };
    let mut estimator = match (&args.model, &args.predictions) {
        (Some(model), _) => Estimator::network(model, &args.engine, &network)?,
        (None, Some(folder)) => Estimator::files(folder, args.predictions_scale)?,
        (None, None) => return Err(bad_input("--model or --predictions is needed")),
    };
    let inputs = [args.model.as_deref(), args.select.split.as_deref()];
    let page = args.report.as_deref().map(|folder| Page::create(folder, &inputs)).transpose()?;

    let mut gathered = Gathered::default();
    let outcome = measure(args, &data, &mut estimator, &mut metrics, &mut gathered)?;
    if outcome == Outcome::Interrupted {
        return Ok(outcome);
    }
    let errors = metrics.report();
    let Some(figures) = errors.errors() else {
        return Err(bad_input(format!(
            "{}: no pixel of {} pictures could be compared: none has a true depth from {} to {} m \
             inside the crop and a produced one",
            args.data.display(),
            data.samples.len(),
            errors.protocol.min_depth,
            errors.protocol.max_depth
        )));
    };
    if errors.images_compared < errors.images {
        let nothing = errors.images - errors.images_compared;
        say(format!("{nothing} pictures had no pixel to compare"));
    }
    let report = Report {
        errors: figures,
        images: errors.images_compared,
        protocol: Protocol {
            own: errors.protocol.clone(),
            data: args.data.display().to_string(),
            layout: data.layout.clone(),
            depth_scale: data.samples.first().map_or(0.0, |sample| sample.scale),
            selection: Selection::new(&args.select, &data),
            images_left_out: data.without_depth + gathered.bad,
            images_without_comparison: errors.images - errors.images_compared,
            truth_pixels: errors.truth_pixels,
            pixels: errors.pixels,
            known_share: errors.known_share,
            scale: errors.scale,
            estimator: estimator.words(),
            camera: camera_words(args, &data),
        },
        normals: Normals::new(&gathered.normals, NormalOptions::default()),
        ms_per_image: report::median(&mut gathered.ms),
    };
    let text = report::text(&report, &errors);
    let written = page.map_or(Ok(()), |page| {
        let command = command_line();
        let camera = &args.camera;
        page.finish(&command, &report, &text, &data, &gathered.frames, &mut estimator, camera)
    });
    let mut output = Output::stdout();
    let told = if args.json { output.json(&report) } else { output.line(text.trim_end()) };
    // Neither a full disk nor a reader that went away costs the other its figures.
    written?;
    if let Some(folder) = &args.report {
        say(format!("the report is {}", folder.join(page::INDEX).display()));
    }
    told.map(|()| outcome)
}

/// Produces and compares the depth of every picture.
fn measure(
    args: &DepthArgs,
    data: &Data,
    estimator: &mut Estimator,
    metrics: &mut DepthMetrics,
    gathered: &mut Gathered,
) -> Result<Outcome> {
    let bar = progress::bar(Some(data.samples.len() as u64), "val depth");
    let mut outcome = Outcome::Done;
    for (index, sample) in data.samples.iter().enumerate() {
        if interrupt::interrupted() {
            bar.finish_and_clear();
            return Ok(Outcome::Interrupted);
        }
        bar.inc(1);
        let read = sample.read().and_then(|(frame, truth)| {
            let prepared = estimator.prepare(sample, &frame, &args.camera)?;
            let camera = || sample.camera(&args.camera, frame.width(), frame.height());
            let camera = args.normals.then(camera).transpose()?;
            Ok((prepared, camera, frame, truth))
        });
        let (prepared, camera, frame, truth) = match read {
            Ok(read) => read,
            Err(error) => {
                // A picture that is bad costs only itself.
                bar.suspend(|| report_error(&error));
                gathered.bad += 1;
                outcome = Outcome::BadInputs;
                continue;
            }
        };
        let (produced, ms) = estimator.run(prepared, &frame)?;
        gathered.ms.extend(ms);
        let compared = metrics.add(&truth, &produced)?;
        if let Some(camera) = camera {
            gathered.compare_normals(camera, &truth, &produced, metrics.protocol())?;
        }
        gathered.frames.push(FrameErrors { index, compared });
    }
    bar.finish_and_clear();
    Ok(outcome)
}

/// Which camera the depths were made for, in words.
fn camera_words(args: &DepthArgs, data: &Data) -> Option<String> {
    args.model.as_ref()?;
    if args.camera.is_given() {
        return Some("of the command line".to_owned());
    }
    data.samples.first().map(|sample| sample.camera.words())
}
