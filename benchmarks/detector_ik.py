"""Inverse kinematics: FK∘IK over random poses, and its speed against scipy and a loop over pin, in one run.

    python benchmarks/detector_ik.py [--poses 1000000]

The calibrated arm has drawn values of every effect of the standard set and of warm-up; poses lie anywhere within the
joint limits, those next to the borders of the reach and with a singular wrist included.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from time import process_time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pinocchio as pin
from ik_arms import MOUNT, conditions, drawn_arm, postures
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from clampid.chain.compiled import compiler
from kinematics.description import load_robot
from kinematics.robot import RobotDescription
from offline_ik.arm.identified import nominal_arm
from offline_ik.inverse.ortho import SIGNS
from offline_ik.inverse.solver import Solver


def median(call: Callable[[], object], runs: int = 15) -> float:
    """Median CPU time of a call, s: what else the machine does is not ours to count."""
    took = []
    for _ in range(runs):
        start = process_time()
        call()
        took.append(process_time() - start)
    return float(np.median(took))


def round_trip(name: str, solver: Solver, count: int) -> None:
    """FK∘IK of ``count`` random poses, a hundred thousand at a time."""
    missed, worst = 0, 0.0
    given = conditions()
    for k in range(max(count // 100_000, 1)):
        q = postures(solver.arm, min(count, 100_000), seed=k)
        T = solver.pose(q, given)
        found = solver.solve(T, np.zeros_like(q), solver.signs(q), given)
        missed += int((~found.reached).sum())
        back = np.abs(solver.pose(found.q, given) - T).max(axis=(1, 2))
        worst = max(worst, float(back[found.reached].max()))
    print(f"{name}: {count} poses, {missed} not reached, worst FK∘IK {worst:.1e} (m, entries of the rotation)")


def pin_model(robot: RobotDescription) -> tuple[pin.Model, np.ndarray]:
    """The nominal arm in pin, and the flange in its last joint's frame."""
    model, parent, before = pin.Model(), 0, np.zeros(3)
    for joint in robot.joints:
        place = pin.SE3(np.eye(3), np.asarray(joint.point) - before)
        parent = model.addJoint(parent, pin.JointModelRevoluteUnaligned(np.asarray(joint.axis)), place, joint.name)
        before = np.asarray(joint.point)
    flange = np.array(robot.flange)
    flange[:3, 3] -= before
    return model, flange


def pin_solve(model: pin.Model, data: pin.Data, frame: int, wanted: pin.SE3, q: np.ndarray) -> np.ndarray:
    """Newton's method as one writes it with pin."""
    for _ in range(50):
        pin.framesForwardKinematics(model, data, q)
        error = pin.log6(data.oMf[frame].actInv(wanted)).vector
        if np.abs(error).max() < 1e-10:
            break
        J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
        q = q + np.linalg.solve(J.T @ J + 1e-12 * np.eye(6), J.T @ error)
    return q


def speeds() -> None:
    """Microseconds of one solution, by ever slower ways."""
    solver, given = Solver(drawn_arm(), MOUNT), conditions()
    count = 2560
    rng = np.random.default_rng(0)
    q = postures(solver.arm, count) * 0.5
    T, near, signs = solver.pose(q, given), q + 0.05 * rng.normal(size=q.shape), solver.signs(q)
    R, p, here = T[:, :3, :3].reshape(count, 9), T[:, :3, 3], np.tile(given.vector, (count, 1))
    row = np.concatenate([R[0], p[0], near[0], signs[0], given.vector])
    print(f"compiler: {' '.join(compiler() or ['none'])}")

    def block() -> list[np.ndarray]:
        return solver.newton.many(R, p, near, signs, here)

    error = np.abs(block()[1]).max(axis=1)
    kernel = median(block) / count
    call = median(lambda: [solver.newton.one(row) for _ in range(200)]) / 200
    exact = np.mean(error < 1e-9)
    print(f"calibrated single solve, kernel (blocks of rows): {1e6 * kernel:.2f} µs; {exact:.3f} within 1e-9 at once")
    print(f"calibrated single solve, Python call: {1e6 * call:.1f} µs")
    eight = [np.tile(s, (count, 1)) for s in SIGNS]
    every = median(lambda: [solver.newton.many(R, p, near, s, here) for s in eight], 5) / count
    print(f"all eight branches calibrated, kernel: {1e6 * every:.1f} µs")

    def residual(x: np.ndarray, k: int) -> np.ndarray:
        at, rotation, _, _ = solver.forward.one(np.concatenate([x, given.vector]))
        turned = Rotation.from_matrix(T[k, :3, :3] @ rotation.reshape(3, 3).T).as_rotvec()
        return np.concatenate([p[k] - at, turned])

    few = 40

    def by_scipy() -> list[np.ndarray]:
        tight = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
        return [least_squares(residual, near[k], args=(k,), **tight).fun for k in range(few)]

    left = np.median(np.abs(by_scipy()).max(axis=1))
    scipy = median(by_scipy, 3) / few
    print(
        f"scipy.least_squares on the same compiled arm: {1e6 * scipy:.0f} µs (left {left:.1e}), {scipy / call:.0f} × "
        f"the Python call, {scipy / kernel:.0f} × the kernel"
    )

    robot = load_robot("kuka_kr20_r1810")
    nominal = Solver(nominal_arm(robot), np.eye(4))
    model, flange = pin_model(robot)
    frame = model.addFrame(pin.Frame("flange", 6, 0, pin.SE3(flange), pin.FrameType.OP_FRAME))
    data = model.createData()
    there = nominal.pose(q, given)
    poses = [pin.SE3(t) for t in there[:300]]
    found = [pin_solve(model, data, frame, t, near[k]) for k, t in enumerate(poses)]
    off = np.abs(nominal.pose(np.array(found), given) - there[:300]).max(axis=(1, 2))
    loop = median(lambda: [pin_solve(model, data, frame, t, near[k]) for k, t in enumerate(poses)], 5) / len(poses)
    batch = median(lambda: solver.solve(T, near, signs, given)) / count
    branch = median(lambda: nominal.branches(there)) / count
    print(
        f"batch of calibrated poses: {1e6 * batch:.2f} µs each; pin loop on the nominal arm: {1e6 * loop:.0f} µs each "
        f"({np.mean(off < 1e-9):.3f} solved): {loop / batch:.0f} ×"
    )
    print(f"all eight nominal branches with their turns: {1e6 * branch:.2f} µs each")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=1_000_000)
    given = parser.parse_args()
    speeds()
    round_trip("nominal", Solver(nominal_arm(load_robot("kuka_kr20_r1810")), np.eye(4)), given.poses)
    round_trip("calibrated", Solver(drawn_arm(seed=4), MOUNT), given.poses)


if __name__ == "__main__":
    main()
