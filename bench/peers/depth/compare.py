#!/usr/bin/env python3
"""Milliseconds of the VNL depth network at 256x256 on every engine, in one run.

Runs all sides interleaved, block by block, with the same threads, and prints one
JSON object: the median and the least of all runs of a side, and which side has the
least median. The forms of the network:

* `depth`: the graph as released, from the normalised input to depth at every pixel;
* `full`: logits of every pixel by the engine, softmax and weighted sum by RealNet
  (on OpenVINO, which RealNet does not embed, the logits alone);
* `half`: likewise at every second pixel, what RealNet runs by default;
* `frame`: the whole of RealNet's DepthNet, from a 1280x720 frame.

With `--fast-path 256x256 640x360` the geometric path between two depth maps runs
in the same blocks, on one thread, on drawn frames of those sizes; the ratios of the
fastest side of each form to it are printed.

    pip install -r bench/peers/depth/requirements.txt
    cargo build --release -p realnet-nn --example depth_peer
    cargo build --release -p realnet-range --example motion_peer
    python bench/peers/depth/compare.py --model vnl.safetensors
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))


class Side:
    def __init__(self, name, command):
        self.name, self.times = name, {}
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        line = self.process.stdout.readline().strip()
        if line != "ready":
            sys.exit(f"{name}: expected 'ready', found {line!r}")

    def run(self, count):
        self.process.stdin.write(f"{count}\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    def close(self):
        self.process.stdin.close()
        self.process.wait()


def ort_library():
    import onnxruntime

    capi = Path(onnxruntime.__file__).parent / "capi"
    return str(sorted(capi.glob("libonnxruntime.so*"))[-1])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", required=True, help="weights of the network")
    parser.add_argument("--size", default="256x256", help="WxH of the input")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--blocks", type=int, default=15)
    parser.add_argument("--count", type=int, default=5, help="runs a block")
    parser.add_argument("--forms", nargs="+", default=["depth", "full", "half", "frame"])
    parser.add_argument("--fast-path", nargs="*", default=[], metavar="WxH")
    parser.add_argument("--ort-dylib", help="default: the one in the onnxruntime wheel")
    parser.add_argument("--binary", default=TARGET / "release/examples/depth_peer")
    args = parser.parse_args()

    peer = [str(args.binary), "--model", args.model, "--size", args.size]
    threads = ["--threads", str(args.threads)]
    ort = ["--ort-dylib", args.ort_dylib or ort_library()]
    python = [sys.executable, str(Path(__file__).parent / "python_peer.py")]
    sides = []
    with tempfile.TemporaryDirectory() as scratch:
        for form in args.forms:
            ours = [*peer, *threads, "--form", form]
            sides.append(Side(f"rten {form}", ours))
            sides.append(Side(f"onnxruntime {form}", [*ours, *ort]))
            if form != "frame":
                graph = str(Path(scratch) / f"{form}.onnx")
                subprocess.run([*ours, "--write", graph], check=True)
                sides.append(Side(f"openvino {form}", [*python, *threads, "--graph", graph]))
        motion = str(TARGET / "release/examples/motion_peer")
        for size in args.fast_path:
            sides.append(Side(f"fast path {size}", [motion, "--size", size]))
        for side in sides:
            side.run(args.count)  # warm
        for _ in range(args.blocks):
            for side in sides:
                # Idle threads of the side before still spin for a while.
                time.sleep(0.1)
                for what, ms in side.run(args.count).items():
                    side.times.setdefault(what, []).extend(ms)
        for side in sides:
            side.close()
    medians = {side.name: round(statistics.median(side.times["ms"]), 3) for side in sides}
    report = {"size": args.size, "threads": args.threads, "median_ms": medians}
    # What a busy machine disturbs least.
    report["least_ms"] = {side.name: round(min(side.times["ms"]), 3) for side in sides}
    report["stage_medians_ms"] = {
        side.name: {
            what: round(statistics.median(ms), 3)
            for what, ms in side.times.items()
            if what != "ms"
        }
        for side in sides
        if len(side.times) > 1
    }
    report["fastest"] = {
        form: min((name for name in medians if name.endswith(f" {form}")), key=medians.get)
        for form in args.forms
    }
    if args.fast_path:
        report["times_faster"] = {
            f"{size}, {form}": round(medians[report["fastest"][form]] / medians[f"fast path {size}"], 1)
            for size in args.fast_path
            for form in args.forms
        }
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
