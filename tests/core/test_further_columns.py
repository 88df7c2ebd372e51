"""Columns of poses beyond the contract as signals: which ones, and what stands in for empty cells."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from clampid.diagnosis.dependence import dependence
from clampid.effect import EffectError
from clampid.signals import SIGNALS, signal
from clampid.stages.further_columns import further_signals
from experiments.columns import TABLES, further_columns, is_further, parted, table_format


def test_no_column_of_the_contract_is_a_further_one():
    for table in TABLES:
        names = list(table_format(table, 6).known())
        assert further_columns(names, table, 6) == ()
    assert not any(is_further(name) for name in SIGNALS)


@pytest.mark.parametrize("name", ["remark", "std_x_m", "temp_link1_C", "temp_oil_K", "humidity", "_m", "9_m"])
def test_what_has_no_unit_or_another_meaning_is_none(name: str):
    assert further_columns([name], "poses", 6) == ()


def test_a_name_is_parted_from_its_unit():
    assert parted("approach_qd1_rad_s") == ("approach_qd1", "rad_s")
    assert parted("remark") == ("remark", "")
    assert signal("approach_qd1_rad_s") is not None
    assert signal("joint_sped") is None


def test_empty_cells_have_the_mean_and_text_is_left_out():
    poses = pd.DataFrame({"x_m": [0.0] * 3, "humidity_percent": [40.0, np.nan, 50.0], "note_m": ["a", "b", "c"]})
    verification = pd.DataFrame({"x_m": [0.0] * 2, "flow_m_s": [1.0, 3.0]})
    both = {"poses": poses, "verification": verification}
    found = further_signals(poses, both, 6)
    assert set(found) == {"humidity_percent", "flow_m_s"}
    np.testing.assert_allclose(found["humidity_percent"], [40.0, 45.0, 50.0])
    np.testing.assert_allclose(found["flow_m_s"], 2.0)
    np.testing.assert_allclose(further_signals(verification, both, 6)["humidity_percent"], 45.0)


def test_a_dependence_on_it_is_known_in_poses_only():
    assert dependence(["humidity_percent"], "base").stage == "poses"
    assert dependence(["approach_qd1_rad_s", "q1"], "joint1", joints=6).variables[0].name == "approach_qd1_rad_s"
    for wrong in (["q1_rad"], ["time_s"], ["humidity"]):
        with pytest.raises(EffectError, match="is not known in poses"):
            dependence(wrong, "base")
    with pytest.raises(EffectError, match="is not known in free_air"):
        dependence(["humidity_percent"], "motor1", "free_air")
