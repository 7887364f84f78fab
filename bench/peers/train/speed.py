"""Training speed: RealNet's trainer, a bare burn loop, and PyTorch, by turns.

YOLOv5n, one class, random weights, SGD with momentum, GIoU; seconds a step.
PyTorch runs PyPI's yolov5 package (its model and its loss) on a batch that is
there, without loading data. Packages: requirements.txt beside this file.

    cargo build --release -p realnet-train --example training_speed
    python speed.py TARGET/release/examples/training_speed [ROUNDS] [BATCH] [SIZE]
"""

import statistics
import subprocess
import sys

STEPS = 20
WARM_UP = 2


def torch_step(batch, size):
    """Seconds a step, in this process."""
    import time
    from pathlib import Path

    import torch
    import yolov5.utils.loss as yolo_loss
    from yolov5.models.yolo import Model

    torch.manual_seed(0)
    config = Path(yolo_loss.__file__).parents[1] / "models" / "yolov5n.yaml"
    model = Model(str(config), ch=3, nc=1).train()
    model.hyp = {
        "box": 0.05, "obj": (size / 640) ** 2, "cls": 0.5 / 80, "cls_pw": 1.0, "obj_pw": 1.0,
        "anchor_t": 4.0, "label_smoothing": 0.0, "fl_gamma": 0.0,
    }
    criterion = yolo_loss.ComputeLoss(model)
    optimizer = torch.optim.SGD(model.parameters(), lr=1e-4, momentum=0.937, nesterov=True)
    image = torch.rand(batch, 3, size, size)
    targets = torch.tensor(
        [[i // 4, 0, 0.2 + 0.2 * (i % 4), 0.5, 0.15, 0.15] for i in range(4 * batch)]
    )
    times = []
    for step in range(WARM_UP + STEPS):
        start = time.perf_counter()
        loss, _ = criterion(model(image), targets)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if step >= WARM_UP:
            times.append(time.perf_counter() - start)
    return sum(times) / len(times)


def main():
    program = sys.argv[1]
    given = sys.argv[2:]
    rounds, batch, size = (int(word) for word in given + ["5", "8", "320"][len(given) :])
    if rounds == 0:
        print(torch_step(batch, size))
        return
    commands = {
        "bare": [program, "bare", str(batch), str(size), str(STEPS)],
        "trainer": [program, "trainer", str(batch), str(size), str(STEPS)],
        "torch": [sys.executable, __file__, program, "0", str(batch), str(size)],
    }
    times = {name: [] for name in commands}
    for turn in range(rounds):
        for name, command in commands.items():
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            times[name].append(float(done.stdout.split()[-1]))
        print(turn, {name: round(values[-1], 4) for name, values in times.items()}, flush=True)
    median = {name: statistics.median(values) for name, values in times.items()}
    ratio = lambda a, b: statistics.median(x / y for x, y in zip(times[a], times[b]))
    print("seconds a step:", {name: round(value, 4) for name, value in median.items()})
    print(f"speed of the trainer / bare loop: {ratio('bare', 'trainer'):.3f}")
    print(f"speed of the trainer / PyTorch:   {ratio('torch', 'trainer'):.3f}")


if __name__ == "__main__":
    main()
