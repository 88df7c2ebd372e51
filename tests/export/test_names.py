"""Names that somebody chose: they stay names in every file and on every screen."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clampid.cli import run
from clampid.exports.dh_export import table_text
from clampid.verbs.output import Output
from experiments.campaign import CampaignError, read_campaign, write_campaign
from experiments.simulate import simulate
from kinematics.description import load_robot
from kinematics.escaping import for_csv, for_krl, for_markdown, for_terminal, has_controls, is_formula
from kinematics.kuka import nominal_machine_data
from kinematics.kuka_text import machine_data_text, read_machine_data
from kinematics.robot import DescriptionError

HOSTILE = [
    "kuka\n$MAMES[1]=99",
    "kuka\r$MAMES[1]=99",
    "kuka\u2028$MAMES[1]=99",
    "kuka\x85$MAMES[1]=99",
    "\x1b]0;title\x07\x1b[2J",
    "\x9b2J",
    "arm\u202egnp.exe",
    "nul\0",
]
FORMULAS = ["=1+1", '=HYPERLINK("http://a","b")', "@SUM(A1)", "＝1+1", " =1+1", "+cmd|' /C calc'!A0", "-1+SUM(A1)"]


@given(text=st.text())
def test_what_is_escaped_is_one_printable_line(text: str) -> None:
    krl = for_krl(text)
    assert krl.isascii()
    assert krl.isprintable()
    assert not has_controls(for_terminal(text, lines=False).encode("utf-8", "replace").decode())
    assert not any(ord(sign) < 32 and sign not in "\n\t" for sign in for_terminal(text))
    assert not for_csv(text).lstrip().startswith(("=", "+", "-", "@", "＝", "＋", "－", "＠"))
    assert "\n" not in for_markdown(text)


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_name_writes_no_line_into_machine_data(name: str) -> None:
    machine_data = nominal_machine_data(load_robot("kuka_kr20_r1810"))
    text = machine_data_text(machine_data, {}, [f"static geometry of {name}"])
    assert text.splitlines()[0].startswith("; static geometry of")
    assert len(text.splitlines()) == len(machine_data_text(machine_data, {}, ["x"]).splitlines())
    assert all(line.startswith(";") for line in text.splitlines() if "MAMES[1]=99" in line)
    read_machine_data(text)


@pytest.mark.parametrize("name", HOSTILE)
def test_descriptions_and_campaigns_refuse_it(name: str, tmp_path: Path) -> None:
    description = tmp_path / "arm.toml"
    text = (Path(__file__).parents[2] / "appendix_data" / "robots" / "ur10.toml").read_text(encoding="utf-8")
    quoted = "".join(f"\\u{ord(sign):04x}" for sign in name)
    description.write_text(text.replace('name = "ur10"', f'name = "{quoted}"', 1), encoding="utf-8")
    with pytest.raises(DescriptionError, match="printable text"):
        load_robot(description)
    arm = simulate(tmp_path / "arm", "ur10", seed=1, poses=5, tables=("poses",))
    campaign = read_campaign(arm)
    header = {**campaign.header, "targets_m": {**campaign.header["targets_m"], name: [0.0, 0.0, 0.1]}}
    again = write_campaign(tmp_path / "again", header, {"poses": campaign.tables["poses"]}, "csv")
    with pytest.raises(CampaignError, match="printable characters"):
        read_campaign(again)


@pytest.mark.parametrize("name", HOSTILE)
def test_no_escape_reaches_a_terminal(name: str, capsys) -> None:
    out = Output(quiet=True)
    out.say(name)
    out.warn(name)
    out.table("", ("name",), [(name,)])
    assert run(["robot-\x1b[2J"]) == 2
    printed = capsys.readouterr()
    for sign in "\x1b\x07\x9b\u202e\0\r\x85":
        assert sign not in printed.out + printed.err


def test_cells_are_no_formulas() -> None:
    frame = pd.DataFrame({"name": ["=1+2", "@x", "T1", "-3"], "value_m": [-1.0, 2.0, 3.0, 4.0]})
    assert table_text(frame).splitlines()[1:] == ["'=1+2,-1.0", "'@x,2.0", "T1,3.0", "'-3,4.0"]


@pytest.mark.parametrize("name", FORMULAS)
def test_a_target_is_no_formula_of_a_spreadsheet(name: str, tmp_path: Path) -> None:
    """A campaign's tables name targets as they are: what would be escaped there would be another target."""
    arm = simulate(tmp_path / "arm", "ur10", seed=1, poses=5, tables=("poses",))
    campaign = read_campaign(arm)
    header = {**campaign.header, "targets_m": {**campaign.header["targets_m"], name: [0.0, 0.0, 0.1]}}
    again = write_campaign(tmp_path / "again", header, {"poses": campaign.tables["poses"]}, "csv")
    with pytest.raises(CampaignError, match="expected names that no spreadsheet takes for a formula"):
        read_campaign(again)


@pytest.mark.parametrize("name", ["+X", "-Z", "T1", "T-1", "A=B"])
def test_a_side_of_a_block_is_no_formula(name: str) -> None:
    assert not is_formula(name)
