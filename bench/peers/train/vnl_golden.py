"""Recomputes the reference depth losses from their description.

The formulas are those of crates/realnet-train/tests/data/README.md, in plain
numpy, so that a difference is a fault of the description.

    python vnl_golden.py SHARED/golden/vnl/losses.safetensors
"""

import sys

import numpy as np
from safetensors.numpy import load_file

DEPTH_MIN, DEPTH_MAX, BINS, SCALE = 0.01, 1.7, 60, 10.0
INVALID = BINS + 1


def points(depth, focal):
    """Camera coordinates [h, w, 3] of a depth map [h, w]."""
    height, width = depth.shape
    v, u = np.mgrid[0:height, 0:width]
    x = (u - width // 2) * np.abs(depth) / focal
    y = (v - height // 2) * np.abs(depth) / focal
    return np.stack([x, y, depth], -1)


def kept(triples, cosine=0.867, near=0.005, shallow=1e-4):
    """Which of the triples [n, 3 points, xyz] of the ground truth count."""
    p1, p2, p3 = triples[:, 0], triples[:, 1], triples[:, 2]
    sides = np.stack([p2 - p1, p3 - p1, p3 - p2], 1)
    length = np.linalg.norm(sides, axis=2)
    dots = np.einsum("nik,njk->nij", sides, sides)
    cosines = dots / (length[:, :, None] * length[:, None] + 1e-8)
    line = (np.abs(cosines) > cosine).sum((1, 2)) > 3
    close = (np.abs(sides) < near).any(1).all(1)
    known = (triples[:, :, 2] > shallow).all(1)
    return known & ~line & ~close, {"line": line, "close": close, "unknown": ~known}


def normals(triples):
    """Unit normals; one of length 0 is divided by 0.01 instead."""
    p1, p2, p3 = triples[:, 0], triples[:, 1], triples[:, 2]
    normal = np.cross(p2 - p1, p3 - p1)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return normal / np.where(length == 0, 0.01, length)


def virtual_normal(truth, predicted, drop):
    """Sum over x, y, z of the mean absolute difference of the normals."""
    loss = np.sort(np.abs(normals(truth) - normals(predicted)).sum(1))
    return loss[int(len(loss) * drop):].mean()


def labels(depth):
    """Bin of each depth in metres; INVALID where it is unknown (0)."""
    low, high = np.log10(DEPTH_MIN), np.log10(DEPTH_MAX)
    step = (high - low) / BINS
    clipped = np.clip(depth / SCALE, DEPTH_MIN, DEPTH_MAX)
    bins = np.clip(np.round((np.log10(clipped) - low) / step), 0, BINS - 1).astype(np.int64)
    return np.where(depth > 0, bins, INVALID)


def weighted_cross_entropy(logits, bins):
    """Logits [bins, h, w], labels [h, w]; the mean over pixels with a label."""
    top = logits.max(0)
    log_p = logits - top - np.log(np.exp(logits - top).sum(0))
    i = np.arange(BINS)
    weight = np.exp(-0.2 * (i[:, None] - i[None]) ** 2)
    weight /= weight.sum(1, keepdims=True)
    valid = bins < BINS
    return -(weight[bins[valid]] * log_p[:, valid].T).sum(1).mean()


def main():
    t = load_file(sys.argv[1])
    focal = float(t["focal"][0])
    at = [(t[f"p{i}_y"], t[f"p{i}_x"]) for i in (1, 2, 3)]
    truth = np.stack([points(t["gt"][0, 0], focal)[a] for a in at], 1)
    predicted = np.stack([points(t["pred"][0, 0], focal)[a] for a in at], 1)
    keep, reasons = kept(truth)
    print(f"{len(keep)} triplets, {keep.sum()} kept, differing from the mask: "
          f"{(keep != t['mask'][0].astype(bool)).sum()}")
    for name, reason in reasons.items():
        others = np.any([r for n, r in reasons.items() if n != name], axis=0)
        print(f"  {name}: {reason.sum()} triplets, {(reason & ~others).sum()} for this alone")
    low, high = np.log10(DEPTH_MIN), np.log10(DEPTH_MAX)
    border = low + (np.arange(BINS) + 0.5) * (high - low) / BINS
    checks = {
        "vnl": virtual_normal(truth[keep], predicted[keep], 0.25),
        "vnl_unselected": virtual_normal(truth[keep], predicted[keep], 0.0),
        "wce": weighted_cross_entropy(t["logits"][0], t["bins"][0, 0]),
    }
    worst = 0.0
    for name, value in checks.items():
        difference = abs(value - t[name][0])
        worst = max(worst, difference)
        print(f"{name}: {value:.9f}, reference {t[name][0]:.9f}, difference {difference:.1e}")
    print(f"bin_border: largest difference {np.abs(border - t['bin_border']).max():.1e}")
    print(f"bins: {(labels(t['gt'][0, 0]) != t['bins'][0, 0]).sum()} of {t['bins'].size} differ")
    print(f"smallest predicted depth {t['pred'].min():.3f}, truth {t['gt'][t['gt'] > 0].min():.3f} m; "
          f"{(t['gt'] == 0).sum()} unknown")
    sys.exit(0 if worst < 1e-6 and (keep == t["mask"][0].astype(bool)).all() else 1)


if __name__ == "__main__":
    main()
