"""The Python program to compare with: OpenCV, NumPy and onnxruntime, tuned.

What a careful engineer would write: preallocated canvas, OpenCV's own vector
code for resizing and for the change to planar floats, the mask on objectness
before anything is done per class, OpenCV's class-wise NMS. Same ONNX, same
number of threads, same thresholds as ours.

Speaks the protocol of compare.py on standard input and output: a line with a
number of frames in, a JSON object with times and boxes out.
"""

import argparse
import json
import resource
import sys
import time

import cv2
import numpy as np
import onnxruntime as ort


class Detector:
    def __init__(self, path, threads):
        # One thread for OpenCV: its pool would fight with the network's for the cores.
        cv2.setNumThreads(1)
        options = ort.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        options.add_session_config_entry("session.set_denormal_as_zero", "1")
        options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_ALL
        self.session = ort.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        self.input = self.session.get_inputs()[0].name
        self.output = [self.session.get_outputs()[0].name]
        _, _, self.height, self.width = self.session.get_inputs()[0].shape
        self.canvas = np.full((self.height, self.width, 3), 114, np.uint8)
        self.conf, self.iou = 0.25, 0.45

    def __call__(self, frame):
        h, w = frame.shape[:2]
        ratio = min(self.width / w, self.height / h)
        nw, nh = round(w * ratio), round(h * ratio)
        left, top = (self.width - nw) // 2, (self.height - nh) // 2
        cv2.resize(
            frame, (nw, nh), dst=self.canvas[top : top + nh, left : left + nw],
            interpolation=cv2.INTER_LINEAR,
        )
        # The frame is RGB already, as ours is.
        blob = cv2.dnn.blobFromImage(self.canvas, 1 / 255.0)
        out = self.session.run(self.output, {self.input: blob})[0][0]
        out = out[out[:, 4] > self.conf]
        scores = out[:, 5:] * out[:, 4:5]
        classes = scores.argmax(1)
        best = scores[np.arange(len(scores)), classes]
        keep = best > self.conf
        out, classes, best = out[keep], classes[keep], best[keep]
        if len(out) == 0:
            return []
        boxes = out[:, :4].copy()
        boxes[:, :2] -= boxes[:, 2:] / 2
        kept = cv2.dnn.NMSBoxesBatched(boxes, best, classes, self.conf, self.iou)
        boxes = boxes[kept]
        boxes[:, 2:] += boxes[:, :2]
        boxes -= [left, top, left, top]
        boxes *= [w / nw, h / nh, w / nw, h / nh]
        np.clip(boxes, 0, [w, h, w, h], out=boxes)
        return list(zip(classes[kept].tolist(), best[kept].tolist(), boxes.tolist()))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--model", required=True)
    parser.add_argument("--frame", required=True, help="raw RGB bytes, 1280x720")
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    frame = np.fromfile(args.frame, np.uint8).reshape(720, 1280, 3)
    detector = Detector(args.model, args.threads)
    print("ready", flush=True)
    for line in sys.stdin:
        times, boxes = [], []
        for _ in range(int(line)):
            start = time.perf_counter()
            boxes = detector(frame)
            times.append((time.perf_counter() - start) * 1e3)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(json.dumps({"ms": times, "peak_mb": peak, "boxes": boxes}), flush=True)


if __name__ == "__main__":
    main()
