"""One side of compare.py: OpenCV or PoseLib on problems from a file.

Answers each line `first count` with a line of JSON, as examples/pose_peer.rs
does. Arrays are prepared beforehand; the time of a problem is that of the calls
into the library, which for both is some microseconds of binding on top of the
library's own work.
"""

import argparse
import json
import sys
import time

import numpy as np


def opencv(args):
    import cv2

    cv2.setNumThreads(1)
    matrix = np.array([[args.fx, 0, args.cx], [0, args.fy, args.cy], [0, 0, 1]])
    # The defaults of solvePnPRansac but for the threshold. Its answer by flag
    # SOLVEPNP_ITERATIVE is already refined on the inliers (Levenberg-Marquardt);
    # that by SOLVEPNP_P3P is refined here.
    p3p = args.side == "opencv-p3p"
    flags = cv2.SOLVEPNP_P3P if p3p else cv2.SOLVEPNP_ITERATIVE

    def run(points, pixels):
        good, rotation, translation, inliers = cv2.solvePnPRansac(
            points, pixels, matrix, None, reprojectionError=args.threshold,
            iterationsCount=args.iterations, confidence=args.confidence, flags=flags,
        )
        if good and p3p:
            inliers = inliers.ravel()
            rotation, translation = cv2.solvePnPRefineLM(
                points[inliers], pixels[inliers], matrix, None, rotation, translation
            )
        return (rotation, translation) if good else None

    def pose(answer):
        return np.hstack([cv2.Rodrigues(answer[0])[0], answer[1].reshape(3, 1)])

    return run, pose


def poselib(args):
    import poselib

    camera = poselib.Camera("PINHOLE", [args.fx, args.fy, args.cx, args.cy], 640, 480)
    ransac = {"max_reproj_error": args.threshold}
    if args.side == "poselib-quick":
        # Without its default of 1000 samples at least, and with the plain formula
        # for the number of samples.
        ransac |= {"min_iterations": 0, "dyn_num_trials_mult": 1.0, "success_prob": args.confidence}

    def run(points, pixels):
        return poselib.estimate_absolute_pose(pixels, points, camera, ransac, {})[0]

    return run, lambda answer: answer.Rt


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--side", required=True)
    parser.add_argument("--problems", required=True)
    parser.add_argument("--points", type=int, required=True)
    parser.add_argument("--iterations", type=int, default=100)
    for name in ("fx", "fy", "cx", "cy", "threshold", "confidence"):
        parser.add_argument(f"--{name}", type=float, required=True)
    args = parser.parse_args()
    rows = np.fromfile(args.problems).reshape(-1, args.points, 5)
    points = [np.ascontiguousarray(row[:, :3]) for row in rows]
    pixels = [np.ascontiguousarray(row[:, 3:]) for row in rows]
    run, pose = (poselib if args.side.startswith("poselib") else opencv)(args)
    print("ready", flush=True)
    for line in sys.stdin:
        first, count = map(int, line.split())
        times, poses = [], []
        for index in range(first, min(first + count, len(points))):
            start = time.perf_counter_ns()
            answer = run(points[index], pixels[index])
            times.append((time.perf_counter_ns() - start) / 1e3)
            poses.append(None if answer is None else pose(answer).ravel().tolist())
        print(json.dumps({"us": times, "poses": poses}), flush=True)


if __name__ == "__main__":
    main()
