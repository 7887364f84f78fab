"""Reference values of YOLOv5's training: losses, targets, anchors, optimiser.

Runs PyPI's yolov5 package and PyTorch on fixed inputs and writes small
safetensors files. What each tensor means is written in the README.md of the
folder that they are kept in, crates/realnet-train/tests/data.

    python reference.py OUT_DIR
"""

import copy
import json
import logging
import math
import random
import re
import sys
from pathlib import Path

import numpy as np
import torch
import yolov5.utils.loss as yolo_loss
from safetensors.numpy import save_file
from yolov5.models.common import Conv
from yolov5.models.yolo import Model
from yolov5.utils import autoanchor
from yolov5.utils.general import one_cycle
from yolov5.utils.metrics import bbox_iou
from yolov5.utils.torch_utils import ModelEMA, smart_optimizer

CONFIG = Path(yolo_loss.__file__).parents[1] / "models" / "yolov5n.yaml"
IMAGE_SIZE = 320
BATCH = 2
STRIDES = (8, 16, 32)
RAW_SCALE = 16  # raw predictions are whole numbers divided by this
VARIANTS = {"iou": {}, "giou": {"GIoU": True}, "diou": {"DIoU": True}, "ciou": {"CIoU": True}}
HYP_ORDER = (
    "box", "obj", "cls", "cls_pw", "obj_pw", "anchor_t", "label_smoothing", "fl_gamma", "gr",
)


def numpy(tensor):
    return np.ascontiguousarray(tensor.detach().cpu().numpy())


def save(path, tensors, **about):
    tensors = {k: np.ascontiguousarray(v) for k, v in tensors.items()}
    about = {"torch": torch.__version__, "yolov5": "7.0.14", **about}
    # One entry, since several come out in no fixed order.
    save_file(tensors, path, metadata={"about": json.dumps(about, sort_keys=True)})
    path.chmod(0o644)
    print(f"{path.name}: {len(tensors)} tensors, {path.stat().st_size} bytes")


def detection_targets():
    """Rows [image, class, cx, cy, w, h], the last four in parts of the image."""
    px = 1.0 / IMAGE_SIZE
    rows = [
        (0, 0, 0.3127, 0.6241, 46 * px, 61 * px),  # ordinary
        (0, 1, 0.7713, 0.2218, 3 * px, 3 * px),  # tiny
        (0, 2, 0.5, 0.5, 300 * px, 290 * px),  # huge, centre on a corner of cells
        (0, 0, 0.0041, 0.0033, 12 * px, 15 * px),  # centre in the first half cell
        (0, 1, 1.0, 0.3719, 24 * px, 30 * px),  # centre on the right edge
        (0, 2, 0.6113, 0.7027, 31 * px, 28 * px),  # two boxes in one cell ...
        (0, 0, 0.6121, 0.7031, 27 * px, 33 * px),  # ... of different classes
        (0, 1, 0.2207, 0.1913, 0.125, 0.1625),  # 40x52: four times the first anchor
        (0, 2, 0.4519, 0.8867, 200 * px, 4 * px),  # long: too long for most anchors
        (1, 0, 0.3125, 0.6875, 20 * px, 22 * px),  # centre in the middle of a cell
        (1, 1, 0.9931, 0.9957, 60 * px, 45 * px),  # lower right corner
        (1, 2, 0.5377, 0.4151, 130 * px, 95 * px),  # large
        (1, 2, 0.5377, 0.4151, 130 * px, 95 * px),  # the same again
        (1, 0, 0.8123, 0.1377, 0.0, 20 * px),  # without width: matches nothing
    ]
    return np.array(rows, dtype=np.float32)


def raw_maps(generator, classes):
    maps = []
    for stride in STRIDES:
        side = IMAGE_SIZE // stride
        values = generator.normal(0.0, 1.5, (BATCH, 3, side, side, 5 + classes))
        values[..., 4] -= 2.0  # an objectness that is low in most cells
        whole = np.clip(np.round(values * RAW_SCALE), -127, 127)
        maps.append(whole.astype(np.int8))
    return maps


def detector(classes, **changes):
    """A YOLOv5n with the hyper-parameters scaled as its trainer scales them."""
    model = Model(str(CONFIG), ch=3, nc=classes)
    layers = model.model[-1].nl
    hyp = {
        "box": 0.05 * 3 / layers,
        "obj": 1.0 * (IMAGE_SIZE / 640) ** 2 * 3 / layers,
        "cls": 0.5 * classes / 80 * 3 / layers,
        "cls_pw": 1.0,
        "obj_pw": 1.0,
        "anchor_t": 4.0,
        "label_smoothing": 0.0,
        "fl_gamma": 0.0,
    }
    hyp.update(changes)
    model.hyp = hyp
    return model


class Recorded:
    """A criterion that keeps the targets it was given."""

    def __init__(self, criterion):
        self.criterion, self.targets = criterion, []

    def __call__(self, predicted, target):
        self.targets.append(target.detach().clone())
        return self.criterion(predicted, target)


def run_loss(model, raw, targets, dtype, variant="ciou", gr=1.0, sort=False):
    """Items [box, obj, cls, total], gradients and objectness targets."""
    torch.set_default_dtype(dtype)
    plain = yolo_loss.bbox_iou

    def chosen(box1, box2, CIoU=True):  # the loss asks for CIoU by name
        return plain(box1, box2, **VARIANTS[variant])

    yolo_loss.bbox_iou = chosen
    try:
        loss = yolo_loss.ComputeLoss(model.to(dtype))
        loss.gr, loss.sort_obj_iou = gr, sort
        loss.BCEobj = Recorded(loss.BCEobj)
        maps = [torch.tensor(m, dtype=dtype) / RAW_SCALE for m in raw]
        for m in maps:
            m.requires_grad_(True)
        total, parts = loss(maps, torch.tensor(targets, dtype=dtype))
        total.sum().backward()
    finally:
        yolo_loss.bbox_iou = plain
        torch.set_default_dtype(torch.float32)
    items = np.append(numpy(parts), numpy(total))
    gradients = [numpy(m.grad) for m in maps]
    objectness = [numpy(t) for t in loss.BCEobj.targets]
    return items.astype(np.float64), gradients, objectness


def matched(model, raw, targets):
    """Per scale: rows [image, anchor, gj, gi, class, order], boxes and anchors."""
    torch.set_default_dtype(torch.float64)
    loss = yolo_loss.ComputeLoss(model.double())
    maps = [torch.tensor(m, dtype=torch.float64) for m in raw]
    found = loss.build_targets(maps, torch.tensor(targets, dtype=torch.float64))
    torch.set_default_dtype(torch.float32)
    scales = []
    for classes, boxes, (b, a, gj, gi), anchors in zip(*found):
        rows = np.stack([numpy(v) for v in (b, a, gj, gi, classes)], 1).astype(np.int64)
        rows = np.concatenate([rows, np.arange(len(rows))[:, None]], 1)
        boxes = numpy(boxes).astype(np.float64)
        keys = [rows[:, 5]] + [boxes[:, k] for k in (3, 2, 1, 0)]
        keys += [rows[:, k] for k in (4, 3, 2, 1, 0)]
        order = np.lexsort(keys)  # the last key counts first
        scales.append((rows[order], boxes[order], numpy(anchors).astype(np.float64)[order]))
    return scales


def last_match_wins(raw, tensors, i, objectness):
    """Checks what the notes say of several matches in one cell."""
    rows = tensors[f"match_{i}"]
    order = np.argsort(rows[:, 5])
    rows = rows[order]
    logits = torch.tensor(raw[tuple(rows[:, :4].T)], dtype=torch.float64) / RAW_SCALE
    xy = logits[:, :2].sigmoid() * 2 - 0.5
    wh = (logits[:, 2:4].sigmoid() * 2) ** 2 * torch.tensor(tensors[f"match_anchor_{i}"][order])
    boxes = torch.tensor(tensors[f"match_box_{i}"][order])
    ious = numpy(bbox_iou(torch.cat((xy, wh), 1), boxes, CIoU=True)).squeeze(-1).clip(0)
    last = {tuple(cell): iou for cell, iou in zip(rows[:, :4].tolist(), ious)}
    for cell, iou in last.items():
        assert abs(objectness[cell] - iou) < 1e-12, (i, cell)
    contested = sum(len(set(ious[(rows[:, :4] == c).all(1)])) > 1 for c in last)
    print(f"scale {i}: {contested} cells with matches of different IoU; the last one counts")


def detection_loss(out):
    generator = np.random.default_rng(20240501)
    raw, targets = raw_maps(generator, 3), detection_targets()
    tensors = {"targets": targets, "strides": np.array(STRIDES, dtype=np.int64)}
    model = detector(3)
    layer = model.model[-1]
    assert tuple(int(s) for s in layer.stride) == STRIDES
    tensors["anchors"] = numpy(layer.anchors * layer.stride.view(-1, 1, 1)).astype(np.float64)
    tensors["balance"] = np.array(yolo_loss.ComputeLoss(model).balance, dtype=np.float64)

    cells = []
    for i, (rows, boxes, anchors) in enumerate(matched(model, raw, targets)):
        tensors[f"raw_{i}"] = raw[i]
        tensors[f"match_{i}"] = rows
        tensors[f"match_box_{i}"] = boxes
        tensors[f"match_anchor_{i}"] = anchors
        cells.append(np.unique(rows[:, :4], axis=0))
        tensors[f"cells_{i}"] = cells[-1]
        print(f"scale {i}: {len(rows)} matches in {len(cells[-1])} cells")

    one_class = targets.copy()
    one_class[:, 1] = 0
    weighted = {"label_smoothing": 0.1, "cls_pw": 1.5, "obj_pw": 0.8}
    cases = {
        "ciou": ({}, {}),
        "giou": ({}, {"variant": "giou"}),
        "diou": ({}, {"variant": "diou"}),
        "iou": ({}, {"variant": "iou"}),
        "weighted": (weighted, {"gr": 0.5}),
        "focal": ({"fl_gamma": 1.5}, {}),
        "sorted": ({}, {"sort": True}),
        "one_class": ({}, {}),
        "empty": ({}, {}),
    }
    backgrounds = {}
    for name, (changes, options) in cases.items():
        classes = 1 if name == "one_class" else 3
        rows = {"one_class": one_class, "empty": targets[:0]}.get(name, targets)
        maps = [m[..., : 5 + classes] for m in raw]
        case = detector(classes, **changes)
        items, gradients, objectness = run_loss(case, maps, rows, torch.float64, **options)
        tensors[f"{name}.items"] = items
        single, _, _ = run_loss(case, maps, rows, torch.float32, **options)
        assert np.allclose(single, items, rtol=2e-6, atol=1e-9), (name, single, items)
        settings = {**case.hyp, "gr": options.get("gr", 1.0)}
        tensors[f"{name}.hyp"] = np.array([settings[k] for k in HYP_ORDER], dtype=np.float64)
        print(f"{name}: box {items[0]:.6f} obj {items[1]:.6f} cls {items[2]:.6f} total {items[3]:.6f}")
        backgrounds[name] = [g[..., 4] for g in gradients]
        for i, gradient in enumerate(gradients):
            at = tuple(cells[i].T)
            outside = np.ones(gradient.shape[:4], dtype=bool)
            outside[at] = False
            precision = np.float64 if name == "ciou" else np.float32
            tensors[f"{name}.grad_{i}"] = gradient[at].astype(precision)
            tensors[f"{name}.tobj_{i}"] = objectness[i][at]
            rest = np.delete(gradient, 4, axis=-1)
            assert not rest[outside].any(), "only objectness has a gradient elsewhere"
            assert not objectness[i][outside].any()
            if name == "ciou":
                last_match_wins(raw[i], tensors, i, objectness[i])
            if name in ("ciou", "focal"):
                tensors[f"{name}.grad_obj_{i}"] = gradient[..., 4].astype(np.float32)
            else:
                same = backgrounds["ciou"][i][outside]
                assert np.allclose(gradient[..., 4][outside], same, rtol=1e-12, atol=0), name

    # The balance that follows the losses: two calls on the same maps.
    torch.set_default_dtype(torch.float64)
    loss = yolo_loss.ComputeLoss(detector(3).double(), autobalance=True)
    for call in (1, 2):
        maps = [torch.tensor(m, dtype=torch.float64) / RAW_SCALE for m in raw]
        total, parts = loss(maps, torch.tensor(targets, dtype=torch.float64))
        tensors[f"autobalance.items_{call}"] = np.append(numpy(parts), numpy(total))
        tensors[f"autobalance.balance_{call}"] = np.array(loss.balance, dtype=np.float64)
    torch.set_default_dtype(torch.float32)
    save(out / "detect_loss.safetensors", tensors, hyp_order=",".join(HYP_ORDER), raw_scale=RAW_SCALE)


def iou_pairs(out):
    generator = np.random.default_rng(20240502)
    first = np.empty((64, 4), dtype=np.float32)
    first[:, :2] = generator.uniform(2, 38, (64, 2))
    first[:, 2:] = np.exp(generator.uniform(math.log(0.3), math.log(25), (64, 2)))
    second = first.copy()
    second[:, :2] += generator.normal(0, 0.35, (64, 2)) * first[:, 2:]
    second[:, 2:] *= np.exp(generator.normal(0, 0.5, (64, 2)))
    second[40:48, :2] += 30  # apart
    second[48:52, 2:] = first[48:52, 2:] * 0.2  # inside
    second[48:52, :2] = first[48:52, :2]
    first[52:56, 2:] = ((80, 1), (1, 80), (0.02, 0.02), (60, 60))  # long, tiny, large
    first[60] = second[60] = (10, 12, 4, 6)  # the same box
    first[61], second[61] = (10, 10, 4, 4), (14, 10, 4, 4)  # a common edge
    first[62], second[62] = (10, 10, 4, 4), (11, 10, 2, 4)  # three edges in line
    first[63], second[63] = (10, 10, 4, 4), (10, 10, 2, 2)  # a common centre
    tensors = {"box1": first, "box2": second, "smooth": np.array([1] * 60 + [0] * 4, dtype=np.uint8)}
    for name, flags in VARIANTS.items():
        a = torch.tensor(first, dtype=torch.float64, requires_grad=True)
        value = bbox_iou(a, torch.tensor(second, dtype=torch.float64), **flags).squeeze(-1)
        value.sum().backward()
        tensors[name], tensors[f"{name}.grad"] = numpy(value), numpy(a.grad)
    save(out / "iou.safetensors", tensors)


class Messages(logging.Handler):
    def __init__(self):
        super().__init__()
        self.text = []

    def emit(self, record):
        self.text.append(record.getMessage())


def anchor_fit(wh, anchors, threshold):
    """Best possible recall, anchors above the threshold, fitness."""
    ratio = wh[:, None] / anchors[None]
    worst = np.minimum(ratio, 1 / ratio).min(2)
    best = worst.max(1)
    good = best > 1 / threshold
    return np.array([good.mean(), (worst > 1 / threshold).sum(1).mean(), (best * good).mean()])


class Labels:
    """What the anchor search reads of a data set."""

    def __init__(self, shapes, labels):
        self.shapes, self.labels = shapes, labels


def anchors(out):
    generator = np.random.default_rng(20240503)
    sizes = np.array([[640, 480], [480, 640], [512, 512], [1280, 720]], dtype=np.float64)
    shapes = sizes[np.arange(20) % 4]
    rows = []
    for n in range(200):
        group = n % 4
        if group < 2:  # small and wide, as distant vehicles are
            w = math.exp(generator.normal(math.log(9), 0.5))
            h = w * math.exp(generator.normal(-0.5, 0.25))
        elif group == 2:
            w, h = np.exp(generator.normal(math.log(45), 0.6, 2))
        else:  # long and low
            w = math.exp(generator.normal(math.log(150), 0.3))
            h = w * math.exp(generator.normal(-1.7, 0.2))
        image = n // 10
        scale = IMAGE_SIZE / shapes[image].max()
        w, h = min(w, 300.0), min(h, 150.0)
        w, h = w / (shapes[image][0] * scale), h / (shapes[image][1] * scale)
        rows.append((image, group % 3, 0.5, 0.5, w, h))
    rows = np.array(rows)
    rows[7, 4:] = 1.2 / IMAGE_SIZE  # below two pixels: left out of the search
    labels = [rows[rows[:, 0] == i][:, 1:] for i in range(20)]
    data = Labels(shapes, labels)
    pixels = IMAGE_SIZE * shapes / shapes.max(1, keepdims=True)
    wh = np.concatenate([l[:, 3:] * s for s, l in zip(pixels, labels)])

    model = detector(3)
    layer = model.model[-1]
    default = numpy(layer.anchors * layer.stride.view(-1, 1, 1)).reshape(-1, 2).astype(np.float64)
    log = Messages()
    autoanchor.LOGGER.addHandler(log)

    def unscaled(low, high, size):  # the check's random scale, held at 1
        return np.ones(size)

    random_scale, np.random.uniform = np.random.uniform, unscaled
    np.random.seed(0)
    random.seed(0)
    try:
        autoanchor.check_anchors(data, model, thr=4.0, imgsz=IMAGE_SIZE)
    finally:
        np.random.uniform = random_scale
    before = anchor_fit(wh, default, 4.0)
    text = f"{before[1]:.2f} anchors/target, {before[0]:.3f} Best Possible Recall"
    assert any(text in line for line in log.text), (text, log.text)
    after_check = numpy(layer.anchors * layer.stride.view(-1, 1, 1)).astype(np.float64)

    np.random.seed(0)
    random.seed(0)
    log.text.clear()
    found = autoanchor.kmean_anchors(data, n=9, img_size=IMAGE_SIZE, thr=4.0, gen=1000, verbose=False)
    found = found.astype(np.float64)
    after = anchor_fit(wh, found, 4.0)
    printed = [l for l in log.text if "best possible recall" in l][-1].split("thr=")[1]
    recall, above = (float(n) for n in re.findall(r"[0-9]+[.][0-9]+", printed)[1:3])
    assert abs(recall - after[0]) < 1e-4 and abs(above - after[1]) < 0.01, (printed, after)
    kept = wh[(wh >= 2.0).any(1)]
    spread = []
    for seed in range(10):
        np.random.seed(seed)
        random.seed(seed)
        k = autoanchor.kmean_anchors(data, n=9, img_size=IMAGE_SIZE, thr=4.0, gen=1000, verbose=False)
        spread.append(anchor_fit(kept, k.astype(np.float64), 4.0)[2])
    tensors = {
        "shapes": shapes,
        "labels": rows,
        "wh": wh,
        "default": default,
        "default.fit": before,
        "default.fit_kept": anchor_fit(kept, default, 4.0),
        "kmeans": found,
        "kmeans.fit": after,
        "kmeans.fit_kept": anchor_fit(kept, found, 4.0),
        "kmeans.fitness_10_seeds": np.array(spread),
        "checked": after_check,
    }
    for key in ("default.fit", "kmeans.fit", "kmeans.fit_kept", "kmeans.fitness_10_seeds"):
        print(key, np.round(tensors[key], 4))
    save(out / "anchors.safetensors", tensors)


def toy(dtype):
    """Convolution, batch norm, SiLU; then a 1x1 convolution with a bias."""
    torch.manual_seed(11)
    net = torch.nn.Sequential(Conv(3, 4, 3, 1), torch.nn.Conv2d(4, 2, 1))
    norm = net[0].bn
    norm.eps, norm.momentum = 1e-3, 0.03
    torch.nn.init.uniform_(norm.weight, 0.5, 1.5)
    torch.nn.init.uniform_(norm.bias, -0.5, 0.5)
    return net.to(dtype)


def state(net):
    return {k: v for k, v in net.state_dict().items() if v.dtype.is_floating_point}


def optimiser(out):
    dtype = torch.float64
    generator = np.random.default_rng(20240504)
    inputs = generator.normal(0, 1, (3, 4, 3, 8, 8)).astype(np.float32)
    wanted = generator.normal(0, 1, (3, 4, 2, 8, 8)).astype(np.float32)
    first = toy(dtype)
    for p in first.parameters():  # values that single precision holds
        p.data = p.data.float().to(dtype)
    tensors = {"x": inputs, "y": wanted}
    tensors.update({f"initial.{k}": numpy(v) for k, v in state(first).items()})
    runs = {
        "sgd": ("SGD", 0.1, math.inf, 0),
        "sgd_clip": ("SGD", 0.1, 0.5, 1000),
        "adamw": ("AdamW", 0.01, math.inf, 0),
    }
    for name, (kind, rate, clip, updates) in runs.items():
        net = copy.deepcopy(first).train()
        optimizer = smart_optimizer(net, kind, rate, 0.937, 0.05)
        ema = ModelEMA(net, updates=updates)
        losses, norms = [], []
        for step in range(3):
            optimizer.zero_grad()
            x, y = (torch.tensor(v[step], dtype=dtype) for v in (inputs, wanted))
            loss = ((net(x) - y) ** 2).mean()
            loss.backward()
            if step == 0 and name == "sgd":
                for k, p in net.named_parameters():
                    tensors[f"gradient.{k}"] = numpy(p.grad)
            norms.append(float(torch.nn.utils.clip_grad_norm_(net.parameters(), clip)))
            optimizer.step()
            ema.update(net)
            losses.append(float(loss))
            for k, v in state(net).items():
                tensors[f"{name}.step_{step + 1}.{k}"] = numpy(v).copy()
        for k, v in state(ema.ema).items():
            tensors[f"{name}.ema.{k}"] = numpy(v)
        tensors[f"{name}.loss"] = np.array(losses)
        tensors[f"{name}.grad_norm"] = np.array(norms)
        tensors[f"{name}.settings"] = np.array([rate, 0.937, 0.05, clip, updates])
        print(name, "losses", losses, "gradient norms", norms)
    decay = ModelEMA(first).decay
    at = np.array([1, 2, 10, 100, 1000, 2000, 5000, 20000, 100000], dtype=np.int64)
    tensors["ema_decay.updates"] = at
    tensors["ema_decay.value"] = np.array([decay(int(n)) for n in at])
    save(out / "optimiser.safetensors", tensors)


def schedules(out):
    """Rates of the three groups over two trainings, by PyTorch's own scheduler."""
    start, final, momentum = 0.01, 0.01, 0.937
    warm_momentum, warm_bias, warm_epochs, nominal, batch = 0.8, 0.1, 3.0, 64, 16
    tensors = {}
    for label, epochs, per_epoch in (("long", 20, 41), ("short", 6, 15)):
        warm = max(round(warm_epochs * per_epoch), 100)
        for shape in ("cosine", "linear"):
            if shape == "cosine":
                factor = one_cycle(1, final, epochs)
            else:
                def factor(e):
                    return 1 + (final - 1) * e / epochs
            accumulate = max(round(nominal / batch), 1)
            net = toy(torch.float64)
            optimizer = smart_optimizer(net, "SGD", start, momentum, 0.0005 * batch * accumulate / nominal)
            scheduler = torch.optim.lr_scheduler.LambdaLR(optimizer, lr_lambda=factor)
            last, rows = -1, []
            for epoch in range(epochs):
                for i in range(per_epoch):
                    n = i + per_epoch * epoch
                    if n <= warm:
                        part = n / warm
                        accumulate = max(1, np.round(1 + part * (nominal / batch - 1)))
                        for j, group in enumerate(optimizer.param_groups):
                            low = warm_bias if j == 0 else 0.0
                            high = group["initial_lr"] * factor(epoch)
                            group["lr"] = low + part * (high - low)
                            group["momentum"] = warm_momentum + part * (momentum - warm_momentum)
                    groups = optimizer.param_groups
                    stepped = n - last >= accumulate
                    if stepped:
                        optimizer.step()
                        last = n
                    rates = [g["lr"] for g in groups]
                    rows.append((n, epoch, *rates, groups[0]["momentum"], accumulate, stepped))
                scheduler.step()
            rows = np.array(rows, dtype=np.float64)
            keep = (rows[:, 0] % 7 == 0) | (np.abs(rows[:, 0] - warm) <= 5) | (rows[:, 0] < 12)
            keep |= (rows[:, 0] % per_epoch == 0) | (rows[:, 0] % per_epoch == per_epoch - 1)
            tensors[f"{label}.{shape}"] = rows[keep] if label == "long" else rows
        values = (epochs, per_epoch, warm, start, final, momentum, warm_momentum, warm_bias, nominal, batch)
        tensors[f"{label}.settings"] = np.array(values, dtype=np.float64)
    for shape, factor in (("cosine", one_cycle(1, final, 20)), ("linear", lambda e: 1 + (final - 1) * e / 20)):
        tensors[f"factor.{shape}"] = np.array([factor(e) for e in range(21)])
    save(out / "schedule.safetensors", tensors)


def main():
    out = Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    torch.manual_seed(0)
    detection_loss(out)
    iou_pairs(out)
    anchors(out)
    optimiser(out)
    schedules(out)


if __name__ == "__main__":
    main()
