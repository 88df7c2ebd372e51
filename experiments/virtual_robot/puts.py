"""The type of functions that put an effect into a plant."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from experiments.virtual_robot.description import Array
from experiments.virtual_robot.plant import Plant
from experiments.virtual_robot.sizes import Sight

Numbers = dict[str, float]
"""True parameters; every name ends in its unit."""

Put = Callable[[Plant, int, float, Sight, np.random.Generator], tuple[Plant, Numbers]]
"""From plant, joint or link (from 0), factor on the default, `Sight` and stream to the new plant and its numbers."""


def plus(values: Array, index: int, value: float | Array) -> Array:
    """Return a copy with ``value`` added at ``index``."""
    out = values.copy()
    out[index] = out[index] + value
    return out


def named(names: tuple[str, ...], values: Array) -> Numbers:
    """Return numbers by their names."""
    return dict(zip(names, map(float, values), strict=True))
