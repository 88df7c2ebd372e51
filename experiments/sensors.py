"""Assigns temperatures to the places that ``[sensors]`` states: each place has the weighted mean of its sensors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import pandas as pd

from experiments.columns import temperature_columns
from experiments.stated import Sensor
from experiments.temperatures import readings

__all__ = ["NOWHERE", "placed"]

NOWHERE = "none"


def placed(frame: pd.DataFrame, sensors: Mapping[str, Sensor]) -> pd.DataFrame:
    """The table with one column ``temp_<place>_C`` for each place that has a sensor.

    A column ``temp_<name>_C`` whose name ``sensors`` lacks sits where its name says, with weight 1. Where one of a
    place's sensors has no reading, nor one near enough in time, the place has none: the mean of the others would jump.

    Parameters
    ----------
    frame
        The table as recorded; it is not changed, and is given back itself where none of its columns is placed.
    sensors
        Name → place.
    """
    names = temperature_columns(map(str, frame.columns))
    known = {name: name.removeprefix("temp_").removesuffix("_C") for name in names}
    if not any(name in sensors for name in known.values()):
        return frame
    places: dict[str, list[tuple[npt.NDArray[np.float64], float]]] = {}
    for column, name in known.items():
        sensor = sensors.get(name, Sensor(name))
        if sensor.at != NOWHERE:
            places.setdefault(sensor.at, []).append((readings(frame, column)[0], sensor.weight))
    means = {
        f"temp_{place}_C": sum(w * values for values, w in found) / sum(w for _, w in found)
        for place, found in places.items()
    }
    return frame.drop(columns=list(names)).assign(**means)
