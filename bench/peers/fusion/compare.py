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
  common to all maps, one for the ground's. The common errors are constants, as they are in
  the logs (ours are Gauss-Markov processes), and the ground's is one per metre, as in the
  logs. Both sides are told the deviations that the errors of the logs are drawn with. A
  late range becomes a factor on the state of its own frame. No side needs its gate or a
  robust loss: all noise is Gaussian.
* Its states are in the coordinates in which our filter corrects: logarithm of the depth,
  tangent, motion relative to the camera over the depth. What the ranges cannot tell, the
  scale, is one fixed direction there. With positions in metres, each factor linearised at
  its own estimate puts that direction elsewhere, the smoother believes to have seen the
  scale, and the range drifts (by 20 % in 20 s with ground ranges).
* Its factors are C++ types (`LinearContainerFactor` over `JacobianFactor`), linearised at
  its own newest estimate when they are added, so that no Python runs inside its update.
  Only `update` and the query of the newest state are timed, not the making of factors.
  Both fixed-lag smoothers are run, and the fastest one counts for time.
* Its smoothers refuse the exact process noise of 1/30 s as indeterminate when they factor
  by Cholesky, their faster way; 0.1 mm of noise on the position (and as little on the rest)
  is added for them.
* `--nonlinear N` runs the incremental smoother again on N of the logs with a motion that it
  linearises anew at each change above 0.001 (`CustomFactor`, Python inside, so not for
  time), once with constant common errors and once with ours; what is measured is linear in
  its coordinates. The best of its errors is what ours is compared with.
* The first of its lags is just enough for the lateness, which favours its time; the last
  is our horizon.
* The logs' odometry is exact, and the camera's own motion then tells of the scale by
  parallax. GTSAM uses that; our filter leaves it out on purpose. `--odometry STD` gives the
  odometry of each log an unknown unit of length, for all sides alike.
* FilterPy's filter has the same motion model; a range with the direction of its frame is a
  position. It takes late ranges as if they were of the present frame. A Kalman filter has
  no place for an error that ranges share, so its deviation of a range is chosen as the one
  of several that gives it the smallest error on these very logs.
* Our time is that of the same work: all pushes with their replays and a question a frame.
  It is time on the clock; theirs is that of their thread on the processor (GTSAM's wheel
  has no other threads), which a busy machine does not lengthen as much. With `--repeats`
  the fastest run of each log counts, for both.
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
# Common errors that are Gauss-Markov processes change in steps of this.
MARKOV_STEP_S = 1.0 / 3.0
# Their times, of maps and ground, as those of our filter.
MARKOV_TIMES = (60.0, 30.0)
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


def scale_odometry(path, factor):
    """All camera poses as an odometry with another unit of length gives them."""
    lines = []
    for line in path.read_text().splitlines():
        fields = line.split(",")
        first = 2 if fields[0] == "frame" else 3
        for i in (first, first + 1):
            fields[i] = repr(float(fields[i]) * factor)
        lines.append(",".join(fields))
    path.write_text("\n".join(lines) + "\n")


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


class Camera:
    """Its motion by its poses; its acceleration smoothed."""

    def __init__(self):
        self.stamp, self.steps = None, 0
        self.velocity, self.acceleration = np.zeros(2), np.zeros(2)

    def at(self, stamp, pose):
        position = np.array(pose[:2])
        if self.stamp is not None:
            seconds = (stamp - self.stamp) * 1e-9
            velocity = (position - self.position) / seconds
            if self.steps > 0:
                change = (velocity - self.velocity) / seconds - self.acceleration
                self.acceleration = self.acceleration + change * seconds / (seconds + 0.1)
            self.velocity, self.steps = velocity, self.steps + 1
        self.stamp, self.position = stamp, position
        return pose, self.velocity, self.acceleration


def to_seen(state, camera):
    """Logarithm of the depth, tangent, and relative velocity and acceleration over depth."""
    pose, velocity, acceleration = camera
    forward, left = axes(pose)
    local = state[:2] - np.array(pose[:2])
    depth = max(float(forward @ local), 0.05)
    return np.concatenate(
        [
            [math.log(depth), float(left @ local) / depth],
            (state[2:4] - velocity) / depth,
            (state[4:] - acceleration) / depth,
        ]
    )


def from_seen(seen, camera):
    """The state, and its derivative."""
    pose, velocity, acceleration = camera
    forward, left = axes(pose)
    depth = math.exp(min(max(seen[0], -5.0), 5.0))
    local = np.concatenate([forward + seen[1] * left, seen[2:4], seen[4:]]) * depth
    derivative = depth * np.eye(6)
    derivative[:, 0] = local
    derivative[:2, 1] = depth * left
    return local + np.concatenate([pose[:2], velocity, acceleration]), derivative


class Gtsam:
    """A fixed-lag smoother; `nonlinear` for factors that are linearised anew; `times` of
    the common errors for Gauss-Markov processes instead of constants."""

    def __init__(self, kind, errors, lag, nonlinear=False, times=None):
        self.stds = {"b": errors[0], "g": max(errors[1], 1e-3)}
        self.times = times
        if kind == "incremental":
            parameters = gtsam.ISAM2Params()
            parameters.relinearizeSkip = 1
            if nonlinear:
                parameters.setRelinearizeThreshold(1e-3)
                steps = gtsam.ISAM2GaussNewtonParams()
                steps.setWildfireThreshold(0.0)
                parameters.setOptimizationParams(steps)
            self.smoother = gtsam.IncrementalFixedLagSmoother(lag, parameters)
        else:
            self.smoother = gtsam.BatchFixedLagSmoother(lag)
        self.nonlinear = nonlinear
        self.camera, self.cameras = Camera(), {}
        self.index = {}  # stamp of a frame -> key of its state
        self.maps, self.common = {}, {"b": [], "g": []}
        self.waiting = []
        self.last = None  # stamp and key of the newest state
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

    def state_at(self, stamp, pose):
        """The key of a frame's state; a new one is chained to the newest."""
        if stamp in self.index:
            return self.index[stamp]
        key = gtsam.symbol("x", len(self.index))
        (last_stamp, last), camera = self.last, self.camera.at(stamp, pose)
        before = self.cameras[last]
        transition, noise = motion((stamp - last_stamp) * 1e-9)
        white = whitener(noise + np.kron(FLOOR, np.eye(2)))
        here = self.state(last)
        moved = transition @ from_seen(here, before)[0]
        there = to_seen(moved, camera)
        self.new.insert(key, there)

        def relation(here, there):
            (old, by_old), (new, by_new) = from_seen(here, before), from_seen(there, camera)
            return white @ (new - transition @ old), [-white @ transition @ by_old, white @ by_new]

        if self.nonlinear:

            def evaluate(_, values, jacobians):
                error, blocks = relation(values.atVector(last), values.atVector(key))
                if jacobians is not None:
                    jacobians[0], jacobians[1] = blocks
                return error

            unit = gtsam.noiseModel.Unit.Create(6)
            self.graph.push_back(gtsam.CustomFactor(unit, [last, key], evaluate))
        else:
            error, blocks = relation(here, there)
            self.linear(list(zip((last, key), blocks)), -error)
        self.index[stamp], self.cameras[key], self.last = key, camera, (stamp, key)
        self.stamps[key] = stamp * 1e-9
        return key

    def common_error(self, letter, stamp):
        """Key of the error common to all maps (b) or ground ranges (g) at a time."""
        std, chain = self.stds[letter], self.common[letter]
        time_s = None if self.times is None else self.times["bg".index(letter)]
        number = 0 if time_s is None else int(stamp * 1e-9 / MARKOV_STEP_S + 1e-6)
        key = gtsam.symbol(letter, number)
        if number not in chain:
            if chain:
                kept = math.exp(-(number - chain[-1]) * MARKOV_STEP_S / time_s)
                weight = np.array([[1.0 / (std * math.sqrt(1.0 - kept * kept))]])
                before = gtsam.symbol(letter, chain[-1])
                self.new.insert(key, kept * self.state(before))
                self.linear([(before, -kept * weight), (key, weight)], np.zeros(1))
            else:
                self.new.insert(key, np.zeros(1))
                self.linear([(key, np.array([[1.0 / std]]))], np.zeros(1))
            chain.append(number)
        self.stamps[key] = self.now
        return key

    def map_error(self, stamp):
        common = self.common_error("b", stamp)
        if stamp not in self.maps:
            key = gtsam.symbol("m", len(self.maps))
            self.maps[stamp] = key
            self.new.insert(key, self.state(common).copy())
            one = np.array([[1.0 / MAP_SCALE]])
            self.linear([(key, one), (common, -one)], np.zeros(1))
        key = self.maps[stamp]
        self.stamps[key] = self.now
        return key

    def begin(self, direction, reading):
        stamp, pose, depth = reading["stamp"], reading["pose"], reading["value"]
        camera, key = self.camera.at(stamp, pose), gtsam.symbol("x", 0)
        position = first_position(pose, depth, direction["value"])
        first = to_seen(np.concatenate([position, np.zeros(4)]), camera)
        deviations = [10.0 * depth] * 2 + [START_SPEED] * 2 + [START_ACCELERATION] * 2
        self.new.insert(key, first)
        self.linear([(key, from_seen(first, camera)[1] / np.c_[deviations])], np.zeros(6))
        self.index[stamp], self.cameras[key], self.last = key, camera, (stamp, key)
        self.stamps[key] = stamp * 1e-9

    def measure(self, reading):
        """All that is measured is linear in the coordinates of the states."""
        stamp, weight = reading["stamp"], 1.0 / reading["std"]
        key = self.state_at(stamp, reading["pose"])
        seen, row = self.state(key), np.zeros((1, 6))
        if reading["kind"] == "direction":
            row[0, 1] = weight
            self.linear([(key, row)], np.array([weight * (reading["value"] - seen[1])]))
            return
        row[0, 0] = weight
        if reading["kind"] == "network":
            common, share = self.map_error(reading["map"]), 1.0
        else:  # the error of a pitch grows with the depth
            common, share = self.common_error("g", stamp), math.exp(seen[0])
        residual = math.log(reading["value"]) - seen[0] - share * self.state(common)[0]
        blocks = [(key, row), (common, np.array([[share * weight]]))]
        self.linear(blocks, np.array([weight * residual]))

    def fresh(self):
        self.graph, self.new, self.stamps = gtsam.NonlinearFactorGraph(), gtsam.Values(), {}

    def update(self):
        for letter, chain in self.common.items():
            if chain:
                self.stamps[gtsam.symbol(letter, chain[-1])] = self.now
        start = time.thread_time()
        self.smoother.update(self.graph, self.new, self.stamps)
        self.seconds += time.thread_time() - start
        self.fresh()

    def step(self, frame, readings):
        self.fresh()
        self.now = frame["stamp"] * 1e-9
        self.waiting += readings
        begins = self.last is None
        if begins:
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
        before = None
        for reading in sorted(self.waiting, key=lambda r: r["stamp"]):
            # What has waited for the first range is taken in frame by frame, so that it is
            # linearised where the target is.
            if begins and before not in (None, reading["stamp"]):
                self.update()
            self.measure(reading)
            before = reading["stamp"]
        self.waiting = []
        self.update()
        stamp, key = self.last
        start = time.thread_time()
        seen = self.smoother.calculateEstimateVector(key)
        self.seconds += time.thread_time() - start
        state = from_seen(seen, self.cameras[key])[0]
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
        start = time.thread_time()
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
        self.seconds += time.thread_time() - start
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
    parser.add_argument("--lags", type=float, nargs="+", default=[0.5, 1.5])
    parser.add_argument("--nonlinear", type=int, default=0, help="logs for those variants")
    parser.add_argument("--repeats", type=int, default=1, help="runs; the fastest counts")
    parser.add_argument("--odometry", type=float, default=0.0, help="deviation of its unit")
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
        some, wins = {}, {}  # of the logs with the nonlinear variants

        def add(name, depths, seconds, frames):
            own = score(depths, frames, args.from_s)
            scores[name] = scores.get(name, 0) + own
            times.setdefault(name, []).append(seconds / len(frames) * 1e6)
            return own

        with tempfile.TemporaryDirectory() as scratch:
            for seed in range(args.seeds):
                path = Path(scratch) / f"{seed}.csv"
                write = [args.binary, "write", path, seed, args.seconds, *errors]
                subprocess.run([str(v) for v in write], check=True)
                if args.odometry > 0:
                    normal = np.random.default_rng(seed).normal()
                    scale_odometry(path, math.exp(args.odometry * normal))
                frames, arriving = read(path)
                ours.run(path, errors[0])  # warms
                runs = [ours.run(path, errors[0]) for _ in range(args.repeats)]
                depths, deviations, seconds = min(runs, key=lambda run: run[2])
                own = add("realnet", depths, seconds, frames)
                for depth, std, frame in zip(depths, deviations, frames):
                    if frame["stamp"] * 1e-9 >= args.from_s and depth is not None:
                        inside += abs(depth - frame["depth"]) <= 2 * std
                for lag in args.lags:
                    # The batch smoother only where it is fastest.
                    smoothers = ("incremental", "batch")[: 2 if lag == args.lags[0] else 1]
                    for smoother in smoothers:
                        runs = []
                        for _ in range(args.repeats):
                            side = Gtsam(smoother, errors, lag)
                            runs.append(drive(side, frames, arriving))
                        depths, seconds = min(runs, key=lambda run: run[1])
                        add(f"gtsam {smoother} {lag:g} s", depths, seconds, frames)
                if seed < args.nonlinear:
                    some["realnet"] = some.get("realnet", 0) + own
                    for name, asked in (("constant", None), ("markov", MARKOV_TIMES)):
                        side = Gtsam("incremental", errors, args.lags[-1], True, asked)
                        depths, _ = drive(side, frames, arriving)
                        name = f"gtsam nonlinear {args.lags[-1]:g} s, {name} errors"
                        other = score(depths, frames, args.from_s)
                        some[name] = some.get(name, 0) + other
                        wins[name] = wins.get(name, 0) + int(other[0] < own[0])
                for std in stds:
                    side = FilterPy(std)
                    add(f"filterpy {std}", *drive(side, frames, arriving), frames)
        ours.close()
        row = {
            "ranges": kind,
            "logs": args.seeds,
            "seconds": args.seconds,
            "odometry": args.odometry,
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
                "better_than_realnet": wins.get(name, 0),
            }
        for name in [n for n in times if n.startswith("gtsam ")]:
            ratios = sorted(a / b for a, b in zip(times["realnet"], times[name]))
            row[f"time realnet / {name}"] = {
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
