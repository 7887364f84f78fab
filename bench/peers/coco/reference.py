"""What pycocotools makes of labels and detections."""

import contextlib
import copy
import io
import time

import numpy as np
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval


def evaluate(labels, results):
    """The twelve numbers, the scores of each category, and the seconds taken.

    None stands for pycocotools' -1. The seconds are those of evaluate,
    accumulate and summarize; reading and indexing are not counted.
    """
    with contextlib.redirect_stdout(io.StringIO()):
        truth = COCO()
        truth.dataset = copy.deepcopy(labels)
        truth.createIndex()
        found = truth.loadRes(copy.deepcopy(results))
        run = COCOeval(truth, found, "bbox")
        start = time.perf_counter()
        run.evaluate()
        run.accumulate()
        run.summarize()
        seconds = time.perf_counter() - start

    def mean(values):
        values = values[values > -1]
        return float(np.mean(values)) if values.size else None

    precision, recall = run.eval["precision"], run.eval["recall"]
    per_class = [
        {
            "category": int(category),
            "ap": mean(precision[:, :, k, 0, 2]),
            "ap50": mean(precision[0, :, k, 0, 2]),
            "ar": mean(recall[:, k, 0, 2]),
        }
        for k, category in enumerate(run.params.catIds)
    ]
    stats = [None if s == -1 else float(s) for s in run.stats]
    return {"stats": stats, "per_class": per_class, "seconds": seconds}
