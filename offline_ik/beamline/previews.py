"""Requests that look ahead and move nothing: `simulate` and `pixel`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from clampid.plain_json import finite
from offline_ik.errors import TargetError
from offline_ik.exchange.asked import sides_of, simulation_of
from offline_ik.exchange.requests import RequestError, number, numbers, switch
from offline_ik.exchange.session import Later, Reply, Session
from offline_ik.motion.picture import picture_of
from offline_ik.reflections.place import place_of
from offline_ik.reflections.seen import check_pixels, pixel_of, poni_text

if TYPE_CHECKING:
    from offline_ik.inverse.answer import Answer
    from offline_ik.inverse.detector import Detector
    from offline_ik.server.protocol import Speaker

__all__ = ["PREVIEWS"]

Array = npt.NDArray[np.float64]
Given = Mapping[str, str]

SHORTEST, LONGEST = 1e-13, 1e-8  # m, of a wavelength
POSITION = (("gamma", None), ("delta", None), ("r", None), ("roll", 0.0))


def _simulate(speaker: Speaker, given: Given, session: Session) -> Later:
    """What a move would do; the check is that of `move`."""
    start = numbers(given, "from")
    start = speaker.detector.check_posture(speaker.posture(session, "from") if start is None else start, "from")
    drawn = switch(given, "picture")
    simulate = simulation_of(given, start, sides_of(speaker.detector, given))

    def work(detector: Detector) -> tuple[dict[str, Any], Answer]:
        found = simulate(detector)
        data = finite(found.to_json())
        if drawn:
            data["picture"] = picture_of(found)
        return data, found.ways.answer

    return Later(work, lambda found: speaker.reply_of(*found))


def _pixel(speaker: Speaker, given: Given, session: Session) -> Reply | Later:
    """Which direction a pixel sees, at a detector position, a posture, or where the linked robot is."""
    pixel, asked = (number(given, "i"), number(given, "j")), [k for k in ("gamma", "delta", "r") if k in given]
    q, near = numbers(given, "q"), numbers(given, "near")
    if asked and q is not None:
        raise RequestError(f"pixel: expected q= or a detector position, found q= with {asked[0]}=")
    own = speaker.detector.cell.pixels
    pixels = check_pixels(numbers(given, "pixels") if "pixels" in given else own)
    poni, wavelength = switch(given, "poni"), number(given, "wavelength", 0.0)
    if "wavelength" in given and not SHORTEST <= wavelength <= LONGEST:
        raise TargetError(f"wavelength: expected metres from {SHORTEST:g} to {LONGEST:g}, found {wavelength:g}")

    def members(detector: Detector, pose: Array, covariance: Array) -> dict[str, Any]:
        seen = pixel_of(detector, pose, covariance, pixel, pixels)
        data: dict[str, Any] = {"pixel": list(pixel), "pixels": list(pixels), "sees": seen.to_json()}
        if poni:
            data["poni"] = poni_text(detector.cell.convention, pose, detector.cell.pixel, pixels, wavelength or None)
        return data

    if not asked:
        detector = speaker.detector
        there = detector.check_posture(speaker.posture(session, "q") if q is None else q, "q")
        place = place_of(detector, there, near)
        frames = detector.framing(detector.to_base(place.pose), there)
        data = members(detector, place.pose, place.uncertainty.covariance)
        return Reply({**data, "q_rad": there.tolist(), **frames, "convention": speaker.convention})
    gamma, delta, r, roll = (number(given, name, default) for name, default in POSITION)

    def work(detector: Detector) -> tuple[dict[str, Any], Answer]:
        answer = detector.locate(gamma, delta, r, roll, near=near, direction=None if near is None else "moved")
        if not answer.reachable:
            return {}, answer
        return members(detector, answer.target, answer.solutions[0].uncertainty.covariance), answer

    return Later(work, lambda found: speaker.reply_of(*found))


PREVIEWS: Mapping[str, Callable[[Speaker, Given, Session], Reply | Later]] = {"simulate": _simulate, "pixel": _pixel}
"""What answers these requests."""
