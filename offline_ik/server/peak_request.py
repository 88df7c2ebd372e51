"""The request ``sample`` of the line protocol: lists of what was found, one number of each list a reflection."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from offline_ik.errors import TargetError
from offline_ik.exchange.requests import RequestError, number, numbers
from offline_ik.reflections.bragg import scattering_angle
from offline_ik.reflections.peaks import Peak, SampleFound, sample_from_peaks

if TYPE_CHECKING:
    from offline_ik.inverse.detector import Detector

__all__ = ["sample_of"]

Array = npt.NDArray[np.float64]


def sample_of(detector: Detector, given: Mapping[str, str]) -> SampleFound:
    """The scattering point of a request's reflections.

    Raises
    ------
    RequestError
        A list is missing, not as long as the others, or beside what excludes it.
    TargetError
        As for :func:`offline_ik.reflections.peaks.sample_from_peaks`.
    """
    return sample_from_peaks(
        detector,
        _peaks(given, detector.arm.n),
        near=numbers(given, "near"),
        repeatability=number(given, "repeatability", 0.0),
    )


def _peaks(given: Mapping[str, str], n: int) -> tuple[Peak, ...]:
    angles = _angles(given)
    count = len(angles)
    by_joints = "q" in given
    if by_joints:
        beside = [key for key in ("gamma", "delta", "r", "roll", "near") if key in given]
        if beside:
            raise RequestError(f"sample: expected q= or detector positions, found q= with {beside[0]}=")
        places = _list(given, "q", count * n).reshape(count, n)
    else:
        places = np.column_stack([_list(given, key, count) for key in ("gamma", "delta", "r")])
        places = np.column_stack([places, _list(given, "roll", count, 0.0)])
    directions = _list(given, "dir", count * n, 0.0).reshape(count, n)
    offsets = np.column_stack([_list(given, key, count, 0.0) for key in ("x", "y")]).tolist()
    std, std_xy = _list(given, "std", count).tolist(), _list(given, "std_xy", count, 0.0).tolist()
    return tuple(
        Peak(
            angles[k],
            std[k],
            places[k] if by_joints else None,
            None if by_joints else places[k].tolist(),
            directions[k],
            offsets[k],
            std_xy[k],
        )
        for k in range(count)
    )


def _angles(given: Mapping[str, str]) -> list[float]:
    """Scattering angles, rad: as they are, or of spacings and one wavelength."""
    angles, spacings = numbers(given, "two_theta"), numbers(given, "spacing")
    if (angles is None) == (spacings is None):
        raise RequestError("sample: expected two_theta=t1,t2,… or spacing=d1,d2,… with wavelength=")
    if spacings is None:
        if "wavelength" in given:
            raise RequestError("sample: expected no wavelength= with two_theta=")
        return [] if angles is None else [float(v) for v in angles]
    wavelength = number(given, "wavelength")
    out = []
    for k, spacing in enumerate(spacings.tolist(), 1):
        try:
            out.append(scattering_angle(wavelength, spacing))
        except TargetError as error:
            raise TargetError(f"reflection {k}: {error}") from None
    return out


def _list(given: Mapping[str, str], key: str, count: int, default: float | None = None) -> Array:
    """``(count,)``: a list as it is, one number for all, or the default."""
    found = numbers(given, key)
    if found is None:
        if default is None:
            raise RequestError(f"sample: expected {key}= with {count} numbers")
        return np.full(count, default)
    if len(found) == 1:
        return np.full(count, found[0])
    if len(found) != count:
        raise RequestError(f"sample: expected {key}= with {count} numbers, found {len(found)}")
    return found
