"""A pose from 200 points with outliers: RealNet against OpenCV and PoseLib.

Writes random problems to a file, lets all sides solve them interleaved, block by
block, one thread each, and prints the ratios of the times and the errors of the
poses. See docs/benchmarks.md.

    pip install -r bench/peers/pose/requirements.txt
    cargo build --release -p realnet-pose --example pose_peer
    python bench/peers/pose/compare.py
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[3]
SIDES = ["opencv", "opencv-p3p", "poselib", "poselib-quick"]


def rotations(random, count):
    """Evenly distributed rotations from quaternions."""
    q = random.normal(size=(count, 4))
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    return np.stack([
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ], axis=1).reshape(count, 3, 3)


def make(args):
    """Points evenly in the picture at depths of 2 to 10 m, Gaussian noise, and
    outliers anywhere in the picture."""
    random = np.random.default_rng(args.seed)
    shape = (args.problems, args.points)
    pixels = np.stack([random.uniform(0, 640, shape), random.uniform(0, 480, shape)], axis=2)
    depth = random.uniform(2, 10, shape)
    seen = np.stack([
        (pixels[..., 0] - args.cx) / args.fx * depth,
        (pixels[..., 1] - args.cy) / args.fy * depth,
        depth,
    ], axis=2)
    rotation = rotations(random, args.problems)
    translation = random.uniform(-5, 5, (args.problems, 3))
    points = np.einsum("nji,npj->npi", rotation, seen - translation[:, None])
    pixels += random.normal(0, args.noise, pixels.shape)
    for row in pixels:
        wrong = random.permutation(args.points)[: round(args.outliers * args.points)]
        row[wrong] = random.uniform((0, 0), (640, 480), (len(wrong), 2))
    return points, pixels, rotation, translation


class Side:
    def __init__(self, name, command):
        self.name, self.us, self.poses = name, [], []
        environment = dict(os.environ, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )
        line = self.process.stdout.readline().strip()
        if line != "ready":
            sys.exit(f"{name}: expected 'ready', found {line!r}")

    def run(self, first, count):
        self.process.stdin.write(f"{first} {count}\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    def close(self):
        self.process.stdin.close()
        self.process.wait()


def errors(poses, rotation, translation):
    """Rotation in degrees and place of the camera in metres; NaN for refusals."""
    found = np.array([[np.nan] * 12 if pose is None else pose for pose in poses]).reshape(-1, 3, 4)
    r, t = found[:, :, :3], found[:, :, 3]
    chord = np.linalg.norm(r - rotation, axis=(1, 2)) / np.sqrt(8)
    place = np.einsum("nji,nj->ni", r, t) - np.einsum("nji,nj->ni", rotation, translation)
    return np.degrees(2 * np.arcsin(np.clip(chord, 0, 1))), np.linalg.norm(place, axis=1)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--problems", type=int, default=10_000)
    parser.add_argument("--points", type=int, default=200)
    parser.add_argument("--outliers", type=float, default=0.3)
    parser.add_argument("--noise", type=float, default=1.0, help="pixels, standard deviation")
    parser.add_argument("--threshold", type=float, default=4.0, help="pixels, of all sides")
    parser.add_argument("--confidence", type=float, default=0.9999, help="RealNet, poselib-quick")
    parser.add_argument("--opencv-confidence", type=float, default=0.99, help="its default")
    parser.add_argument("--block", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sides", nargs="*", default=SIDES, choices=SIDES)
    parser.add_argument("--binary", default=ROOT / "target/release/examples/pose_peer")
    parser.add_argument("--json", help="write the figures to this file")
    args = parser.parse_args()
    args.fx, args.fy, args.cx, args.cy = 500.0, 500.0, 320.0, 240.0

    points, pixels, rotation, translation = make(args)
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "problems.f64"
        np.concatenate([points, pixels], axis=2).astype(np.float64).tofile(file)

        def common(confidence):
            names = ("points", "fx", "fy", "cx", "cy", "threshold")
            pairs = [(f"--{name}", str(getattr(args, name))) for name in names]
            pairs += [("--problems", str(file)), ("--confidence", str(confidence))]
            return [word for pair in pairs for word in pair]

        peer = [sys.executable, str(Path(__file__).parent / "python_peer.py")]
        sides = [Side("realnet", [str(args.binary), *common(args.confidence)])]
        for name in args.sides:
            confidence = args.opencv_confidence if "opencv" in name else args.confidence
            sides.append(Side(name, [*peer, "--side", name, *common(confidence)]))
        for side in sides:
            side.run(0, args.block)  # warm
        for first in range(0, args.problems, args.block):
            for side in sides:
                answer = side.run(first, args.block)
                side.us += answer["us"]
                side.poses += answer["poses"]
        for side in sides:
            side.close()

    figures = {"problems": args.problems, "points": args.points, "outliers": args.outliers,
               "noise_px": args.noise, "threshold_px": args.threshold}
    ours = np.array(sides[0].us)
    for side in sides:
        us = np.array(side.us)
        degrees, metres = errors(side.poses, rotation, translation)
        wrong = ~(metres < 0.5)
        row = {
            "median_us": np.median(us), "mean_us": us.mean(), "p99_us": np.quantile(us, 0.99),
            "median_deg": np.nanmedian(degrees), "median_mm": 1e3 * np.nanmedian(metres),
            "rms_mm": 1e3 * np.sqrt(np.nanmean(np.square(metres[~wrong]))),
            "p99_mm": 1e3 * np.nanquantile(metres, 0.99),
            "refused": int(np.isnan(metres).sum()),
            "beyond_half_a_metre": int((metres >= 0.5).sum()),
        }
        if side is not sides[0]:
            blocks = (ours / us)[: len(us) // args.block * args.block].reshape(-1, args.block)
            ratios = np.median(blocks, axis=1)
            row["realnet_over_it"] = np.median(ours) / np.median(us)
            row["p10"], row["p90"] = np.quantile(ratios, [0.1, 0.9])
        figures[side.name] = {key: round(float(value), 4) for key, value in row.items()}
    print(json.dumps(figures, indent=1))
    if args.json:
        Path(args.json).write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
