"""Depth maps of FastDepth (int8 TFLite), to be judged by `realnet val depth --predictions`.

    python fast_depth.py --model fast_depth_224_int8.tflite --out maps/ pictures...

Pictures are files or folders. FastDepth (Wofk et al., ICRA 2019) takes 224x224 RGB and
gives 224x224 numbers; its authors train it on the middle of NYU Depth V2, so a picture is
scaled to the input either as a whole (`--fit stretch`) or, as they do, its largest middle
square (`--fit crop`: what is outside the square stays unknown). The output is metres
after the quantisation's scale (an output of 0 counts as half a step), written in each
picture's own size as 16 bit PNG in millimetres under the picture's name.
"""

import argparse
import json
import statistics
import sys
import time
from pathlib import Path

import numpy as np
from ai_edge_litert.interpreter import Interpreter
from PIL import Image

PICTURES = {".jpg", ".jpeg", ".png"}


def pictures(paths):
    for path in map(Path, paths):
        if path.is_dir():
            found = sorted(p for p in path.iterdir() if p.suffix.lower() in PICTURES)
            # In RGB-D folders depth maps lie beside the pictures.
            yield from (p for p in found if not p.stem.endswith((".depth", "_depth")))
        else:
            yield path


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", required=True)
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--fit", choices=["stretch", "crop"], default="stretch")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--metres", type=float, help="metres a unit of the raw output")
    parser.add_argument("pictures", nargs="+")
    args = parser.parse_args()

    net = Interpreter(args.model, num_threads=args.threads)
    net.allocate_tensors()
    given, made = net.get_input_details()[0], net.get_output_details()[0]
    _, side_y, side_x, _ = given["shape"]
    scale, zero = made["quantization"]
    scale = args.metres or scale
    args.out.mkdir(parents=True, exist_ok=True)
    ms = []
    for path in pictures(args.pictures):
        picture = Image.open(path).convert("RGB")
        start = time.perf_counter()
        width, height = picture.size
        box = (0, 0, width, height)
        if args.fit == "crop":
            side = min(width, height)
            x, y = (width - side) // 2, (height - side) // 2
            box = (x, y, x + side, y + side)
        fitted = picture.crop(box).resize((side_x, side_y), Image.BILINEAR)
        net.set_tensor(given["index"], np.asarray(fitted, np.uint8)[None])
        net.invoke()
        raw = net.get_tensor(made["index"]).reshape(made["shape"][1:3])
        # 0 would be 'unknown', and infinitely wrong in logarithms.
        metres = np.maximum(raw.astype(np.float32) - zero, 0.5) * np.float32(scale)
        size = (box[2] - box[0], box[3] - box[1])
        metres = np.asarray(Image.fromarray(metres).resize(size, Image.BILINEAR))
        ms.append((time.perf_counter() - start) * 1e3)
        whole = np.zeros((height, width), np.uint16)
        whole[box[1] : box[3], box[0] : box[2]] = np.rint(metres * 1000)
        Image.fromarray(whole).save(args.out / (path.stem + ".png"))
    if not ms:
        sys.exit("no pictures")
    print(json.dumps({"images": len(ms), "ms_per_image": statistics.median(ms), "metres_a_unit": scale}))


if __name__ == "__main__":
    main()
