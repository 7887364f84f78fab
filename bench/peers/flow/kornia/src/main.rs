//! The kornia-imgproc side of `bench/peers/flow/compare.py`; same protocol as
//! `crates/realnet-vision/examples/flow_peer.rs`. Run with RAYON_NUM_THREADS=1.
//!
//! Pixels are floats in 0 to 1, as its functions want them, converted before the
//! clock starts. It has a corner response with suppression of non-maxima but no
//! selection, so threshold, order and minimum distance are done here as simply
//! as they can be.

use kornia_image::{Image, ImageSize};
use kornia_imgproc::features::gftt_response;
use kornia_imgproc::optical_flow_pyr_lk::{PyrLKParams, calc_optical_flow_pyr_lk};
use std::{error::Error, io::BufRead, time::Instant};

const QUALITY: f32 = 0.01;
const DISTANCE: f32 = 10.0;

fn corners(
    image: &Image<f32, 1>,
    response: &mut Image<f32, 1>,
    most: usize,
) -> Result<Vec<[f32; 2]>, Box<dyn Error>> {
    gftt_response(image, response, 3, 3, true)?;
    let width = image.width();
    let best = response.as_slice().iter().copied().fold(0.0, f32::max);
    let mut candidates: Vec<(f32, usize)> = response
        .as_slice()
        .iter()
        .enumerate()
        .filter(|(_, v)| **v > best * QUALITY)
        .map(|(i, v)| (*v, i))
        .collect();
    candidates.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
    let mut points: Vec<[f32; 2]> = Vec::new();
    for (_, at) in candidates {
        let point = [(at % width) as f32, (at / width) as f32];
        let near = |p: &[f32; 2]| {
            (p[0] - point[0]).powi(2) + (p[1] - point[1]).powi(2) < DISTANCE * DISTANCE
        };
        if !points.iter().any(near) {
            points.push(point);
            if points.len() == most {
                break;
            }
        }
    }
    Ok(points)
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let flag = |name: &str| {
        let at = arguments.iter().position(|a| a == name);
        at.and_then(|at| arguments.get(at + 1)).ok_or_else(|| format!("{name} is missing"))
    };
    let (width, height): (usize, usize) = (flag("--width")?.parse()?, flag("--height")?.parse()?);
    let most: usize = flag("--corners")?.parse()?;
    let size = ImageSize { width, height };
    let frames = std::fs::read(flag("--frames")?)?
        .chunks_exact(width * height)
        .map(|raw| Image::<f32, 1>::new(size, raw.iter().map(|v| *v as f32 / 255.0).collect()))
        .collect::<Result<Vec<_>, _>>()?;
    let mut response = Image::<f32, 1>::from_size_val(size, 0.0)?;
    let params = PyrLKParams::default();
    let mut next = 1;
    println!("ready");
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        let all = line.trim() == "tracks";
        let count = if all { frames.len() - 1 } else { line.trim().parse()? };
        if all {
            next = 1;
        }
        let (mut ms, mut stages, mut pairs) = (Vec::new(), [vec![], vec![]], Vec::new());
        for _ in 0..count {
            let start = Instant::now();
            let points = corners(&frames[next - 1], &mut response, most)?;
            let found = Instant::now();
            let tracks =
                calc_optical_flow_pyr_lk(&frames[next - 1], &frames[next], &points, None, &params)?;
            let end = Instant::now();
            ms.push((end - start).as_secs_f64() * 1e3);
            stages[0].push((found - start).as_secs_f64() * 1e3);
            stages[1].push((end - found).as_secs_f64() * 1e3);
            next = next % (frames.len() - 1) + 1;
            if all {
                let pair: Vec<_> = (0..points.len())
                    .map(|i| {
                        let found = tracks.status[i] != 0;
                        (points[i], tracks.next_pts[i], found, tracks.error[i])
                    })
                    .collect();
                pairs.push(pair);
            }
        }
        let [corners, flow] = stages;
        println!(
            "{}",
            serde_json::json!({ "ms": ms, "corners": corners, "flow": flow, "pairs": pairs })
        );
    }
    Ok(())
}
