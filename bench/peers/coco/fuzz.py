"""Random labels and detections that visit the corners of the COCO protocol."""

import random

# Category 90 never has a label, 91 neither a label nor a detection, 80 no
# detection; identifiers have gaps, as COCO's do.
CATEGORIES = [1, 2, 3, 5, 8, 13, 21, 80, 90, 91]
CROWDED = 13


def make(seed, images=240, grid=4, digits=None):
    """Labels (COCO object) and detections (COCO results).

    Coordinates are multiples of 1/grid px, which f32 holds exactly and which
    hit IoU thresholds and area limits exactly now and then. With `digits` they
    are decimals, as in COCO's files; our boxes are f32, so sizes are then not
    put on a limit on purpose, where the last bit decides.
    """
    rng = random.Random(seed)

    def snap(value):
        if digits is not None:
            return round(value, digits)
        return round(value * grid) / grid

    def size():
        kind = rng.random()
        if kind < 0.08:
            return snap(rng.uniform(0.5, 4))  # tiny
        if kind < 0.16:
            return snap(rng.uniform(250, 900))  # huge
        if kind < 0.3 and digits is None:
            return float(rng.choice([10, 20, 32, 32, 64, 96, 96]))  # on a limit
        return snap(rng.uniform(5, 200))

    def box():
        return [snap(rng.uniform(-20, 1200)), snap(rng.uniform(-20, 700)), size(), size()]

    def score():
        # Coarse values make ties; all are exact in f32.
        if rng.random() < 0.5:
            return rng.randint(0, 20) / 32
        return rng.randint(1, (1 << 20) - 1) / (1 << 20)

    least = 1.0 if digits is None else 0.25

    def jitter(b):
        spread = rng.choice([0.0, 0.02, 0.05, 0.1, 0.2, 0.4])
        x, y, w, h = b
        return [
            snap(x + rng.uniform(-spread, spread) * w),
            snap(y + rng.uniform(-spread, spread) * h),
            max(snap(w * rng.uniform(1 - spread, 1 + spread)), least),
            max(snap(h * rng.uniform(1 - spread, 1 + spread)), least),
        ]

    image_ids = rng.sample(range(1, 10 * images), images)  # not sorted
    annotations, results = [], []
    for image_id in image_ids:
        if rng.random() < 0.05:
            continue  # neither labels nor detections
        boxes = []
        if rng.random() > 0.1:
            for _ in range(rng.randint(1, 14)):
                category = rng.choice(CATEGORIES[:-2])
                b = boxes[-1][1] if boxes and rng.random() < 0.1 else box()
                area = b[2] * b[3]
                if rng.random() < 0.5:
                    area *= rng.choice([0.25, 0.5, 0.75])  # of a segment
                crowd = int(category == CROWDED and rng.random() < 0.5 or rng.random() < 0.04)
                boxes.append((category, b))
                annotations.append({
                    "id": len(annotations) + 1, "image_id": image_id, "category_id": category,
                    "bbox": b, "area": area, "iscrowd": crowd,
                })
        if rng.random() < 0.07:
            continue  # labels without detections
        detectable = [c for c in CATEGORIES[:-1] if c != 80]
        for category, b in boxes:
            for _ in range(rng.choice([0, 1, 1, 1, 2, 3])):
                c = category if rng.random() < 0.9 else rng.choice(detectable)
                if c in detectable:
                    results.append((image_id, c, jitter(b), score()))
        extra = rng.choice([0, 1, 3, 8])
        for _ in range(extra):
            results.append((image_id, rng.choice(detectable), box(), score()))
        if rng.random() < 0.03:  # more than 100 of one category
            c = rng.choice(detectable)
            near = [b for k, b in boxes if k == c] or [box()]
            for _ in range(rng.randint(101, 150)):
                results.append((image_id, c, jitter(rng.choice(near)), score()))
    rng.shuffle(results)
    labels = {
        "info": {},
        "images": [{"id": i, "width": 1280, "height": 720} for i in image_ids],
        "categories": [{"id": c, "name": f"c{c}"} for c in CATEGORIES],
        "annotations": annotations,
    }
    keys = ("image_id", "category_id", "bbox", "score")
    return labels, [dict(zip(keys, r)) for r in results]


def make_large(seed, images=5000, detections=100, categories=80):
    """A set for timing: about seven labels an image, `detections` detections."""
    rng = random.Random(seed)
    annotations, results = [], []

    def box():
        w, h = rng.uniform(8, 300), rng.uniform(8, 300)
        return [rng.uniform(0, 640), rng.uniform(0, 480), w, h]

    for image_id in range(1, images + 1):
        found = []
        for _ in range(rng.randint(1, 13)):
            b, c = box(), rng.randint(1, categories)
            annotations.append({
                "id": len(annotations) + 1, "image_id": image_id, "category_id": c,
                "bbox": b, "area": b[2] * b[3], "iscrowd": 0,
            })
            for _ in range(3):
                near = [v + rng.uniform(-0.1, 0.1) * b[2] for v in b]
                near[2:] = [max(v, 1.0) for v in near[2:]]
                found.append((image_id, c, near, rng.random()))
        while len(found) < detections:
            found.append((image_id, rng.randint(1, categories), box(), rng.random() ** 2))
        results.extend(found[:detections])
    labels = {
        "info": {},
        "images": [{"id": i, "width": 640, "height": 480} for i in range(1, images + 1)],
        "categories": [{"id": c, "name": f"c{c}"} for c in range(1, categories + 1)],
        "annotations": annotations,
    }
    keys = ("image_id", "category_id", "bbox", "score")
    return labels, [dict(zip(keys, r)) for r in results]
