"""The torques that joints bear by a model are those on which load-dependent effects act."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from clampid.catalogue import catalogue
from clampid.effect import Stage
from clampid.slots import Slot
from clampid.stages.fit_problem import fit_problem
from clampid.stages.rows import Rows


def test_loads_are_what_friction_that_depends_on_them_sees(few_rows: Mapping[Stage, Rows]) -> None:
    """With masses and inertia beyond the description, in motion, and with friction, which is no load."""
    rows = few_rows["free_air"]
    slots = [
        *(Slot("coulomb_friction", "Fc", f"joint{j}") for j in (1, 2, 3)),
        *(Slot("inertia", "I", f"joint{j}") for j in (1, 2, 3)),
        *(Slot("gravity", name, "link3") for name in ("m", "my")),
    ]
    effects = catalogue()
    theta = np.linspace(0.5, 2.0, len(slots))
    loads = fit_problem(rows, effects, slots).loads(theta)
    assert loads.shape == (len(rows), rows.robot.n)
    described = rows.signals["gravity_torque"] + rows.signals["inertia_torque"]
    assert np.abs(loads - described).max() > 0.01 * np.abs(described).max()
    np.testing.assert_allclose(fit_problem(rows, effects, slots[:3]).loads(theta[:3]), described)
    assert np.abs(rows.signals["inertia_torque"]).max() > 0.01 * np.abs(described).max()

    last = Slot("load_dependent_friction", "mu", "joint2")
    trial = fit_problem(rows, effects, [*slots, last])
    beyond = np.zeros(rows.offsets)
    by_mu = trial.derivative(np.r_[theta, 0.0, beyond], len(slots))[:, :, 0]
    expected = np.abs(loads[:, 1]) * rows.signals["joint_motion"][:, 1]
    np.testing.assert_allclose(by_mu, expected[:, None] * np.asarray(rows.robot.transmission)[:, 1], atol=1e-9)
