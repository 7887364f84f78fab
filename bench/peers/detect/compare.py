"""A frame in memory to boxes: RealNet against Python with OpenCV, NumPy, onnxruntime.

Runs the sides interleaved, block by block, on the same ONNX file, frame and
thread count, and prints the ratios of their medians. "realnet-ort" resizes as the
Python program does; "realnet-ort-triangle" is RealNet's default, which does more
work to avoid aliasing. See docs/benchmarks.md.

    pip install -r bench/peers/detect/requirements.txt
    cargo build --release -p realnet --example detect_peer
    cargo run --release -- convert yolov5n.pt -o yolov5n_320.onnx --imgsz 320
    cargo run --release -- convert yolov5n.pt -o yolov5n_640.onnx --imgsz 640
    python bench/peers/detect/compare.py --models yolov5n_320.onnx yolov5n_640.onnx --picture zidane.jpg
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2

ROOT = Path(__file__).resolve().parents[3]


class Side:
    def __init__(self, name, command):
        self.name, self.times, self.last = name, [], {}
        self.stages = {"pre": [], "infer": [], "post": []}
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        line = self.process.stdout.readline().strip()
        if line != "ready":
            sys.exit(f"{name}: expected 'ready', found {line!r}")

    def run(self, frames):
        self.process.stdin.write(f"{frames}\n")
        self.process.stdin.flush()
        self.last = json.loads(self.process.stdout.readline())
        return self.last["ms"]

    def close(self):
        self.process.stdin.close()
        self.process.wait()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--models", nargs="+", required=True, help="ONNX files")
    parser.add_argument("--picture", required=True)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--blocks", type=int, default=30)
    parser.add_argument("--frames", type=int, default=10, help="per block")
    parser.add_argument("--ort-dylib", help="default: the one in the onnxruntime wheel")
    parser.add_argument("--binary", default=ROOT / "target/release/examples/detect_peer")
    parser.add_argument("--json", help="write the figures to this file")
    args = parser.parse_args()

    dylib = args.ort_dylib
    if dylib is None:
        import onnxruntime

        capi = Path(onnxruntime.__file__).parent / "capi"
        dylib = str(sorted(capi.glob("libonnxruntime.so*"))[-1])
    picture = cv2.cvtColor(cv2.imread(args.picture), cv2.COLOR_BGR2RGB)
    picture = cv2.resize(picture, (1280, 720))
    figures = []
    with tempfile.TemporaryDirectory() as scratch:
        frame = Path(scratch) / "frame.rgb"
        frame.write_bytes(picture.tobytes())
        for model in args.models:
            common = ["--model", model, "--frame", str(frame), "--threads", str(args.threads)]
            python = str(Path(__file__).parent / "python_peer.py")
            ours = str(args.binary)
            sides = [
                Side("python", [sys.executable, python, *common]),
                Side("realnet-ort", [ours, *common, "--ort-dylib", dylib, "--resize", "linear"]),
                Side("realnet-ort-triangle", [ours, *common, "--ort-dylib", dylib]),
                Side("realnet-rten", [ours, *common, "--resize", "linear"]),
            ]
            for side in sides:
                side.run(args.frames)  # warm
            for _ in range(args.blocks):
                for side in sides:
                    # Idle threads of the side before still spin for a while.
                    time.sleep(0.1)
                    side.times.append(statistics.median(side.run(args.frames)))
                    for stage, times in side.stages.items():
                        times.extend(side.last.get(stage, []))
            by_name = {side.name: side for side in sides}
            row = {"model": Path(model).name, "threads": args.threads}
            for side in sides:
                row[side.name] = {
                    "median_ms": round(statistics.median(side.times), 3),
                    "peak_mb": round(side.last["peak_mb"], 1),
                    "boxes": len(side.last["boxes"]),
                }
            pairs = [
                ("realnet-ort", "python"),
                ("realnet-ort-triangle", "python"),
                ("realnet-rten", "realnet-ort"),
            ]
            for a, b in pairs:
                ratios = sorted(x / y for x, y in zip(by_name[a].times, by_name[b].times))
                row[f"{a} / {b}"] = {
                    "median": round(statistics.median(ratios), 3),
                    "p10": round(ratios[len(ratios) // 10], 3),
                    "p90": round(ratios[-1 - len(ratios) // 10], 3),
                }
            for name in ("realnet-ort", "realnet-ort-triangle", "realnet-rten"):
                for stage, times in by_name[name].stages.items():
                    row[name][f"{stage}_ms"] = round(statistics.median(times), 3)
            classes = {side.name: sorted(b[0] for b in side.last["boxes"]) for side in sides}
            if len({str(found) for found in classes.values()}) != 1:
                sys.exit(f"the sides do not find the same: {classes}")
            figures.append(row)
            print(json.dumps(row, indent=1))
            for side in sides:
                side.close()
    if args.json:
        Path(args.json).write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
