//! Which layers a network has and how they are wired, before their tensors
//! are read: from the modules of the file, or from the known layouts.

use std::collections::{BTreeMap, BTreeSet};

use super::ImportError;
use crate::weights::{Checkpoint, ModuleInfo};

/// Most layers of a network; YOLOv5 has 25 or 34.
const MAX_LAYERS: usize = 512;

/// Kind of a layer.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Kind {
    Conv {
        stride: usize,
    },
    Focus,
    C3 {
        shortcut: bool,
    },
    BottleneckCsp {
        shortcut: bool,
    },
    Bottleneck {
        shortcut: bool,
    },
    /// One or more bottlenecks in a row under `N.0`, `N.1`, ….
    Sequence {
        shortcut: bool,
    },
    /// Kernels of the parallel poolings.
    Spp {
        kernels: Vec<usize>,
    },
    Upsample,
    Concat,
    Detect,
}

impl Kind {
    fn name(&self) -> &'static str {
        match self {
            Kind::Conv { .. } => "Conv",
            Kind::Focus => "Focus",
            Kind::C3 { .. } => "C3",
            Kind::BottleneckCsp { .. } => "BottleneckCSP",
            Kind::Bottleneck { .. } => "Bottleneck",
            Kind::Sequence { .. } => "Sequential",
            Kind::Spp { .. } => "SPP",
            Kind::Upsample => "Upsample",
            Kind::Concat => "Concat",
            Kind::Detect => "Detect",
        }
    }
}

/// A layer to be read: what it is and which layers it reads (`None`: the image).
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Step {
    pub kind: Kind,
    pub inputs: Vec<Option<usize>>,
}

/// Plans the layers of a checkpoint.
pub(super) fn plan(checkpoint: &Checkpoint) -> Result<Vec<Step>, ImportError> {
    let names = layer_names(checkpoint)?;
    let last = *names.keys().next_back().unwrap_or(&0);
    if last >= MAX_LAYERS {
        let reason = format!("{} layers; at most {MAX_LAYERS} are read", last.saturating_add(1));
        return Err(ImportError::UnknownLayout { reason });
    }
    let wired = (0..=last).all(|i| {
        let module = checkpoint.modules.get(&format!("model.{i}"));
        module.is_some_and(|m| m.numbers.contains_key("f") && !m.class.is_empty())
    });
    if wired { from_modules(checkpoint, last) } else { from_names(checkpoint, &names, last) }
}

/// Names of the tensors of every layer, without `model.N.`.
fn layer_names(checkpoint: &Checkpoint) -> Result<BTreeMap<usize, BTreeSet<&str>>, ImportError> {
    let mut layers: BTreeMap<usize, BTreeSet<&str>> = BTreeMap::new();
    for name in checkpoint.tensors.keys() {
        let split = name.strip_prefix("model.").and_then(|rest| rest.split_once('.'));
        if let Some((index, rest)) = split
            && let Ok(index) = index.parse()
        {
            layers.entry(index).or_default().insert(rest);
        }
    }
    if layers.is_empty() {
        let first = checkpoint.tensors.keys().next();
        return Err(ImportError::NotYolo {
            tensors: checkpoint.tensors.len(),
            first: first.map_or_else(|| "there are none".to_owned(), |n| format!("'{n}'")),
        });
    }
    Ok(layers)
}

// From modules.

fn from_modules(checkpoint: &Checkpoint, last: usize) -> Result<Vec<Step>, ImportError> {
    (0..=last)
        .map(|index| {
            let path = format!("model.{index}");
            let module = checkpoint
                .modules
                .get(&path)
                .ok_or_else(|| ImportError::UnknownLayer { index, kind: "missing".to_owned() })?;
            let kind = kind_of_module(checkpoint, index, &path, module)?;
            let from = module.numbers.get("f").map(Vec::as_slice).unwrap_or_default();
            let inputs = from.iter().map(|&f| input_index(index, f)).collect::<Result<_, _>>()?;
            Ok(Step { kind, inputs })
        })
        .collect()
}

/// Negative numbers count back from the layer; −1 of layer 0 is the image.
fn input_index(index: usize, from: f64) -> Result<Option<usize>, ImportError> {
    let absolute = if from < 0.0 { index as f64 + from } else { from };
    if absolute == -1.0 {
        return Ok(None);
    }
    if absolute.fract() != 0.0 || absolute < 0.0 || absolute >= index as f64 {
        let reason = format!("reads layer {from}, which does not come before it");
        return Err(ImportError::Wiring { index, reason });
    }
    Ok(Some(absolute as usize))
}

fn kind_of_module(
    checkpoint: &Checkpoint,
    index: usize,
    path: &str,
    module: &ModuleInfo,
) -> Result<Kind, ImportError> {
    let unknown = || ImportError::UnknownLayer { index, kind: module.class.clone() };
    Ok(match module.class.as_str() {
        "Conv" => Kind::Conv { stride: 1 },
        "Focus" => Kind::Focus,
        "C3" => Kind::C3 { shortcut: true },
        "BottleneckCSP" => Kind::BottleneckCsp { shortcut: true },
        "Bottleneck" => Kind::Bottleneck { shortcut: true },
        "Sequential" => {
            let first = checkpoint.modules.get(&format!("{path}.0")).ok_or_else(unknown)?;
            match first.class.as_str() {
                "Bottleneck" => Kind::Sequence { shortcut: true },
                inner => {
                    let kind = format!("Sequential of {inner}");
                    return Err(ImportError::UnknownLayer { index, kind });
                }
            }
        }
        "SPP" | "SPPF" => Kind::Spp { kernels: pool_kernels(checkpoint, path)? },
        "Upsample" => {
            let scale = module.numbers.get("scale_factor").map(Vec::as_slice);
            if !matches!(scale, Some([2.0] | [2.0, 2.0])) {
                return Err(ImportError::Module {
                    module: path.to_owned(),
                    reason: format!("upsamples by {scale:?}; only 2 is supported"),
                });
            }
            Kind::Upsample
        }
        "Concat" => {
            let axis = module.numbers.get("d").map(Vec::as_slice);
            if !matches!(axis, Some([1.0]) | None) {
                return Err(ImportError::Module {
                    module: path.to_owned(),
                    reason: format!("concatenates along axis {axis:?}; only 1 is supported"),
                });
            }
            Kind::Concat
        }
        "Detect" => Kind::Detect,
        _ => return Err(unknown()),
    })
}

/// Kernels of the parallel poolings of SPP, or those that SPPF amounts to.
fn pool_kernels(checkpoint: &Checkpoint, path: &str) -> Result<Vec<usize>, ImportError> {
    let kernel = |path: &str| -> Option<usize> {
        let k = *checkpoint.modules.get(path)?.numbers.get("kernel_size")?.first()?;
        (k.fract() == 0.0 && (1.0..=255.0).contains(&k) && k % 2.0 == 1.0).then_some(k as usize)
    };
    let error =
        |reason: &str| ImportError::Module { module: path.to_owned(), reason: reason.to_owned() };
    let pools: Vec<usize> = (0..16).map_while(|i| kernel(&format!("{path}.m.{i}"))).collect();
    if pools.is_empty() {
        let k = kernel(&format!("{path}.m")).ok_or_else(|| error("no odd pooling kernel"))?;
        return Ok(vec![k, 2 * k - 1, 3 * k - 2]);
    }
    if pools.is_sorted_by(|a, b| a < b) {
        return Ok(pools);
    }
    Err(error("the pooling kernels do not increase"))
}

// From names.

/// Plans a network whose file tells only tensors: one of the known layouts.
fn from_names(
    checkpoint: &Checkpoint,
    names: &BTreeMap<usize, BTreeSet<&str>>,
    last: usize,
) -> Result<Vec<Step>, ImportError> {
    let focus = names.get(&0).is_some_and(|n| n.contains("conv.conv.weight"));
    let stages = match last {
        24 => 4,
        33 => 5,
        _ => {
            let reason = format!(
                "{} layers; without the modules of the file only the standard layouts of 25 and 34 \
                 layers are known",
                last + 1
            );
            return Err(ImportError::UnknownLayout { reason });
        }
    };
    let mut steps = standard(stages, focus);
    for (index, step) in steps.iter_mut().enumerate() {
        let tensors = names.get(&index);
        let found = tensors.map_or("Parameterless", kind_of_names);
        let expected = match &step.kind {
            Kind::Upsample | Kind::Concat => "Parameterless",
            kind => kind.name(),
        };
        match (&step.kind, found) {
            (Kind::C3 { shortcut }, "BottleneckCSP") => {
                let shortcut = *shortcut;
                let told = checkpoint.modules.contains_key("model.0.act")
                    || checkpoint.modules.contains_key("model.0.conv.act");
                if !told {
                    let reason = "networks of BottleneckCSP used LeakyReLU or Hardswish; the file \
                                  holds only tensors and does not tell which"
                        .to_owned();
                    return Err(ImportError::UnknownLayout { reason });
                }
                step.kind = Kind::BottleneckCsp { shortcut };
            }
            (_, found) if found == expected => {}
            (_, "unknown") => {
                let some: Vec<&str> = tensors.into_iter().flatten().take(3).copied().collect();
                let kind = format!("with tensors {}", some.join(", "));
                return Err(ImportError::UnknownLayer { index, kind });
            }
            _ => {
                let reason = format!("layer model.{index} looks like {found}, expected {expected}");
                return Err(ImportError::UnknownLayout { reason });
            }
        }
    }
    Ok(steps)
}

/// Kind of a layer by the names of its tensors.
fn kind_of_names(names: &BTreeSet<&str>) -> &'static str {
    let has = |name: &str| names.contains(name);
    if has("conv.weight") {
        "Conv"
    } else if has("conv.conv.weight") {
        "Focus"
    } else if has("cv1.conv.weight") && has("cv4.conv.weight") {
        "BottleneckCSP"
    } else if has("cv1.conv.weight") && has("cv3.conv.weight") {
        "C3"
    } else if has("cv1.conv.weight") && has("cv2.conv.weight") {
        "SPP"
    } else if has("m.0.weight") {
        "Detect"
    } else {
        "unknown"
    }
}

/// The layouts of YOLOv5: `stages` is 4 for three heads (P5) and 5 for four (P6);
/// `focus` tells the generations before v6.
///
/// Backbone: stem, then per stage a convolution of stride 2 and a C3, with the
/// pyramid pooling after (v6) or inside (before) the last stage. Head: down the
/// pyramid by upsampling, up again by convolutions of stride 2.
fn standard(stages: usize, focus: bool) -> Vec<Step> {
    let mut steps: Vec<Step> = Vec::new();
    let mut add = |kind: Kind, others: &[usize]| -> usize {
        let index = steps.len();
        let mut inputs = vec![index.checked_sub(1)];
        inputs.extend(others.iter().map(|&i| Some(i)));
        steps.push(Step { kind, inputs });
        index
    };
    add(if focus { Kind::Focus } else { Kind::Conv { stride: 2 } }, &[]);
    let mut levels = Vec::new();
    for stage in 1..=stages {
        add(Kind::Conv { stride: 2 }, &[]);
        let old_top = focus && stage == stages;
        if old_top {
            // Before v6 the networks of four heads pooled with smaller kernels.
            let kernels = if stages == 5 { vec![3, 5, 7] } else { vec![5, 9, 13] };
            add(Kind::Spp { kernels }, &[]);
        }
        levels.push(add(Kind::C3 { shortcut: !old_top }, &[]));
    }
    if !focus {
        add(Kind::Spp { kernels: vec![5, 9, 13] }, &[]);
    }
    let mut laterals = Vec::new();
    let mut heads = Vec::new();
    // The pyramid levels to merge with, coarse to fine, without the top and the first.
    for &level in levels.iter().rev().skip(1).take(stages - 2) {
        laterals.push(add(Kind::Conv { stride: 1 }, &[]));
        add(Kind::Upsample, &[]);
        add(Kind::Concat, &[level]);
        heads = vec![add(Kind::C3 { shortcut: false }, &[])];
    }
    for &lateral in laterals.iter().rev() {
        add(Kind::Conv { stride: 2 }, &[]);
        add(Kind::Concat, &[lateral]);
        heads.push(add(Kind::C3 { shortcut: false }, &[]));
    }
    let inputs = heads.into_iter().map(Some).collect();
    steps.push(Step { kind: Kind::Detect, inputs });
    steps
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn standard_layouts_are_wired_as_published() {
        for focus in [false, true] {
            let p5 = standard(4, focus);
            assert_eq!(p5.len(), 25);
            assert_eq!(p5[0].inputs, [None]);
            assert_eq!(p5[12].inputs, [Some(11), Some(6)]);
            assert_eq!(p5[16].inputs, [Some(15), Some(4)]);
            assert_eq!(p5[19].inputs, [Some(18), Some(14)]);
            assert_eq!(p5[22].inputs, [Some(21), Some(10)]);
            assert_eq!(p5[24].inputs, [Some(17), Some(20), Some(23)]);
            let p6 = standard(5, focus);
            assert_eq!(p6.len(), 34);
            assert_eq!(p6[14].inputs, [Some(13), Some(8)]);
            assert_eq!(p6[22].inputs, [Some(21), Some(4)]);
            assert_eq!(p6[25].inputs, [Some(24), Some(20)]);
            assert_eq!(p6[31].inputs, [Some(30), Some(12)]);
            assert_eq!(p6[33].inputs, [Some(23), Some(26), Some(29), Some(32)]);
        }
        assert_eq!(standard(4, true)[8].kind, Kind::Spp { kernels: vec![5, 9, 13] });
        assert_eq!(standard(4, true)[9].kind, Kind::C3 { shortcut: false });
        assert_eq!(standard(4, false)[8].kind, Kind::C3 { shortcut: true });
        assert_eq!(standard(5, true)[10].kind, Kind::Spp { kernels: vec![3, 5, 7] });
    }

    #[test]
    fn layers_read_only_earlier_layers() {
        assert_eq!(input_index(0, -1.0).unwrap(), None);
        assert_eq!(input_index(5, -1.0).unwrap(), Some(4));
        assert_eq!(input_index(5, -6.0).unwrap(), None);
        assert_eq!(input_index(5, 3.0).unwrap(), Some(3));
        for bad in [5.0, 6.0, -7.0, 1.5, f64::NAN] {
            assert!(input_index(5, bad).is_err(), "{bad}");
        }
    }
}
