"""From a campaign to the detector's true place on the virtual robot that the model never saw inside."""

from __future__ import annotations

import pytest
from detector_sphere import EFFECTS, detector_of, errors, identified, measured_robot, nominal, octant

from offline_ik.inverse.detector import Detector


@pytest.mark.slow
def test_the_full_model_is_within_60_um_and_every_effect_is_worth_something() -> None:
    measured, campaign = measured_robot(0)
    detector, angles = detector_of(identified(campaign), campaign), octant(60, 0)
    full = errors(measured, detector, angles)
    assert len(full.radial) > 50
    assert full.tangential.mean() < 60e-6
    assert errors(measured, Detector(nominal(detector.arm), detector.cell), angles).tangential.mean() > 1e-3
    for effect in EFFECTS:
        if effect != "geometry":
            without = errors(measured, Detector(detector.arm.without(effect), detector.cell), angles)
            assert without.tangential.mean() > 2 * full.tangential.mean(), effect
