"""What an effect waits for must exist."""

from __future__ import annotations

import pytest

from clampid.search_policy import Search


def test_probe_that_exists_nowhere_is_refused() -> None:
    with pytest.raises(ValueError, match="probe 'friction_at_rest' does not exist; known: joint_angle_periodic"):
        Search(revealed_by="friction_at_rest")
