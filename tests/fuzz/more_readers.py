"""Readers of what a run, an instrument or another program wrote; as ``readers.py`` has those of what people write."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

Reader = Callable[[Path], object]
Known = dict[str, tuple[bytes, str, Reader]]
TESTS = Path(__file__).parents[1]
TRUTH = {"robot": "kuka_kr20_r1810", "seed": 0, "asked": ["backlash"], "hidden": [], "journal": "truth.journal.jsonl"}
READINGS = "t,X,Y,Z,Name,T\n" + "".join(f"{k / 10},1.0{k},2.0,0.5,T1,21.5\n" for k in range(8))
PAIRED = """format = "clampid-mapping/1"
units = {angle = "deg", length = "mm"}
table = "poses"
[columns]
time = {from = "t", unit = "s"}
x = {from = "X"}
y = {from = "Y"}
z = {from = "Z"}
q1 = {from = "A1"}
q2 = {from = "A2"}
q3 = {from = "A3"}
q4 = {from = "A4"}
q5 = {from = "A5"}
q6 = {from = "A6"}
target = {value = "T1"}
[pairing]
time = {from = "t", unit = "ms"}
[campaign]
robot = "kuka_kr20_r1810"
gravity_m_s2 = [0.0, 0.0, -9.81]
tool = {mass_kg = 12.0, com_m = [0.0, 0.0, 0.08]}
targets_m = {T1 = [0.10, 0.00, 0.12]}
instrument = {name = "laser tracker", position_std_m = 2e-5}
"""


def more_readers(folder: Path) -> Known:
    """Name → a good file, what it is called in its folder, and what reads it from there."""
    return {**_tables(folder), **_of_runs(folder), **_of_instruments(folder), **_two_logs(folder), **_of_models(folder)}


def table_of(name: str, targets: tuple[str, ...]) -> Reader:
    """What reads a table of that name of a robot with six joints, and nothing beside it."""
    from experiments.columns import table_format
    from experiments.tables import TableFile, read_table
    from experiments.validate import validate_table

    layout = table_format(name, 6)
    return lambda path: validate_table(read_table(path), layout, TableFile(path), targets)


def _tables(folder: Path) -> Known:
    sys.path.insert(0, str(TESTS / "campaign"))
    from campaign_maker import make_tables, write

    from experiments.campaign import read_campaign
    from experiments.checks.check import check_campaign

    def read(path: Path) -> object:
        return check_campaign(read_campaign(path.parent))

    known: Known = {}
    for name, table in make_tables().items():
        if name == "poses":
            continue
        for ending in ("csv", "parquet"):
            at = f"{name}-{ending}/{name}.{ending}"
            tables = {name: table} if name != "verification" else {"poses": make_tables()["poses"], name: table}
            write(folder / f"{name}-{ending}", tables, file_format=ending)
            good = (folder / at).read_bytes()
            known[f"{name}.{ending}"] = (good, at, table_of(name, ("T1", "T2", "T3")))
            known[f"checked {name}.{ending}"] = (good, at, read)
    return known


def _of_runs(folder: Path) -> Known:
    from experiments.links.eki_config import config_text
    from experiments.links.schema import MOTION
    from experiments.runs.folder import tables_of
    from experiments.runs.journal import Journal
    from experiments.virtual_controller.config import read_config
    from experiments.virtual_controller.journal import Journal as Truth
    from experiments.virtual_controller.journal import journal_file, read_events

    entries = [
        ("session", {"boot": 1, "clock": 0.0, "offset": 0.0, "at": [0.0] * 6}),
        ("move", {"key": ["poses", 1], "step": "pose 1", "clock": 1.0, "offset": 0.0, "boot": 1}),
        ("row", {"table": "poses", "key": ["poses", 1, 1, "T1"], "row": {"pose": 1, "visit": 1, "x_m": 0.5}}),
        ("log", {"table": "free_air", "key": ["free_air", 1], "columns": {"time_s": [0.0, 0.1], "q1_rad": [0.0, 0.1]}}),
        ("void", {"table": "clamped", "sweeps": [1]}),
        ("stopped", {"why": "a person said no"}),
    ]
    (folder / "run").mkdir()
    with Journal(folder / "run" / "journal.jsonl") as journal:
        for what, content in entries:
            journal.add(what, **content)

    def journal_of(path: Path) -> object:
        with Journal(path) as found:
            return tables_of(found.entries), list(found.of("stopped"))

    (folder / "truth").mkdir()
    (folder / "truth" / "truth.json").write_text(json.dumps(TRUTH))

    def truth(path: Path) -> object:
        return Truth(folder / "truth" / "truth.json", TRUTH["robot"], 0, TRUTH["asked"]).posture

    events = [{"event": "started", "boot": 1, "time": 0.0, "at": [0.0] * 6}, {"event": 4, "boot": 1, "time": 1.0}]
    lines = "".join(f"{json.dumps(event)}\n" for event in events).encode()
    own = str(journal_file(folder / "truth" / "truth.json").relative_to(folder))
    (folder / own).write_bytes(lines)
    return {
        "journal": ((folder / "run" / "journal.jsonl").read_bytes(), "run/journal.jsonl", journal_of),
        "truth": ((folder / "truth" / "truth.json").read_bytes(), "truth/truth.json", truth),
        "events": (lines, own, lambda path: read_events(folder / "truth" / "truth.json")),
        "channel": (config_text(MOTION).encode(), "motion.xml", lambda path: read_config(_text(path), path.name)),
    }


def _text(path: Path) -> str:
    from clampid.verbs.virtual_robot import _text as text_of

    return text_of(path)


def _of_instruments(folder: Path) -> Known:
    from experiments.instruments import instrument_of
    from experiments.instruments.folder import FolderInstrument, reading_of
    from experiments.instruments.line import LineInstrument

    (folder / "written").mkdir()
    query = {"columns": "X,Y,Z", "unit": "m", "targets": "T1,T2", "target": "Name", "temperatures": "ambient:T"}
    found = FolderInstrument(folder / "written", reading_of(query))

    class Told(LineInstrument):
        """Answers are what a file says."""

        def __init__(self, answer: bytes) -> None:
            self._where, self._socket, self.targets, self._answer = ("a", 1), None, ("T1",), answer

        def _exchange(self, line: str, patience: float) -> bytes:
            return self._answer

    good = json.dumps(
        {"target": "T1", "time_s": 1.0, "points_m": [[1.0, 2.0, 0.5]] * 8, "motor_C": [20.0] * 6}
    ).encode()

    def told(path: Path) -> object:
        instrument = Told(path.read_bytes())
        return instrument.measure("T1", 8, 0.05), instrument.temperatures()

    return {
        "readings": (READINGS.encode(), "written/1.csv", lambda path: found._sample(path, "T1")),
        "answer": (good, "answer.json", told),
        "address": (
            b"folder:written?columns=X,Y,Z&unit=mm&targets=T1,T2&target=Name&temperatures=a:T&separator=;&decimal=,",
            "address.txt",
            lambda path: instrument_of(os.fsdecode(path.read_bytes())),
        ),
    }


def _two_logs(folder: Path) -> Known:
    sys.path.insert(0, str(TESTS / "pairing"))
    import log_maker

    from experiments.foreign import import_tables, read_mapping, two_logs
    from experiments.foreign.files import read_cells
    from kinematics import forward, load_robot

    robot = load_robot("kuka_kr20_r1810")

    def tracked(q: np.ndarray) -> np.ndarray:
        poses = forward(robot.screws, robot.flange, q @ robot.linkage.T)
        return poses[:, :3, :3] @ [0.101, -0.002, 0.12] + poses[:, :3, 3] + [3.0, 1.0, 0.5]

    made = log_maker.make_logs(5, poses=6, rate=5.0, robot_rate=5.0, point=tracked)
    place = folder / "logs"
    place.mkdir()
    tracker = pd.DataFrame(np.c_[made.time, 1e3 * made.points].round(4), columns=["t", "X", "Y", "Z"])
    names = ["t", *(f"A{i}" for i in range(1, 7))]
    angles = pd.DataFrame(np.c_[1e3 * made.robot_time, np.rad2deg(made.joints)].round(5), columns=names)
    tracker.to_csv(place / "tracker.csv", index=False)
    angles.to_csv(place / "robot.csv", index=False)
    (place / "mapping.toml").write_text(PAIRED)

    def read(path: Path) -> object:
        mapping = read_mapping(place / "mapping.toml", [place / "tracker.csv", place / "robot.csv"])
        return import_tables(mapping, robot, ("T1",))

    good = read_mapping(place / "mapping.toml", [place / "tracker.csv", place / "robot.csv"])
    part = good.tables[0]
    assert part.pairing is not None
    log = part.pairing

    def mapping(path: Path) -> object:
        return read_mapping(path, [place / "tracker.csv", place / "robot.csv"])

    def seen(path: Path) -> object:
        cells = read_cells(part.files, part.reading)
        time = two_logs._times(good.path, part.columns.get("time"), cells, "columns.time")
        return time, two_logs._points(good.path, part, cells)

    def driven(path: Path) -> object:
        cells = read_cells(log.files, log.reading)
        time = two_logs._times(good.path, log.time, cells, "pairing.time")
        return time, two_logs._joints(good.path, part, cells, robot)

    tracker_csv, robot_csv = (place / "tracker.csv").read_bytes(), (place / "robot.csv").read_bytes()
    return {
        "pairing": (PAIRED.encode(), "logs/mapping.toml", mapping),
        "tracker's log": (tracker_csv, "logs/tracker.csv", seen),
        "robot's log": (robot_csv, "logs/robot.csv", driven),
        "paired mapping": (PAIRED.encode(), "logs/mapping.toml", read),
        "paired tracker's log": (tracker_csv, "logs/tracker.csv", read),
        "paired robot's log": (robot_csv, "logs/robot.csv", read),
    }


def _of_models(folder: Path) -> Known:
    from clampid.catalogue import with_user_effects
    from clampid.diagnosis.effect_new import effect_text
    from clampid.identification.identify import identify
    from clampid.loop.until import parse_until
    from clampid.models.model import load_model, save_model
    from clampid.verbs.output import Output
    from experiments.campaign import read_campaign
    from experiments.simulate import simulate
    from offline_ik.verbs.serve import _token

    out = Output(quiet=True, json=None, verbose=False)

    def code(path: Path) -> object:
        if re.search(rb"\d[\d_]{3,}|\d[eE]\d", path.read_bytes()):  # a program that asks for much gets much
            return None
        return with_user_effects(path)

    def token(path: Path) -> object:
        path.chmod(0o600)
        return _token(path, out)

    effect = effect_text("own_rate", ["q4"], "joint4", stage="poses", joints=6)
    until = b"std(backlash.gap@joint2) < 5 arcsec and std(geometry.base_x@base) < 10 um"
    campaign = read_campaign(simulate(folder / "free", "ur10", seed=1, tables=("free_air",)))
    torques = {"free_air": ("gravity", "coulomb_friction", "viscous_friction")}
    save_model(identify(campaign, torques), folder / "torques.json")
    return {
        "torque model": ((folder / "torques.json").read_bytes(), "torques.json", load_model),
        "effect": (effect.encode(), "own_effect.py", code),
        "until": (until, "until.txt", lambda path: parse_until(os.fsdecode(path.read_bytes()))),
        "token": (b"a-token-of-many-letters-0123456789\n", "token.txt", token),
    }
