"""The plan file: read back as it was written, and refused with file, place, what was expected and what was found."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from experiments.plans import Plan, PlanError, read_plan, write_plan
from experiments.plans.write import plan_text


def test_it_reads_back_to_the_last_digit(free_air: Plan, free_air_file: Path) -> None:
    back = read_plan(free_air_file)
    for written, read in zip(free_air.runs, back.runs, strict=True):
        assert np.array_equal(written.course.knots, read.course.knots)
        assert np.array_equal(written.course.duration, read.course.duration)
        assert written.course.length == read.course.length
    assert np.array_equal(back.limits.upper, free_air.limits.upper)
    assert back.assumed == free_air.assumed
    assert dict(back.wished) == dict(free_air.wished)
    assert back.expected is not None
    assert free_air.expected is not None
    assert back.expected.not_identified == free_air.expected.not_identified
    assert plan_text(back) == plan_text(free_air)


def test_a_person_can_read_it(free_air_file: Path) -> None:
    text = free_air_file.read_text()
    assert text.startswith('format = "clampid-plan/1"\nkind = "free_air"\nrobot = "kuka_kr20_r1810"\n')
    for key in re.findall(r"^(\w+) = [\[\d]", text, re.MULTILINE):
        assert key in {"assumed", "move", "not_identified", "parameter", "seed", "speed_share"} | set(
            re.findall(r"\w+_(?:s|rad|rad_s|rad_s2|m|kg|Hz|m_s2)\b", key)
        ) | {"T1", "T2", "T3", "O1", "O2", "O3", "O4", "O5", "parameters"}, key


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("clampid-plan/1", "clampid-plan/9", "key format: expected 'clampid-plan/1', found 'clampid-plan/9'"),
        ('kind = "free_air"', 'kind = "free"', "key kind: expected one of free_air, wrist, clamping, poses"),
        ("kuka_kr20_r1810", "kuka_kr20", "key robot: expected a bundled robot .* or the path of a description, found"),
        ("rate_Hz = 10.0", "rate_Hz = -1", "key rate_Hz: expected a finite number above 0, found -1"),
        (
            "rate_Hz = 10.0",
            "rate_hz = 10.0",
            "key rate_Hz: expected a finite number above 0, found no such key, but 'rate_hz'",
        ),
        ("rate_Hz = 10.0", "rate_Hz = 10.0\nspeeed = 3", "key speeed: expected one of"),
        (
            "mass_kg = 12.0",
            'mass_kg = "12"',
            r"key tool\.mass_kg: expected a finite number of kg from 0 to 3000, found '12'",
        ),
        ("dwell_s = 1.0", "dwell_s = nan", r"key run\[1\]\.dwell_s: expected a finite number not below 0, found nan"),
        ("speed_share = 0.15", "", r"key run\[1\]\.speed_share"),
        ("[[run]]", "[[walk]]", r"expected tables \[\[run\]\], found no such key"),
        ("mass_kg = 12.0", "mass_kg = 12000", r"tool\.mass_kg: .*found 12000 \(is it in grams\?\)"),
        ("com_m = [0.0, 0.0, 0.08]", "com_m = [0.0, 0.0, 80.0]", r"tool\.com_m: .*\(is it in millimetres\?\)"),
        ("ramp_s = 0.0", "ramp_s = 9.0", "run 1, move 1: expected a ramp above 0 s and at most half"),
    ],
)
def test_what_is_wrong_is_named(free_air_file: Path, old: str, new: str, words: str) -> None:
    text = free_air_file.read_text()
    assert old in text
    free_air_file.write_text(text.replace(old, new) if old == "[[run]]" else text.replace(old, new, 1))
    with pytest.raises(PlanError, match=words) as found:
        read_plan(free_air_file)
    assert str(found.value).startswith(str(free_air_file))


@pytest.mark.parametrize("stated", ['format = "clampid-plan"\n', ""])
def test_without_a_version_it_is_version_1(free_air_file: Path, free_air: Plan, stated: str) -> None:
    text = free_air_file.read_text()
    free_air_file.write_text(text.replace('format = "clampid-plan/1"\n', stated))
    assert plan_text(read_plan(free_air_file)) == plan_text(free_air)


def test_steps_beyond_the_limits_are_refused(free_air: Plan, tmp_path: Path) -> None:
    path = write_plan(free_air, tmp_path / "plan.toml")
    text = path.read_text()
    path.write_text(re.sub(r"duration_s = (\d+)\.(\d+), ramp_s", r"duration_s = 0.3, ramp_s", text, count=1))
    with pytest.raises(PlanError, match=r"run 1, move 1: .*expected at most|ramp above 0"):
        read_plan(path)
    path.write_text(text.replace("upper_rad = [", "upper_rad = [-9.0, ", 1).replace(", 5.80", "", 1))
    with pytest.raises(PlanError, match="lower limit below the upper"):
        read_plan(path)


def test_no_file_no_toml(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match="expected a plan file, found no such file"):
        read_plan(tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("format = ")
    with pytest.raises(PlanError, match="expected TOML"):
        read_plan(tmp_path / "bad.toml")
