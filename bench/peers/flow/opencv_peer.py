"""The OpenCV side of compare.py: the protocol of crates/realnet-vision/examples/flow_peer.rs."""

import argparse
import json
import sys
import time

import cv2
import numpy as np

parser = argparse.ArgumentParser()
parser.add_argument("--frames", required=True)
parser.add_argument("--width", type=int, required=True)
parser.add_argument("--height", type=int, required=True)
parser.add_argument("--corners", type=int, required=True)
args = parser.parse_args()
cv2.setNumThreads(1)
frames = list(np.fromfile(args.frames, np.uint8).reshape(-1, args.height, args.width))
criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.01)
following = 1
print("ready", flush=True)
for line in sys.stdin:
    tracks = line.strip() == "tracks"
    count = len(frames) - 1 if tracks else int(line)
    if tracks:
        following = 1
    ms, corners, flow, pairs = [], [], [], []
    for _ in range(count):
        before, after = frames[following - 1], frames[following]
        start = time.perf_counter()
        points = cv2.goodFeaturesToTrack(before, args.corners, 0.01, 10)
        found = time.perf_counter()
        moved, status, error = cv2.calcOpticalFlowPyrLK(
            before, after, points, None, winSize=(21, 21), maxLevel=3, criteria=criteria
        )
        end = time.perf_counter()
        ms.append((end - start) * 1e3)
        corners.append((found - start) * 1e3)
        flow.append((end - found) * 1e3)
        following = following % (len(frames) - 1) + 1
        if tracks:
            rows = zip(points.reshape(-1, 2), moved.reshape(-1, 2), status.ravel(), error.ravel())
            pairs.append([(p.tolist(), m.tolist(), bool(s), float(e)) for p, m, s, e in rows])
    print(json.dumps({"ms": ms, "corners": corners, "flow": flow, "pairs": pairs}), flush=True)
