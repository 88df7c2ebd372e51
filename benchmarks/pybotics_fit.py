"""Fits poses with pybotics, in an environment that has it (numpy below 2); started by fit_poses.py --pybotics PYTHON.

    PYTHON pybotics_fit.py IN.npz

As pybotics' own calibration example does it, by least squares over `optimize_accuracy`: the world frame, modified
Denavit-Hartenberg links, and the tool's position, without what would be the same twice (the first link moves like the
world, the last one's turn and length like the tool). Prints JSON: processor seconds, parameters, evaluations, and
the errors of fitted and other points, m.
"""

from __future__ import annotations

import json
import sys
from time import process_time

import numpy as np
from pybotics.kinematic_chain import MDHKinematicChain
from pybotics.optimization import OptimizationHandler, compute_absolute_errors, optimize_accuracy
from pybotics.robot import Robot
from pybotics.tool import Tool
from scipy.optimize import least_squares

STEPS = 60  # of the search, whose validation error is then within a per cent; without a limit it takes many minutes


def main(path: str) -> None:
    given = np.load(path)
    robot = Robot(MDHKinematicChain.from_parameters(given["mdh"]), tool=Tool(given["tool"]), world_frame=given["world"])
    handler = OptimizationHandler(
        robot,
        kinematic_chain_mask=[False] * 4 + [True] * (robot.kinematic_chain.num_parameters - 6) + [False] * 2,
        tool_mask=[True] * 3 + [False] * 3,
        world_mask=[True] * 6,
    )
    start = handler.generate_optimization_vector()
    before = process_time()
    found = least_squares(
        optimize_accuracy, start, args=(handler, given["q"], given["points"]), x_scale="jac", max_nfev=STEPS
    )
    seconds = process_time() - before
    handler.apply_optimization_vector(found.x)

    def rms(q: np.ndarray, points: np.ndarray) -> float:
        return float(np.sqrt(np.mean(compute_absolute_errors(q, points, handler.robot) ** 2)))

    told = {
        "seconds": seconds,
        "parameters": len(start),
        "evaluations": int(found.nfev),
        "fitted_rms": rms(given["q"], given["points"]),
        "other_rms": rms(given["other_q"], given["other_points"]),
    }
    print(json.dumps(told))


if __name__ == "__main__":
    main(sys.argv[1])
