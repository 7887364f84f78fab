"""Reference logits of the authors' VNL networks with ResNeXt encoders.

Builds the released encoder and decoder from a checkout of the authors'
repository, gives them weights by a formula, and keeps a few of the logits.
What each tensor means, and the formula, is written in the README.md of the
folder that they are kept in, crates/realnet-train/tests/data.

    git clone https://github.com/YvanYin/VNL_Monocular_Depth_Prediction
    python vnl_network.py VNL_Monocular_Depth_Prediction OUT_DIR
"""

import re
import sys
import types
from pathlib import Path

import numpy as np
import torch
from safetensors.numpy import save_file

WIDTH, HEIGHT = 80, 64
EVERY = 11  # kept are the logits of every so many-th pixel
NETWORKS = {
    "resnext50": ("resnext50_32x4d_nyudv2_class.yaml", 150),
    "resnext101": ("resnext101_32x4d_kitti_class.yaml", 100),
}


class Settings(dict):
    """Entries as attributes."""

    __getattr__ = dict.__getitem__


def configure(checkout, config, bins):
    """The parts of the authors' configuration that the networks read."""
    text = (checkout / "lib/configs" / config).read_text()
    value = lambda key: re.search(rf"^\s*{key}:\s*(.*?)\s*$", text, re.M).group(1)
    numbers = lambda key: [int(n) for n in re.findall(r"\d+", value(key))]
    assert int(value("DECODER_OUTPUT_C")) == bins
    model = Settings(
        ENCODER=value("ENCODER").strip("'"),
        INIT_TYPE="xavier",
        LOAD_IMAGENET_PRETRAINED_WEIGHTS=False,
        FREEZE_BACKBONE_BN=False,
        DECODER_OUTPUT_C=bins,
        **{key: numbers(key) for key in (
            "RESNET_BOTTLENECK_DIM", "LATERAL_OUT", "FCN_DIM_IN", "FCN_DIM_OUT")},
    )
    module = sys.modules.setdefault("lib.core.config", types.ModuleType("lib.core.config"))
    module.cfg = Settings(MODEL=model, DATASET=Settings(CROP_SIZE=(HEIGHT, WIDTH)))
    return module.cfg


def units(name, count):
    """Numbers from 0 to 1 that look random; of a name always the same."""
    seed = 7
    for byte in name.encode():
        seed = (seed * 31 & 0xFFFFFFFF) ^ byte
    x = np.arange(count, dtype=np.uint32) * np.uint32(2654435761) + np.uint32(seed)
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35)):
        x = (x ^ (x >> np.uint32(shift))) * np.uint32(factor)
    return (x ^ (x >> np.uint32(16))).astype(np.float64) / 2.0**32


def weight(name, shape):
    """The values of a parameter."""
    unit = units(name, int(np.prod(shape)))
    if name.endswith("running_var"):
        values = 0.5 + unit
    elif name.endswith(("running_mean", "bias")):
        values = 0.4 * unit - 0.2
    elif len(shape) == 1:
        values = 0.8 + 0.6 * unit
    else:
        values = (2.0 * unit - 1.0) * np.sqrt(2.0 / np.prod(shape[1:]))
    return torch.from_numpy(values.astype(np.float32).reshape(shape))


def logits(checkout, config, bins):
    """Of every EVERY-th pixel: [bins, rows, columns]."""
    cfg = configure(checkout, config, bins)
    for name in [name for name in sys.modules if name.startswith("lib.models")]:
        del sys.modules[name]
    import lib.models.lateral_net as nets

    parts = {
        "encoder_modules": getattr(nets, f"lateral_{cfg.MODEL.ENCODER}")(),
        "decoder_modules": nets.fcn_topdown(cfg.MODEL.ENCODER),
    }
    for prefix, part in parts.items():
        part.load_state_dict({
            name: old if name.endswith("num_batches_tracked")
            else weight(f"{prefix}.{name}", tuple(old.shape))
            for name, old in part.state_dict().items()
        })
        part.double().eval()
    image = (4.0 * units("image", 3 * WIDTH * HEIGHT) - 2.0).astype(np.float32)
    with torch.no_grad():
        image = torch.from_numpy(image.reshape(1, 3, HEIGHT, WIDTH)).double()
        out, _ = parts["decoder_modules"](*parts["encoder_modules"](image))
    assert out.shape == (1, bins, HEIGHT, WIDTH)
    return out[0, :, ::EVERY, ::EVERY].numpy().astype(np.float32)


def main():
    checkout, out = Path(sys.argv[1]), Path(sys.argv[2])
    sys.path.insert(0, str(checkout))
    tensors = {name: logits(checkout, *network) for name, network in NETWORKS.items()}
    for name, values in tensors.items():
        print(name, values.shape, "from", values.min(), "to", values.max(),
              "span over pixels", np.ptp(values, (1, 2)).max())
    about = f"PyTorch {torch.__version__}, double precision"
    save_file({k: np.ascontiguousarray(v) for k, v in tensors.items()},
              out / "vnl_network.safetensors", {"about": about})


if __name__ == "__main__":
    main()
