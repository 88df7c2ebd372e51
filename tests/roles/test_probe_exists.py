"""What an effect waits for must exist."""

from __future__ import annotations

from dataclasses import replace

import pytest

from clampid.catalogue import catalogue
from clampid.effect import EffectError


def test_probe_that_exists_nowhere_is_refused() -> None:
    effect = next(e for e in catalogue().values() if e.revealed_by is not None)
    with pytest.raises(EffectError, match="probe 'friction_at_rest' does not exist; known: joint_angle_periodic"):
        replace(effect, revealed_by="friction_at_rest")
