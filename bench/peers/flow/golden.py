"""Writes the OpenCV results that the tests of realnet-vision compare with.

    pip install -r bench/peers/flow/requirements.txt
    python bench/peers/flow/golden.py > crates/realnet-vision/tests/golden/flow.json

The picture is integer arithmetic alone, so that the tests can draw the same.
"""

import json
import sys

import cv2
import numpy as np


def picture(width, height, shift_x=0, shift_y=0, seed=1):
    """Hashed grey values on grids of 32, 16, 8 and 4 pixels, bilinear between them;
    positions in 1/16 pixel."""
    y, x = np.mgrid[0:height, 0:width].astype(np.int64)
    x, y = x * 16 - shift_x + (1 << 16), y * 16 - shift_y + (1 << 16)
    total = np.zeros((height, width), np.int64)
    for octave, (cell, weight) in enumerate([(512, 5), (256, 5), (128, 4), (64, 2)]):
        cx, cy, fx, fy = x // cell, y // cell, x % cell, y % cell

        def value(i, j):
            h = (i * 374761393 + j * 668265263 + (octave * 31 + seed) * 2246822519) & 0xFFFFFFFF
            h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
            return (h ^ (h >> 16)) & 255

        top = value(cx, cy) * (cell - fx) + value(cx + 1, cy) * fx
        bottom = value(cx, cy + 1) * (cell - fx) + value(cx + 1, cy + 1) * fx
        total += weight * ((top * (cell - fy) + bottom * fy) // (cell * cell))
    return (total // 16).astype(np.uint8)


def fingerprint(array):
    value = 0xCBF29CE484222325
    for byte in array.tobytes():
        value = ((value ^ byte) * 0x100000001B3) & 0xFFFFFFFFFFFFFFFF
    return f"{value:016x}"


def main():
    cv2.setNumThreads(1)
    cases = []
    for width, height, sx, sy, window, levels in [
        (213, 161, 37, -21, (21, 21), 3),
        (320, 240, -85, 44, (15, 31), 2),
        (160, 120, 9, 6, (9, 9), 0),
        (200, 150, 55, 30, (40, 36), 1),
    ]:
        first = picture(width, height)
        second = picture(width, height, sx, sy)
        pyramid = [first]
        while len(pyramid) <= levels:
            pyramid.append(cv2.pyrDown(pyramid[-1]))
        response = cv2.cornerMinEigenVal(first, 3, ksize=3)
        points = cv2.goodFeaturesToTrack(first, 60, 0.02, 8)
        mask = np.zeros_like(first)
        mask[20:90, 30:110] = 255
        masked = cv2.goodFeaturesToTrack(first, 20, 0.02, 8, mask=mask)
        # Points on and beyond the border as well.
        extra = [[0, 0], [width - 1, height - 1], [-5.5, 40.25], [-60, 20], [width + 3, 50]]
        queries = np.concatenate([points.reshape(-1, 2) + 0.3, np.array(extra)])
        queries = queries.astype(np.float32).reshape(-1, 1, 2)
        moved, status, error = cv2.calcOpticalFlowPyrLK(
            first,
            second,
            queries,
            None,
            winSize=window,
            maxLevel=levels,
            criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.01),
        )
        cases.append(
            {
                "size": [width, height],
                "shift_16ths": [sx, sy],
                "window": list(window),
                "max_level": levels,
                "pyramid_fnv1a": [fingerprint(level) for level in pyramid],
                "corners": points.reshape(-1, 2).astype(int).tolist(),
                "responses": [
                    float(f"{response[int(y), int(x)]:.7g}") for x, y in points.reshape(-1, 2)
                ],
                "masked_corners": masked.reshape(-1, 2).astype(int).tolist(),
                "queries": [[round(float(v), 4) for v in q] for q in queries.reshape(-1, 2)],
                "moved": [[round(float(v), 4) for v in m] for m in moved.reshape(-1, 2)],
                "status": status.ravel().tolist(),
                "error": [round(float(e), 4) for e in error.ravel()],
            }
        )
    rows = ",\n".join(json.dumps(case) for case in cases)
    sys.stdout.write(f'{{"opencv": "{cv2.__version__}", "cases": [\n{rows}\n]}}\n')


if __name__ == "__main__":
    main()
