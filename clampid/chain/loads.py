"""The torques that joints bear by a model, as effects that act on a load see them."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np
import numpy.typing as npt

from clampid.chain.chain import Chain, recorded
from clampid.chain.compiled import Blocks
from clampid.chain.row_symbols import load_of, symbols_of
from clampid.effect import Effect
from clampid.slots import Layout

__all__ = ["joint_loads"]

Array = npt.NDArray[np.float64]


def joint_loads(
    chain: Chain,
    effects: Mapping[str, Effect],
    layout: Layout,
    constants: Mapping[str, Array],
    theta: Array,
    signals: Mapping[str, Array],
) -> Array:
    """Torques ``(N, n)``, Nm, that joints bear at ``theta`` ``(P,)``: weight, inertia and springs, no friction.

    Parameters
    ----------
    chain
        Of an arm in motion, its slots and stage.
    effects, layout, constants
        As of :func:`clampid.chain.chain.build_chain`.
    """
    active = [effects[name] for name in dict.fromkeys(slot.effect for slot in chain.slots)]
    symbols, row = symbols_of(chain.slots, active, layout, constants)
    load = ca.densify(load_of(row, chain.stage, active))
    function = Blocks(ca.Function("loads", [symbols, ca.vertcat(*row.flats.values())], [load]))
    count = len(signals["gravity_torque"])
    return function(theta, *(np.reshape(recorded(signals, name), (count, -1)) for name in row.flats))[0]
