"""The target filter with late depths: RealNet against GTSAM's fixed-lag smoothers and
FilterPy's Kalman filter without late handling, on the same simulated logs.

    pip install -r bench/peers/fusion/requirements.txt
    cargo build --release -p realnet-fusion --example fusion_peer
    python bench/peers/fusion/compare.py --seeds 20

A log is a drive of a follower behind a target that brakes and turns: a direction and a
fast range (moved by flow from the last depth map that is there) at 30 Hz, a depth map at
3 Hz that comes 0.27 s late; every map has a scale error of 10 % of its own, which all
ranges derived from it share. With `ground` all maps have a common error of 5 % besides,
and there is a ground range at 30 Hz with 5 % noise and a constant pitch error (4 % a
metre). At each frame every side gets what has arrived by then, in that order, and is asked
for the range at that frame; the error is that to the truth. The sides run one after the
other on each log, each on one thread.

How it was made fair:

* GTSAM has the model that our filter has: white jerk with a decaying acceleration (same
  densities, same discretisation), a variable for the scale error of each map, one for that
  common to all maps, one for the ground's. Both sides are told the deviations that the
  errors of the logs are drawn with. A late range becomes a factor on the state of its own
  frame, which is what a smoother is made for.
* Its factors are C++ types (`LinearContainerFactor` over `JacobianFactor`), linearised at
  its own newest estimate when they are added, so that no Python runs inside its update.
  Only `update` and the query of the newest state are timed, not the making of factors.
  Both fixed-lag smoothers are run, and the faster one counts for time.
* Its smoothers refuse the exact process noise of 1/30 s as indeterminate when they factor
  by Cholesky, their faster way; 0.1 mm of noise on the position (and as little on the rest)
  is added for them. Three times that changes their error by less than 1 %.
* `--nonlinear N` runs the incremental smoother a second time on N of the logs with factors
  that it can linearise anew (`CustomFactor`, Python inside, so not for time), and its error
  counts, too. The best of its errors is what ours is compared with.
* Its lag is just enough for the lateness (0.5 s by default), which favours its time.
* FilterPy's filter has the same motion model; a range with the direction of its frame is a
  position. It takes late ranges as if they were of the present frame. A Kalman filter has
  no place for an error that ranges share, so its deviation of a range is chosen as the one
  of several that gives it the smallest error on these very logs.
* Our time is that of the same work: all pushes with their replays and a question a frame.
"""

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "TBB_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

import gtsam
import numpy as np
from filterpy.kalman import KalmanFilter

ROOT = Path(__file__).resolve().parents[3]

# The defaults of TargetOptions.
JERK_DENSITY = 10.0
ACCELERATION_TIME = 0.5
START_SPEED, START_ACCELERATION = 1.0, 1.5
MAP_SCALE = 0.1
# Deviation of the errors common to all maps, and to all ground ranges at 1 m.
KINDS = {"network": (0.001, 0.0), "ground": (0.05, 0.04)}
# Noise added for GTSAM, of position, velocity, acceleration: see above.
FLOOR = np.diag([1e-4, 1e-3, 1e-2]) ** 2


def read(path):
    frames, arriving = [], []
    for line in Path(path).read_text().splitlines():
        kind, *fields = line.split(",")
        if kind == "frame":
            stamp, x, y, heading, *_, depth = fields
            pose = (float(x), float(y), float(heading))
            frames.append({"stamp": int(stamp), "pose": pose, "depth": float(depth)})
        else:
            arrival, stamp, x, y, heading, value, std, of_map = fields
            arriving.append(
                {
                    "kind": kind,
                    "arrival": int(arrival),
                    "stamp": int(stamp),
                    "pose": (float(x), float(y), float(heading)),
                    "value": float(value),
                    "std": float(std),
                    "map": int(of_map),
                }
            )
    return frames, arriving


def by_frame(frames, arriving):
    """For each frame what has arrived since the one before."""
    position = 0
    for frame in frames:
        new = []
        while position < len(arriving) and arriving[position]["arrival"] <= frame["stamp"]:
            new.append(arriving[position])
            position += 1
        yield frame, new


def axes(pose):
    forward = np.array([math.cos(pose[2]), math.sin(pose[2])])
    return forward, np.array([-forward[1], forward[0]])


def depth_from(pose, position):
    return float(axes(pose)[0] @ (position - np.array(pose[:2])))


def response(seconds):
    rate = 1.0 / ACCELERATION_TIME
    gone = -math.expm1(-rate * seconds)
    return np.array([(rate * seconds - gone) / rate**2, gone / rate, 1.0 - gone])


def motion(seconds):
    """Transition and noise of (x, y) of position, velocity, acceleration."""
    axis = np.array([[1.0, seconds, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    axis[:, 2] = response(seconds)
    noise = np.zeros((3, 3))
    for node, weight in ((-math.sqrt(0.6), 5 / 18), (0.0, 8 / 18), (math.sqrt(0.6), 5 / 18)):
        reply = response(seconds * (1 + node) / 2)
        noise += JERK_DENSITY * seconds * weight * np.outer(reply, reply)
    return np.kron(axis, np.eye(2)), np.kron(noise, np.eye(2))


def whitener(covariance):
    return np.linalg.inv(np.linalg.cholesky(covariance))


def first_position(pose, depth, tangent):
    forward, left = axes(pose)
    return np.array(pose[:2]) + depth * (forward + tangent * left)


class Gtsam:
    """A fixed-lag smoother; `nonlinear` for factors that are linearised anew."""

    def __init__(self, kind, errors, lag, nonlinear=False):
        self.errors = errors
        if kind == "incremental":
            parameters = gtsam.ISAM2Params()
            parameters.relinearizeSkip = 1
            self.smoother = gtsam.IncrementalFixedLagSmoother(lag, parameters)
        else:
            self.smoother = gtsam.BatchFixedLagSmoother(lag)
        self.nonlinear = nonlinear
        self.index = {}  # stamp of a frame -> number
        self.maps = {}
        self.waiting = []
        self.last = None  # stamp and key of the newest state
        self.network, self.ground = gtsam.symbol("b", 0), gtsam.symbol("g", 0)
        self.begun = False
        self.seconds = 0.0

    def state(self, key):
        if self.new.exists(key):
            return self.new.atVector(key)
        return self.smoother.calculateEstimateVector(key)

    def linear(self, blocks, error):
        """A factor on sum(A (x - x0)) = error, whitened."""
        point = gtsam.Values()
        arguments = []
        for key, block in blocks:
            point.insert(key, self.state(key))
            arguments += [key, block]
        unit = gtsam.noiseModel.Unit.Create(len(error))
        factor = gtsam.JacobianFactor(*arguments, error, unit)
        self.graph.push_back(gtsam.LinearContainerFactor(factor, point))

    def prior(self, key, mean, deviations):
        self.new.insert(key, mean)
        self.linear([(key, np.diag(1.0 / deviations))], np.zeros(len(mean)))

    def state_at(self, stamp):
        """The key of a frame's state; a new one is chained to the newest."""
        if stamp in self.index:
            return self.index[stamp]
        key = gtsam.symbol("x", len(self.index))
        last_stamp, last_key = self.last
        transition, noise = motion((stamp - last_stamp) * 1e-9)
        white = whitener(noise + np.kron(FLOOR, np.eye(2)))
        self.new.insert(key, transition @ self.state(last_key))
        self.linear([(last_key, -white @ transition), (key, white)], np.zeros(6))
        self.index[stamp] = key
        self.stamps[key] = stamp * 1e-9
        self.last = (stamp, key)
        return key

    def map_error(self, stamp):
        if stamp not in self.maps:
            key = gtsam.symbol("m", len(self.maps))
            self.maps[stamp] = key
            self.new.insert(key, self.state(self.network).copy())
            one = np.array([[1.0 / MAP_SCALE]])
            self.linear([(key, one), (self.network, -one)], np.zeros(1))
        key = self.maps[stamp]
        self.stamps[key] = self.now
        return key

    def begin(self, direction, reading):
        position = first_position(reading["pose"], reading["value"], direction["value"])
        wide = 10.0 * reading["value"]
        key = gtsam.symbol("x", 0)
        deviations = np.array([wide, wide] + [START_SPEED] * 2 + [START_ACCELERATION] * 2)
        self.prior(key, np.concatenate([position, np.zeros(4)]), deviations)
        self.prior(self.network, np.zeros(1), np.array([self.errors[0]]))
        self.prior(self.ground, np.zeros(1), np.array([max(self.errors[1], 1e-3) * reading["value"]]))
        self.index[reading["stamp"]] = key
        self.stamps[key] = reading["stamp"] * 1e-9
        self.last = (reading["stamp"], key)
        self.begun = True

    def measure(self, reading):
        key = self.state_at(reading["stamp"])
        pose, weight = reading["pose"], 1.0 / reading["std"]
        forward, left = axes(pose)
        origin = np.array(pose[:2])

        def seen(state):
            local = state[:2] - origin
            return float(forward @ local), float(left @ local)

        if reading["kind"] == "direction":
            keys = [key]
        elif reading["kind"] == "network":
            keys = [key, self.map_error(reading["map"])]
        else:
            keys = [key, self.ground]

        def relation(states):
            depth, lateral = seen(states[0])
            row = np.zeros((1, 6))
            if len(states) == 1:
                row[0, :2] = (left - forward * lateral / depth) / depth
                return lateral / depth - reading["value"], [row]
            row[0, :2] = forward / depth
            error = math.log(depth) + float(states[1][0]) - math.log(reading["value"])
            return error, [row, np.eye(1)]

        if self.nonlinear:

            def evaluate(factor, values, jacobians):
                error, rows = relation([values.atVector(k) for k in keys])
                if jacobians is not None:
                    for i, row in enumerate(rows):
                        jacobians[i] = row
                return np.array([error])

            noise = gtsam.noiseModel.Isotropic.Sigma(1, reading["std"])
            self.graph.push_back(gtsam.CustomFactor(noise, keys, evaluate))
        else:
            error, rows = relation([self.state(k) for k in keys])
            blocks = [(k, weight * row) for k, row in zip(keys, rows)]
            self.linear(blocks, np.array([-weight * error]))

    def step(self, frame, readings):
        self.graph, self.new, self.stamps = gtsam.NonlinearFactorGraph(), gtsam.Values(), {}
        self.now = frame["stamp"] * 1e-9
        self.waiting += readings
        if not self.begun:
            ranges = [r for r in self.waiting if r["kind"] != "direction"]
            if not ranges:
                return None
            first = min(ranges, key=lambda r: r["stamp"])
            same = [r for r in self.waiting if r["kind"] == "direction"]
            same = [r for r in same if r["stamp"] == first["stamp"]]
            if not same:
                return None
            self.waiting = [r for r in self.waiting if r["stamp"] >= first["stamp"]]
            self.begin(same[0], first)
        for reading in sorted(self.waiting, key=lambda r: r["stamp"]):
            self.measure(reading)
        self.waiting = []
        self.stamps[self.network] = self.stamps[self.ground] = self.now
        stamp, key = self.last
        start = time.perf_counter()
        self.smoother.update(self.graph, self.new, self.stamps)
        state = self.smoother.calculateEstimateVector(key)
        self.seconds += time.perf_counter() - start
        ahead = (frame["stamp"] - stamp) * 1e-9
        if ahead > 0:
            state = motion(ahead)[0] @ state
        return depth_from(frame["pose"], state[:2])


class FilterPy:
    """Takes a late range as if it were of the present frame."""

    def __init__(self, range_std):
        self.range_std = range_std
        self.filter = None
        self.last = None
        self.seconds = 0.0

    def step(self, frame, readings):
        directions = [r for r in readings if r["kind"] == "direction"]
        ranges = [r for r in readings if r["kind"] != "direction"]
        start = time.perf_counter()
        if self.filter is not None:
            seconds = (frame["stamp"] - self.last) * 1e-9
            self.last = frame["stamp"]
            self.filter.F, self.filter.Q = motion(seconds)
            self.filter.predict()
        for reading in ranges if directions else []:
            pose, direction = frame["pose"], directions[-1]
            position = first_position(pose, reading["value"], direction["value"])
            forward, left = axes(pose)
            sight = forward + left * direction["value"]
            noise = np.outer(sight, sight) * (self.range_std * reading["value"]) ** 2
            noise += np.outer(left, left) * (direction["std"] * reading["value"]) ** 2
            if self.filter is None:
                self.filter = KalmanFilter(dim_x=6, dim_z=2)
                self.filter.H = np.eye(2, 6)
                self.filter.x = np.concatenate([position, np.zeros(4)]).reshape(6, 1)
                speed = [START_SPEED**2] * 2 + [START_ACCELERATION**2] * 2
                self.filter.P = np.diag([0.0] * 2 + speed)
                self.filter.P[:2, :2] = noise
                self.last = frame["stamp"]
                continue
            self.filter.update(position.reshape(2, 1), R=noise)
        self.seconds += time.perf_counter() - start
        if self.filter is None:
            return None
        return depth_from(frame["pose"], self.filter.x[:2, 0])


class Ours:
    def __init__(self, binary):
        command = [str(binary)]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        if self.process.stdout.readline().strip() != "ready":
            sys.exit("fusion_peer: expected 'ready'")

    def run(self, path, network_std):
        self.process.stdin.write(f"{path} {network_std}\n")
        self.process.stdin.flush()
        answer = json.loads(self.process.stdout.readline())
        return answer["depth"], answer["std"], answer["ns"] * 1e-9

    def close(self):
        self.process.stdin.close()
        self.process.wait()


def drive(side, frames, arriving):
    depths = [side.step(frame, new) for frame, new in by_frame(frames, arriving)]
    return depths, side.seconds


def score(depths, frames, from_s):
    """Sum of squares of the errors in metres, of relative ones without sign, and count."""
    squares, relative, count = 0.0, 0.0, 0
    for depth, frame in zip(depths, frames):
        if frame["stamp"] * 1e-9 >= from_s:
            error = (math.inf if depth is None else depth) - frame["depth"]
            squares += error * error
            relative += abs(error) / frame["depth"]
            count += 1
    return np.array([squares, relative, count])


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--from", dest="from_s", type=float, default=1.0)
    parser.add_argument("--lag", type=float, default=0.5)
    parser.add_argument("--nonlinear", type=int, default=0, help="logs for that variant")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--range-stds", default="0.01,0.03,0.1,0.2,0.4,0.8")
    parser.add_argument("--binary", default=ROOT / "target/release/examples/fusion_peer")
    parser.add_argument("--json", help="write the figures to this file")
    args = parser.parse_args()
    stds = [float(v) for v in args.range_stds.split(",")]
    figures = []
    for kind in args.kinds:
        ours, errors = Ours(args.binary), KINDS[kind]
        scores, times, inside = {}, {}, 0

        def add(name, depths, seconds, frames):
            scores[name] = scores.get(name, 0) + score(depths, frames, args.from_s)
            times.setdefault(name, []).append(seconds / len(frames) * 1e6)

        some = {}  # of the logs with the nonlinear variant
        with tempfile.TemporaryDirectory() as scratch:
            for seed in range(args.seeds):
                path = Path(scratch) / f"{seed}.csv"
                write = [args.binary, "write", path, seed, args.seconds, *errors]
                subprocess.run([str(v) for v in write], check=True)
                frames, arriving = read(path)
                ours.run(path, errors[0])  # warms
                depths, deviations, seconds = ours.run(path, errors[0])
                add("realnet", depths, seconds, frames)
                for depth, std, frame in zip(depths, deviations, frames):
                    if frame["stamp"] * 1e-9 >= args.from_s and depth is not None:
                        inside += abs(depth - frame["depth"]) <= 2 * std
                if seed < args.nonlinear:
                    some["realnet"] = some.get("realnet", 0) + score(depths, frames, args.from_s)
                    again = Gtsam("incremental", errors, args.lag, nonlinear=True)
                    depths, _ = drive(again, frames, arriving)
                    name = "gtsam nonlinear"
                    some[name] = some.get(name, 0) + score(depths, frames, args.from_s)
                for smoother in ("incremental", "batch"):
                    side = Gtsam(smoother, errors, args.lag)
                    add(f"gtsam {smoother}", *drive(side, frames, arriving), frames)
                for std in stds:
                    side = FilterPy(std)
                    add(f"filterpy {std}", *drive(side, frames, arriving), frames)
        ours.close()
        row = {
            "ranges": kind,
            "logs": args.seeds,
            "seconds": args.seconds,
            "gtsam": version("gtsam"),
            "filterpy": version("filterpy"),
        }
        for name, (squares, relative, count) in scores.items():
            row[name] = {
                "rmse_m": round(math.sqrt(squares / count), 4),
                "abs_rel": round(relative / count, 4),
                "us_per_frame": round(statistics.median(times[name]), 2),
            }
        row["realnet"]["inside_two_deviations"] = round(inside / scores["realnet"][2], 4)
        for name, (squares, relative, count) in some.items():
            row[f"{name}, first {args.nonlinear} logs"] = {
                "rmse_m": round(math.sqrt(squares / count), 4),
                "abs_rel": round(relative / count, 4),
            }
        for smoother in ("incremental", "batch"):
            pairs = zip(times["realnet"], times[f"gtsam {smoother}"])
            ratios = sorted(a / b for a, b in pairs)
            row[f"time realnet / gtsam {smoother}"] = {
                "median": round(statistics.median(ratios), 4),
                "p10": round(ratios[len(ratios) // 10], 4),
                "p90": round(ratios[-1 - len(ratios) // 10], 4),
            }
        best = min((n for n in row if n.startswith("filterpy ")), key=lambda n: row[n]["rmse_m"])
        row["filterpy at its best"] = {"range_std": best.split()[1], **row[best]}
        figures.append(row)
        print(json.dumps(row, indent=1))
    if args.json:
        Path(args.json).write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
