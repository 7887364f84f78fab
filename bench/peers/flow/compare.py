"""Corners and their flow on real frames: RealNet against OpenCV and kornia-imgproc.

Runs all sides interleaved, block by block, each on one thread, on the same grey
frames, and prints times, ratios and how far the tracks agree. See docs/benchmarks.md.

    pip install -r bench/peers/flow/requirements.txt
    cargo build --release -p realnet-vision --example flow_peer
    cargo build --release --manifest-path bench/peers/flow/kornia/Cargo.toml
    python bench/peers/flow/compare.py --source VIDEO_OR_PATTERN [...] --size 640x360

A source is a video, or a pattern of pictures such as 'frames/*.color.jpg'.
"""

import argparse
import glob
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[3]
HERE = Path(__file__).resolve().parent


class Side:
    def __init__(self, name, command):
        self.name, self.times, self.last = name, [], {}
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "RAYON_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        )
        line = self.process.stdout.readline().strip()
        if line != "ready":
            sys.exit(f"{name}: expected 'ready', found {line!r}")

    def ask(self, what):
        self.process.stdin.write(f"{what}\n")
        self.process.stdin.flush()
        self.last = json.loads(self.process.stdout.readline())
        return self.last

    def close(self):
        self.process.stdin.close()
        self.process.wait()


def read_frames(source, size, count):
    frames = []
    if any(c in source for c in "*?["):
        for path in sorted(glob.glob(source))[:count]:
            frames.append(cv2.imread(path, cv2.IMREAD_GRAYSCALE))
    else:
        video = cv2.VideoCapture(source)
        while len(frames) < count:
            ok, frame = video.read()
            if not ok:
                break
            frames.append(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY))
    if len(frames) < 2:
        sys.exit(f"{source}: fewer than two frames")
    return np.stack([cv2.resize(f, size, interpolation=cv2.INTER_AREA) for f in frames])


def agreement(ours, theirs):
    """Shares of their corners that are ours, and of their tracks that ours equal."""
    corners = same_corner = same_status = tracks = near = 0
    distances = []
    for our, their in zip(ours, theirs):
        by_corner = {tuple(p): (m, s) for p, m, s, _ in our}
        for point, moved, status, _ in their:
            corners += 1
            tracks += status
            match = by_corner.get(tuple(point))
            if match is None:
                continue
            same_corner += 1
            same_status += match[1] == status
            if status and match[1]:
                distance = float(np.hypot(moved[0] - match[0][0], moved[1] - match[0][1]))
                distances.append(distance)
                near += distance <= 0.1
    return {
        "corners": corners,
        "same_corner": round(same_corner / corners, 5),
        "same_status": round(same_status / max(same_corner, 1), 5),
        "tracks": tracks,
        "within_0.1px_of_all_tracks": round(near / max(tracks, 1), 5),
        "within_0.01px_of_common": round(float(np.mean(np.array(distances) <= 0.01)), 5),
        "median_px": round(float(np.median(distances)), 6),
    }


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--source", nargs="+", required=True)
    parser.add_argument("--size", default="640x360")
    parser.add_argument("--corners", type=int, default=200)
    parser.add_argument("--count", type=int, default=60, help="frames of each source")
    parser.add_argument("--blocks", type=int, default=20)
    parser.add_argument("--frames", type=int, default=20, help="per block")
    parser.add_argument("--binary", default=ROOT / "target/release/examples/flow_peer")
    parser.add_argument(
        "--kornia", default=HERE / "kornia/target/release/flow-peer-kornia", help="'' for none"
    )
    parser.add_argument("--json", help="write the figures to this file")
    args = parser.parse_args()
    size = tuple(int(v) for v in args.size.split("x"))
    figures = []
    for source in args.source:
        frames = read_frames(source, size, args.count)
        with tempfile.TemporaryDirectory() as scratch:
            raw = Path(scratch) / "frames.raw"
            frames.tofile(raw)
            common = ["--frames", str(raw), "--width", str(size[0]), "--height", str(size[1])]
            common += ["--corners", str(args.corners)]
            sides = [
                Side("realnet", [str(args.binary), *common]),
                Side("opencv", [sys.executable, str(HERE / "opencv_peer.py"), *common]),
            ]
            if args.kornia:
                sides.append(Side("kornia", [str(args.kornia), *common]))
            pairs = {side.name: side.ask("tracks")["pairs"] for side in sides}  # warms, too
            stages = {side.name: {} for side in sides}
            for _ in range(args.blocks):
                for side in sides:
                    answer = side.ask(args.frames)
                    side.times.append(statistics.median(answer["ms"]))
                    for stage in ("pyramid", "corners", "flow"):
                        if stage in answer:
                            stages[side.name].setdefault(stage, []).extend(answer[stage])
            row = {
                "source": Path(source).parent.name + "/" + Path(source).name,
                "size": args.size,
                "frames": len(frames),
                "opencv": cv2.__version__,
            }
            for side in sides:
                row[side.name] = {"median_ms": round(statistics.median(side.times), 3)}
                for stage, times in stages[side.name].items():
                    row[side.name][f"{stage}_ms"] = round(statistics.median(times), 3)
            for other in sides[1:]:
                ratios = sorted(a / b for a, b in zip(sides[0].times, other.times))
                row[f"realnet / {other.name}"] = {
                    "median": round(statistics.median(ratios), 3),
                    "p10": round(ratios[len(ratios) // 10], 3),
                    "p90": round(ratios[-1 - len(ratios) // 10], 3),
                }
            row["agreement with opencv"] = agreement(pairs["realnet"], pairs["opencv"])
            figures.append(row)
            print(json.dumps(row, indent=1))
            for side in sides:
                side.close()
    if args.json:
        Path(args.json).write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
