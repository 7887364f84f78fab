"""OpenVINO's side of compare.py: an ONNX graph on one input, timed by the block.

For each line with a number on standard input it runs the network that many times
and answers with one JSON object: milliseconds of each.
"""

import argparse
import json
import sys
import time

import numpy as np
import openvino as ov


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--graph", required=True, help="ONNX file")
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    config = {
        "INFERENCE_NUM_THREADS": args.threads,
        "PERFORMANCE_HINT": "LATENCY",
        # Its default on processors with bfloat16 or float16 would be less exact.
        "INFERENCE_PRECISION_HINT": "f32",
    }
    request = ov.Core().compile_model(args.graph, "CPU", config).create_infer_request()
    shape = request.get_input_tensor().shape
    values = np.sin(np.arange(np.prod(shape), dtype=np.float32) * np.float32(0.37)) * 2
    request.get_input_tensor().data[:] = values.reshape(shape)
    print("ready", flush=True)
    for line in sys.stdin:
        ms = []
        for _ in range(int(line)):
            start = time.perf_counter()
            request.infer()
            ms.append((time.perf_counter() - start) * 1e3)
        print(json.dumps({"ms": ms}), flush=True)


if __name__ == "__main__":
    main()
