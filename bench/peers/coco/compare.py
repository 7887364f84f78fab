#!/usr/bin/env python3
"""Compare `realnet_eval::evaluate` with pycocotools on random data.

    pip install -r bench/peers/coco/requirements.txt
    python bench/peers/coco/compare.py 1 2 3          # numbers
    python bench/peers/coco/compare.py --large 1      # numbers and times
    python bench/peers/coco/compare.py --files labels.json results.json
    python bench/peers/coco/compare.py --golden       # rewrite the stored case

Seeds make two cases each: coordinates that f32 holds exactly, and decimals.
Exits with 1 when a number differs by more than 1e-4 or is missing on one side.
"""

import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile

import fuzz
import reference

ROOT = pathlib.Path(__file__).resolve().parents[3]
GOLDEN = ROOT / "crates/realnet-eval/tests/data/coco_golden.json"
BAR = 1e-4


def build():
    """The path of the example program, built in release mode."""
    command = ["cargo", "build", "--release", "-q", "-p", "realnet-eval", "--example", "coco_eval"]
    subprocess.run(command, cwd=ROOT, check=True)
    target = os.environ.get("CARGO_TARGET_DIR", ROOT / "target")
    return pathlib.Path(target) / "release/examples/coco_eval"


def ours(program, labels, results):
    with tempfile.TemporaryDirectory() as folder:
        paths = [pathlib.Path(folder) / name for name in ("labels.json", "results.json")]
        for path, value in zip(paths, (labels, results)):
            path.write_text(json.dumps(value))
        done = subprocess.run([program, *paths], check=True, capture_output=True)
    return json.loads(done.stdout)


def difference(a, b):
    """Greatest absolute difference; infinite when only one side has a number."""
    worst = 0.0
    for x, y in zip(a, b, strict=True):
        if (x is None) != (y is None):
            return float("inf")
        if x is not None:
            worst = max(worst, abs(x - y))
    return worst


def compare(name, program, labels, results):
    theirs = reference.evaluate(labels, results)
    mine = ours(program, labels, results)
    by_category = {c["category"]: c for c in mine["per_class"]}
    # A category without labels and detections is unknown to our side.
    absent = {"ap": None, "ap50": None, "ar": None}
    stats = difference(theirs["stats"], mine["stats"])
    classes = 0.0
    for c in theirs["per_class"]:
        other = by_category.get(c["category"], absent)
        keys = ("ap", "ap50", "ar")
        classes = max(classes, difference([c[k] for k in keys], [other[k] for k in keys]))
    print(
        f"{name}: {len(labels['images'])} images, {len(labels['annotations'])} labels, "
        f"{len(results)} detections; mAP50-95 {theirs['stats'][0]:.6f}; "
        f"max |difference| of the 12 numbers {stats:.2e}, per class {classes:.2e}; "
        f"pycocotools {theirs['seconds']:.3f} s, realnet-eval {mine['seconds']:.4f} s "
        f"({theirs['seconds'] / mine['seconds']:.0f} times)"
    )
    return max(stats, classes)


def write_golden():
    labels, results = fuzz.make(2024, images=220)
    expected = reference.evaluate(labels, results)
    del expected["seconds"]
    rows = {
        "made_by": "bench/peers/coco/compare.py --golden (fuzz.make(2024, images=220)), pycocotools 2.0.11",
        "images": len(labels["images"]),
        # image, category, x, y, width, height, area, crowd
        "labels": [
            [a["image_id"], a["category_id"], *a["bbox"], a["area"], a["iscrowd"]]
            for a in labels["annotations"]
        ],
        # image, category, x, y, width, height, score
        "results": [[r["image_id"], r["category_id"], *r["bbox"], r["score"]] for r in results],
        "expected": expected,
    }
    GOLDEN.parent.mkdir(parents=True, exist_ok=True)
    GOLDEN.write_text(json.dumps(rows, separators=(",", ":")) + "\n")
    print(f"{GOLDEN.relative_to(ROOT)}: {GOLDEN.stat().st_size} bytes")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("seeds", nargs="*", type=int)
    parser.add_argument("--large", action="store_true", help="5000 images x 100 detections")
    parser.add_argument("--files", nargs=2, metavar=("LABELS", "RESULTS"))
    parser.add_argument("--golden", action="store_true", help="rewrite the stored case and stop")
    args = parser.parse_args()
    if args.golden:
        write_golden()
        return 0
    if not args.seeds and not args.files:
        parser.error("give seeds or --files")
    program = build()
    worst = 0.0
    if args.files:
        labels, results = (json.loads(pathlib.Path(p).read_text()) for p in args.files)
        worst = compare("files", program, labels, results)
    for seed in args.seeds:
        if args.large:
            cases = [("large", fuzz.make_large(seed))]
        else:
            cases = [("exact", fuzz.make(seed)), ("decimal", fuzz.make(seed, digits=2))]
        for kind, (labels, results) in cases:
            worst = max(worst, compare(f"seed {seed} {kind}", program, labels, results))
    print(f"max |difference| {worst:.2e}, bar {BAR:.0e}: {'ok' if worst <= BAR else 'FAILED'}")
    return 0 if worst <= BAR else 1


if __name__ == "__main__":
    sys.exit(main())
