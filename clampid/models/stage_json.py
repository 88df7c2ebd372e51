"""What a stage of a model keeps beside its values, as JSON: draws of whole poses, and what other stages say."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from clampid.fitting.bootstrap import Bootstrap
from clampid.slots import Prior, Slot

__all__ = ["bootstrap_json", "carried_prior_json", "read_bootstrap", "read_carried_prior"]


def bootstrap_json(found: Bootstrap) -> dict[str, Any]:
    """Standard errors and intervals by drawing whole poses anew."""
    numbers = {"std": found.std, "low": found.low, "high": found.high}
    return {"count": found.count, **{name: values.tolist() for name, values in numbers.items()}}


def read_bootstrap(data: Mapping[str, Any] | None) -> Bootstrap | None:
    """The reverse of `bootstrap_json`; None of None."""
    if data is None:
        return None
    std, low, high = (np.array(data[name], dtype=float) for name in ("std", "low", "high"))
    return Bootstrap(int(data["count"]), std, low, high)


def carried_prior_json(carried_prior: Prior) -> dict[str, Any]:
    """Slots, mean and covariance of what other stages say."""
    places = [{"effect": s.effect, "parameter": s.parameter, "at": s.place} for s in carried_prior.slots]
    return {"parameters": places, "mean": carried_prior.mean.tolist(), "covariance": carried_prior.covariance.tolist()}


def read_carried_prior(data: Mapping[str, Any] | None) -> Prior | None:
    """The reverse of `carried_prior_json`; None of None."""
    if data is None:
        return None
    slots = tuple(Slot(p["effect"], p["parameter"], p["at"]) for p in data["parameters"])
    covariance = np.array(data["covariance"], dtype=float).reshape(len(slots), len(slots))
    return Prior(slots, np.array(data["mean"], dtype=float), covariance)
