"""A fit of 400 poses and some 47 parameters, against scipy's least squares over a forward model written as a loop.

    python benchmarks/fit_poses.py [--runs 5]

Both fit the same parameters to the same rows from zero; the validation error on other rows must agree.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from time import perf_counter

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from scipy.optimize import least_squares

from clampid.catalogue import catalogue
from clampid.fit import solve
from clampid.gauge import independent_geometry
from clampid.identify import stage_rows
from clampid.layout import layout_of
from clampid.noise import initial_noise
from clampid.slots import Slot
from clampid.stages.experiment import experiment
from clampid.stages.rows import Rows
from experiments.campaign import Campaign
from experiments.simulate import measured_campaign
from experiments.virtual_robot import measure
from kinematics.description import load_robot

POSES = 400


def campaign() -> Campaign:
    """Poses of one target each on the virtual robot, and its verification table."""
    robot = load_robot("kuka_kr20_r1810")
    measured = measure(robot, seed=1, poses=POSES, tables=("poses", "verification"))
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
            X = rows.constants["base_reference"][r] @ base
            for i in range(6):
                q = rows.signals["q"][r, i]
                a1, b1, a2, b2 = gear[i]
                angle = q - gap[i] / 2 * flank[r, i]
                angle += a1 * np.sin(q) + b1 * np.cos(q) + a2 * np.sin(2 * q) + b2 * np.cos(2 * q)
                X = X @ turn(robot.screws[i], angle) @ links[i]
            point = rows.constants["target"][r] + shift[target_of[r]]
            out[r] = rows.measured[r] - (X @ robot.flange @ np.r_[point, 1.0])[:3]
        return (out / rows.sigma).ravel()

    return residual


def rms(residual: np.ndarray) -> float:
    """Root mean square of the rows' norms."""
    return float(np.sqrt(np.mean(np.sum(residual.reshape(-1, 3) ** 2, axis=1))))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    runs = parser.parse_args().runs
    data = campaign()
    layout = layout_of([data])
    every = stage_rows([data], layout, "poses")
    first = np.unique(every.unit, return_index=True)[1][:POSES]
    rows = every.take(first + np.arange(len(first)) % 3)  # each visit's three targets in turn
    base = {0: rows.constants["base_reference"][0]}
    test = stage_rows([data], layout, "poses", base, "verification")
    slots = slots_of_benchmark(rows)
    trial = experiment(rows, catalogue(), slots)
    size = trial.sizes()
    precision, zero, noise = np.diag(1.0 / (10.0 * size) ** 2), np.zeros(len(slots)), initial_noise(rows)
    trial.residual(zero)
    ours = []
    for _ in range(runs):
        start = perf_counter()
        estimate = solve(trial, zero, noise, precision, zero)
        ours.append(perf_counter() - start)
    loop, weak = loop_model(rows, slots), np.sqrt(np.diag(precision))
    same = np.max(np.abs(loop(estimate.theta) - (estimate.residual / rows.sigma).ravel()))
    theirs = []
    for _ in range(max(1, runs // 3)):
        start = perf_counter()
        found = least_squares(lambda x: np.r_[loop(x), weak * x], zero, x_scale=size, method="trf")
        theirs.append(perf_counter() - start)
    check = experiment(test, catalogue(), slots)
    error_ours, error_theirs = (rms(check.residual(t)[0]) * 1e6 for t in (estimate.theta, found.x))
    print(f"{len(rows)} poses, {len(slots)} parameters; the two forward models differ by {same:.1e} sigma")
    print(f"{'':34}{'median':>12}{'validation error':>20}")
    print(f"{'clampid.fit.solve':34}{np.median(ours) * 1e3:9.1f} ms{error_ours:17.3f} µm")
    print(f"{'scipy least_squares, Python loop':34}{np.median(theirs) * 1e3:9.0f} ms{error_theirs:17.3f} µm")
    print(f"{'ratio':34}{np.median(theirs) / np.median(ours):9.0f}")


if __name__ == "__main__":
    main()
