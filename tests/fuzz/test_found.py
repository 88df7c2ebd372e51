"""What fuzzing and attacks by hand have found, one test each."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from ik_arms import drawn_model

from clampid.catalogue import with_user_effects
from clampid.chain import compiled
from clampid.cli import run
from clampid.effect import EffectError
from clampid.models.model import ModelError, load_model, save_model
from clampid.trusted import list_of_trusted, trust, trust_file
from experiments.campaign import CampaignError, read_campaign
from experiments.foreign import import_tables, read_mapping
from experiments.instruments import InstrumentError
from experiments.instruments.folder import FolderInstrument, reading_of
from experiments.instruments.line import _number
from experiments.simulate import simulate
from kinematics.description import load_robot
from kinematics.escaping import for_terminal, has_controls
from kinematics.kuka import MachineDataError, nominal_machine_data
from kinematics.kuka_text import machine_data_text, read_machine_data


def test_a_word_of_a_megabyte_in_machine_data_takes_no_minute() -> None:
    good = machine_data_text(nominal_machine_data(load_robot("kuka_kr20_r1810")), {})
    begun = time.monotonic()
    with pytest.raises(MachineDataError):
        read_machine_data(good.replace("={X ", "={" + "a" * 1_000_000 + " X ", 1).replace("$TIRORO", "$TI", 1))
    assert time.monotonic() - begun < 5


@pytest.mark.parametrize("value", [10**400, -(10**400), float("nan"), float("inf"), True, "1", None])
def test_an_instrument_s_number_beyond_all_is_refused(value: object) -> None:
    with pytest.raises(InstrumentError, match="expected a number"):
        _number(value, "time_s", 1e12)


def test_a_temperature_of_no_instrument_is_refused(tmp_path: Path) -> None:
    rows = "".join(f"{k / 1e6},2.0,0.5,1e308\n" for k in range(8))
    (tmp_path / "1.csv").write_text(f"X,Y,Z,T\n{rows}")
    instrument = FolderInstrument(tmp_path, reading_of({"columns": "X,Y,Z", "temperatures": "ambient:T"}))
    with pytest.raises(InstrumentError, match="column T: expected °C within 1000"):
        instrument._sample(tmp_path / "1.csv", "T1")


@pytest.mark.parametrize("value", ["1e308", "-1e13"])
def test_a_cell_beyond_all_quantities_is_refused(value: str, tmp_path: Path) -> None:
    arm = simulate(tmp_path / "arm", "ur10", seed=3, poses=8, tables=("poses",), file_format="csv")
    lines = (arm / "poses.csv").read_text().splitlines()
    cells = lines[3].split(",")
    cells[lines[0].split(",").index("time_s")] = value
    (arm / "poses.csv").write_text("\n".join([*lines[:3], ",".join(cells), *lines[4:], ""]))
    with pytest.raises(CampaignError, match=r"row 3 .*column time_s: expected a finite number from -1e\+12 to 1e\+12"):
        read_campaign(arm)


@pytest.mark.parametrize(
    "text",
    [
        "import sys\nsys.exit(0)\n",
        "EFFECTS = 3\n",
        "from clampid.effect import Effect\nEFFECT = Effect(1, 2)\n",
        "1/0\n",
    ],
)
def test_an_effect_file_that_ends_oddly_is_refused_by_its_name(text: str, tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(text)
    with pytest.raises(EffectError, match=r"own\.py: "):
        with_user_effects(tmp_path / "own.py")


def test_an_effect_whose_function_raises_is_refused_by_its_name(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["effect", "new", "mine", "--depends-on", "q4", "--at", "joint4"]) == 0
    text = Path("mine.py").read_text()
    assert "return at_place(" in text
    Path("mine.py").write_text(text.replace("return at_place(", "return at_placed("))
    assert run(["effects", "mine", "--effects-from", "mine.py"]) == 2
    assert "NameError" in capsys.readouterr().err


def test_a_name_too_long_for_the_system_is_the_caller_s_fault(capsys) -> None:
    assert run(["check", "x" * 5000]) == 2
    assert run(["plan", "poses", "-o", "p.toml", "--like", "x" * 5000]) == 2


def test_a_pipe_as_a_token_file_keeps_nobody_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    save_model(drawn_model(), tmp_path / "m.json")
    ran = subprocess.run(
        [sys.executable, "-m", "clampid", "serve", tmp_path / "m.json", "--token-file", tmp_path / "pipe"],
        capture_output=True, text=True, timeout=60, check=False,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )  # fmt: skip
    assert ran.returncode == 2
    assert "expected a regular file" in ran.stderr


@pytest.mark.parametrize("sign", ["\u200b", "\u2060", "\u061c", "\xad", "\U000e0041", "\ufff9"])
def test_signs_that_nobody_sees_are_part_of_no_name(sign: str, tmp_path: Path) -> None:
    assert has_controls(f"a{sign}b")
    assert sign not in for_terminal(f"a{sign}b")
    save_model(drawn_model(), tmp_path / "m.json")
    text = (tmp_path / "m.json").read_text()
    (tmp_path / "m.json").write_text(text.replace('"name": "drawn"', json.dumps(f"a{sign}b").join(['"name": ', ""])))
    with pytest.raises(ModelError, match="expected printable text"):
        load_model(tmp_path / "m.json")


@pytest.mark.parametrize("cells", [((0, 1, 1e3),), ((0, 1, 1e3), (1, 0, 1e3))], ids=["one way", "too large"])
def test_a_matrix_that_is_no_covariance_is_refused(cells: tuple[tuple[int, int, float], ...], tmp_path: Path) -> None:
    save_model(drawn_model(), tmp_path / "m.json")
    load_model(tmp_path / "m.json")
    data = json.loads((tmp_path / "m.json").read_text())
    for k, j, value in cells:
        data["stages"]["poses"]["covariance"][k][j] = value
    (tmp_path / "m.json").write_text(json.dumps(data))
    with pytest.raises(ModelError, match="expected a covariance"):
        load_model(tmp_path / "m.json")


@pytest.fixture
def trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    (tmp_path / "own.py").write_text("EFFECT = 1\n")
    trust(tmp_path / "own.py")
    return trust_file()


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="owners and modes of POSIX")
def test_a_list_that_is_a_link_into_an_open_folder_is_refused(trusted: Path, tmp_path: Path) -> None:
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    trusted.rename(tmp_path / "open" / "list.json")
    trusted.symlink_to(tmp_path / "open" / "list.json")
    with pytest.raises(EffectError, match=r"open: expected it to be writable by you alone"):
        list_of_trusted()


def test_a_folder_in_the_place_of_the_list_is_named(trusted: Path) -> None:
    trusted.unlink()
    trusted.mkdir()
    with pytest.raises(EffectError, match=r"trusted_effects\.json"):
        list_of_trusted()


def test_a_library_without_the_function_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import casadi as ca

    if compiled.compiler() is None:
        pytest.skip("no C compiler")
    x, r = ca.SX.sym("x", 2), ca.SX.sym("r", 2)
    other = ca.Function("other", [x, r], [ca.densify(x * r)])
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    compiled.compile_rows(other)
    library = next((tmp_path / "clampid" / "compiled").glob("*.so"))
    monkeypatch.setattr(compiled, "_library", lambda *_: library)
    monkeypatch.setattr(compiled, "compile_function", lambda function: function)
    rows = compiled.compile_rows(ca.Function("wanted", [x, r], [ca.densify(x + r)]))
    assert isinstance(rows, compiled.Blocks)


def test_a_parquet_column_whose_name_is_no_text_is_refused(tmp_path: Path) -> None:
    arm = simulate(tmp_path / "arm", "ur10", seed=3, poses=8, tables=("poses",))
    good = (arm / "poses.parquet").read_bytes()
    (arm / "poses.parquet").write_bytes(good.replace(b"time_s", b"\x94ime_s"))
    with pytest.raises(CampaignError, match=r"poses\.parquet: expected a whole Parquet file"):
        read_campaign(arm)


@pytest.mark.parametrize("other", ["1e30", "9007199254740993", "-1e308"])
def test_an_imported_pose_beyond_all_integers_is_a_name(other: str, tmp_path: Path) -> None:
    from readers import MAPPING, POINTS

    (tmp_path / "map.toml").write_text(MAPPING)
    (tmp_path / "p.csv").write_text(POINTS.replace("\n1;", f"\n{other};").replace("\n2;", "\n9007199254740992;"))
    mapping = read_mapping(tmp_path / "map.toml", [tmp_path / "p.csv"])
    with np.errstate(all="raise"):
        (table,) = import_tables(mapping, load_robot("ur10"), ("T1",))
    assert table.frame["pose"].tolist() == [1, 2, 3, 4, 5]


def test_a_reading_that_is_a_device_is_refused(tmp_path: Path) -> None:
    (tmp_path / "1.csv").symlink_to("/dev/zero")
    instrument = FolderInstrument(tmp_path, reading_of({"columns": "X,Y,Z"}))
    with pytest.raises(InstrumentError, match=r"1\.csv: cannot be read"):
        instrument._sample(tmp_path / "1.csv", "T1")
