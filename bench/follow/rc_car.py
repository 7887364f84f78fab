"""How well `realnet follow --json` finds and ranges the car of an rc-car sequence.

    realnet follow --source seq4/images --fps 1 --target rc_car --fov 65 --json > seq4.jsonl
    python rc_car.py seq4/labels seq4.jsonl

Nobody knows the true ranges, but the car keeps its height: from one frame to the next the
range must change as the inverse height of the labelled box does, but where the picture's
edge cuts it or the car turns.
"""

import json
import statistics
import sys
from pathlib import Path

WIDTH, HEIGHT = 1280, 720


def labelled(path):
    """Left, top, right, bottom of the first box, pixels."""
    _, x, y, w, h = (float(word) for word in path.read_text().split()[:5])
    return ((x - w / 2) * WIDTH, (y - h / 2) * HEIGHT, (x + w / 2) * WIDTH, (y + h / 2) * HEIGHT)


def iou(a, b):
    across = min(a[2], b[2]) - max(a[0], b[0])
    down = min(a[3], b[3]) - max(a[1], b[1])
    both = max(across, 0) * max(down, 0)
    area = lambda box: (box[2] - box[0]) * (box[3] - box[1])
    return both / (area(a) + area(b) - both)


def is_whole(box):
    return box[0] > 2 and box[1] > 2 and box[2] < WIDTH - 2 and box[3] < HEIGHT - 2


def main():
    labels, lines = Path(sys.argv[1]), Path(sys.argv[2]).read_text().splitlines()
    frames = [json.loads(line) for line in lines]
    truth = {int(path.stem): labelled(path) for path in labels.glob("*.txt")}
    found = [f for f in frames if f["box"] and iou(truth[f["frame"]], f["box"]) >= 0.7]
    print(f"found with an IoU of 0.7 or more: {len(found)} of {len(frames)}")

    def errors(range_of):
        for before, now in zip(frames, frames[1:]):
            a, b = truth[before["frame"]], truth[now["frame"]]
            if is_whole(a) and is_whole(b) and range_of(before) and range_of(now):
                expected = (a[3] - a[1]) / (b[3] - b[1])
                yield abs(range_of(now) / range_of(before) / expected - 1)

    for name, range_of in [
        ("fused", lambda f: f["range_m"]),
        ("network", lambda f: f["cues"]["network"]),
    ]:
        all_errors = list(errors(range_of))
        median = statistics.median(all_errors)
        print(f"{name}: relative change off by {100 * median:.1f} % (median of {len(all_errors)})")


if __name__ == "__main__":
    main()
