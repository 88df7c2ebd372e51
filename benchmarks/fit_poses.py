"""A fit of 400 poses and some 47 parameters, against scipy's least squares over a forward model written as a loop.

    python benchmarks/fit_poses.py [--runs 5] [--pybotics PYTHON] [--lengths] [--bootstrap]

Both fit the same parameters to the same rows from zero; the validation error on other rows must agree. With PYTHON, the
interpreter of an environment that has pybotics (it needs numpy below 2), both fit the geometry alone to one target, of
which pybotics has no more. ``--lengths`` fits up to 100 000 poses, ``--bootstrap`` draws 1 000 times. All times are the
processor's, of one thread.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import TypeVar

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from scipy.optimize import least_squares

from clampid.catalogue import catalogue
from clampid.fitting.bootstrap import bootstrap
from clampid.fitting.gauge import independent_geometry
from clampid.fitting.noise import initial_noise
from clampid.fitting.solve import Estimate, solve
from clampid.identification.identify import stage_rows
from clampid.slots import Slot
from clampid.stages.fit_problem import FitProblem, fit_problem
from clampid.stages.layout import layout_of
from clampid.stages.rows import Array, Rows
from experiments.campaign import Campaign
from experiments.simulate import measured_campaign
from experiments.virtual_robot import measure
from kinematics.description import load_robot

POSES = 400
Result = TypeVar("Result")


def campaign(poses: int) -> Campaign:
    """Poses of three targets each on the virtual robot, and its verification table."""
    robot = load_robot("kuka_kr20_r1810")
    measured = measure(robot, seed=1, poses=poses, tables=("poses", "verification"))
    return measured_campaign(measured, robot)


def slots_of_benchmark(rows: Rows) -> tuple[Slot, ...]:
    """The geometry, each joint's gap, and the eccentricities of two joints."""
    geometry = independent_geometry(rows, catalogue())
    gaps = tuple(Slot("backlash", "gap", f"joint{i + 1}") for i in range(6))
    gears = tuple(Slot("gear_eccentricity", p, f"joint{i}") for i in (2, 3) for p in ("a1", "b1", "a2", "b2"))
    return (*geometry, *gaps, *gears)


def loop_model(rows: Rows, slots: tuple[Slot, ...]) -> Callable[[np.ndarray], np.ndarray]:
    """Whitened residual (3 N,) row by row in Python, as such programs are usually written."""
    robot = rows.robot
    index = {s: k for k, s in enumerate(slots)}
    points = np.array([*(j.point for j in robot.joints[1:]), robot.flange[:3, 3]])
    flank = np.sign(rows.signals["gravity_torque"] + rows.signals["rest_direction"])
    target_of = [rows.layout.targets[int(np.argmax(t))] for t in rows.signals["target_is"]]
    axes = "xyz"

    def small(twist: np.ndarray) -> np.ndarray:
        w, v = twist[:3], twist[3:]
        H = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]) / 2
        out = np.eye(4)
        out[:3, :3] += 2 / (1 + w @ w / 4) * (H + H @ H)
        out[:3, 3] = v
        return out

    def about(pivot: np.ndarray, motion: np.ndarray) -> np.ndarray:
        out = motion.copy()
        out[:3, 3] += pivot - motion[:3, :3] @ pivot
        return out

    def turn(screw: np.ndarray, angle: float) -> np.ndarray:
        w, v = screw[:3], screw[3:]
        H = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        s, c = np.sin(angle), np.cos(angle)
        out = np.eye(4)
        out[:3, :3] += s * H + (1 - c) * (H @ H)
        out[:3, 3] = (np.eye(3) * angle + (1 - c) * H + (angle - s) * (H @ H)) @ v
        return out

    def residual(theta: np.ndarray) -> np.ndarray:
        def value(effect: str, parameter: str, place: str) -> float:
            k = index.get(Slot(effect, parameter, place))
            return 0.0 if k is None else float(theta[k])

        base = small(np.array([value("geometry", f"base_{a}", "session1") for a in ("rx", "ry", "rz", *axes)]))
        links = [
            about(
                points[i],
                small(np.array([value("geometry", a, f"link{i + 1}") for a in ("rx", "ry", "rz", *axes)])),
            )
            for i in range(6)
        ]
        shift = {t: np.array([value("geometry", f"target_{a}", t) for a in axes]) for t in rows.layout.targets}
        gap = [value("backlash", "gap", f"joint{i + 1}") for i in range(6)]
        gear = [[value("gear_eccentricity", p, f"joint{i + 1}") for p in ("a1", "b1", "a2", "b2")] for i in range(6)]
        out = np.empty((len(rows), 3))
        for r in range(len(rows)):
            X = rows.pose.base_reference[r] @ base
            for i in range(6):
                q = rows.signals["q"][r, i]
                a1, b1, a2, b2 = gear[i]
                angle = q - gap[i] / 2 * flank[r, i]
                angle += a1 * np.sin(q) + b1 * np.cos(q) + a2 * np.sin(2 * q) + b2 * np.cos(2 * q)
                X = X @ turn(robot.screws[i], angle) @ links[i]
            point = rows.pose.target[r] + shift[target_of[r]]
            out[r] = rows.measured[r] - (X @ robot.flange @ np.r_[point, 1.0])[:3]
        return (out / rows.sigma).ravel()

    return residual


def rms(residual: np.ndarray) -> float:
    """Root mean square of the rows' norms."""
    return float(np.sqrt(np.mean(np.sum(residual.reshape(-1, 3) ** 2, axis=1))))


@dataclass(frozen=True)
class Task:
    """Rows to fit and rows to judge by, and the parameters."""

    rows: Rows
    other: Rows
    slots: tuple[Slot, ...]

    @cached_property
    def trial(self) -> FitProblem:
        return fit_problem(self.rows, catalogue(), self.slots)

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """Start, which is the mean, and precision: ten times each parameter's reasonable size."""
        return np.zeros(len(self.slots)), np.diag(1.0 / (10.0 * self.trial.sizes()) ** 2)

    def solved(self) -> Estimate:
        zero, precision = self.prior
        return solve(self.trial, zero, initial_noise(self.rows), precision, zero)

    def error(self, theta: Array) -> float:
        """Rms error of the other rows, m."""
        return rms(fit_problem(self.other, catalogue(), self.slots).residual(theta)[0])


def timed(work: Callable[[], Result], runs: int) -> tuple[float, Result]:
    """Median time of the processor, s, and what the last run gave; the first, which compiles, does not count."""
    work()
    seconds = []
    for _ in range(runs):
        start = process_time()
        result = work()
        seconds.append(process_time() - start)
    return float(np.median(seconds)), result


def rows_of(data: Campaign, kept: Callable[[Rows], Array]) -> tuple[Rows, Rows]:
    """The poses' rows that are kept, and all of the verification, with the same guess of the base."""
    layout = layout_of([data])
    every = stage_rows([data], layout, "poses")
    rows = every.take(kept(every))
    return rows, stage_rows([data], layout, "poses", {0: rows.pose.base_reference[0]}, "verification")


def targets_in_turn(rows: Rows) -> Array:
    """One row of each visit: its three targets in turn."""
    first = np.unique(rows.unit, return_index=True)[1][:POSES]
    return first + np.arange(len(first)) % 3


def one_target(rows: Rows) -> Array:
    """The first target's row of each visit."""
    return np.flatnonzero(rows.signals["target_is"][:, 0])[:POSES]


def beside_loop(data: Campaign, runs: int) -> None:
    """Against scipy over a Python loop."""
    rows, other = rows_of(data, targets_in_turn)
    task = Task(rows, other, slots_of_benchmark(rows))
    zero, precision = task.prior
    task.trial.residual(zero)
    ours, estimate = timed(task.solved, runs)
    loop, weak = loop_model(rows, task.slots), np.sqrt(np.diag(precision))
    same = np.max(np.abs(loop(estimate.theta) - (estimate.residual / rows.sigma).ravel()))
    start = process_time()
    found = least_squares(lambda x: np.r_[loop(x), weak * x], zero, x_scale=task.trial.sizes(), method="trf")
    theirs = process_time() - start
    print(f"{len(rows)} poses, {len(task.slots)} parameters; the two forward models differ by {same:.1e} sigma")
    print(f"{'':34}{'time':>12}{'validation error':>20}")
    print(f"{'clampid.fitting.solve.solve':34}{ours * 1e3:9.1f} ms{task.error(estimate.theta) * 1e6:17.3f} µm")
    print(f"{'scipy least_squares, Python loop':34}{theirs * 1e3:9.0f} ms{task.error(found.x) * 1e6:17.3f} µm")
    print(f"{'ratio':34}{theirs / ours:9.0f}")


def beside_pybotics(data: Campaign, runs: int, python: str) -> None:
    """Against pybotics: geometry alone, one target."""
    rows, other = rows_of(data, one_target)
    other = other.take(one_target(other))
    task = Task(rows, other, independent_geometry(rows, catalogue()))
    ours, estimate = timed(task.solved, runs)
    told = run_pybotics(python, rows, other)
    if told is None:
        return
    print(f"{len(rows)} poses of one target, geometry alone")
    print(f"{'':34}{'time':>12}{'parameters':>12}{'validation error':>20}")
    error = task.error(estimate.theta) * 1e6
    print(f"{'clampid.fitting.solve.solve':34}{ours * 1e3:9.1f} ms{len(task.slots):12}{error:17.3f} µm")
    seconds, error = told["seconds"], told["other_rms"] * 1e6
    print(f"{'pybotics':34}{seconds * 1e3:9.0f} ms{told['parameters']:12}{error:17.3f} µm")
    print(f"{'ratio':34}{seconds / ours:9.0f}")


def run_pybotics(python: str, rows: Rows, other: Rows) -> dict[str, float] | None:
    """What pybotics_fit.py says of the same points; None, with the reason printed, where it cannot run."""
    table = rows.robot.dh
    if table is None:
        raise ValueError(f"{rows.robot.name}: expected a description with a DH table, found none")
    sign = np.array([row.sign for row in table.rows])
    # Standard rows are Rz Tz Tx Rx, modified ones Rx Tx Rz Tz: each takes the Tx Rx of the row before it.
    own = np.array([(row.alpha, row.a, row.theta_offset, row.d) for row in table.rows])
    before = np.vstack([np.zeros((1, 2)), own[:-1, :2]])
    last = np.eye(4)
    c, s = np.cos(own[-1, 0]), np.sin(own[-1, 0])
    last[1:3, 1:3], last[0, 3] = [[c, -s], [s, c]], own[-1, 1]
    tool = last @ table.tool
    tool[:3, 3] += tool[:3, :3] @ rows.pose.target[0]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "poses.npz"
        np.savez(
            path,
            mdh=np.c_[before, own[:, 2:]],
            tool=tool,
            world=rows.pose.base_reference[0] @ table.base,
            q=rows.signals["q"] * sign,
            points=rows.measured[:, :3],
            other_q=other.signals["q"] * sign,
            other_points=other.measured[:, :3],
        )
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
        command = [python, str(Path(__file__).with_name("pybotics_fit.py")), str(path)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
        except OSError as error:
            print(f"pybotics: not compared: {python} does not start: {error}")
            return None
        except subprocess.CalledProcessError as error:
            reason = (error.stderr.strip().splitlines() or ["it says nothing"])[-1]
            print(f"pybotics: not compared: {python} cannot run it: {reason}")
            return None
    return dict(json.loads(done.stdout.splitlines()[-1]))


def lengths(runs: int) -> None:
    """How the time of a fit grows with the poses: those of 2 000 real visits again and again."""
    data = campaign(2000)
    rows, other = rows_of(data, lambda every: np.unique(every.unit, return_index=True)[1][:2000])
    slots = slots_of_benchmark(rows)
    print(f"{'poses':>10}{'time':>12}{'a pose':>12}")
    for count in (1_000, 10_000, 100_000):
        task = Task(rows.take(np.arange(count) % len(rows)), other, slots)
        seconds, _ = timed(task.solved, max(1, runs // 2) if count < 100_000 else 1)
        print(f"{count:10}{seconds * 1e3:9.0f} ms{seconds / count * 1e6:9.1f} µs")


def thousand(data: Campaign) -> None:
    """A thousand fits of poses drawn anew."""
    rows, other = rows_of(data, targets_in_turn)
    estimate = Task(rows, other, slots_of_benchmark(rows)).solved()
    start, wall = process_time(), perf_counter()
    bootstrap(estimate, 1000, 0)
    print(f"1000 bootstrap fits: {process_time() - start:.1f} s of the processor, {perf_counter() - wall:.1f} s passed")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--pybotics", metavar="PYTHON")
    parser.add_argument("--lengths", action="store_true")
    parser.add_argument("--bootstrap", action="store_true")
    arguments = parser.parse_args()
    data = campaign(POSES)
    beside_loop(data, arguments.runs)
    if arguments.pybotics:
        beside_pybotics(data, arguments.runs, arguments.pybotics)
    else:
        print("pybotics: not compared: no --pybotics PYTHON given")
    if arguments.lengths:
        lengths(arguments.runs)
    if arguments.bootstrap:
        thousand(data)


if __name__ == "__main__":
    main()
