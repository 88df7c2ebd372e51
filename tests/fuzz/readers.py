"""Every reader of a file, with a file that it takes; run as a program it reads spoilt ones and says what came of it."""

from __future__ import annotations

import functools
import gc
import json
import os
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from more_readers import more_readers, table_of
from spoil import misstated, spoilt

ROOT = Path(__file__).parents[2]
SECONDS = 10.0
MEMORY = "/dev/shm" if os.path.isdir("/dev/shm") else None  # a disk takes longer than most readers


def share_of(name: str, whole: bool = False) -> int:
    """How many spoilt files a reader gets in one of the two runs of the slow tests; ``whole``: in the run by hand.

    Each reader of a file gets 1000 in both runs together, which take half a minute each of one quiet core, and 10 000
    in the run by hand.
    Readers called ``checked`` or ``paired``, and ``arm``, read nothing that the others do not: they go on to what is
    worked out of a file (fits, pairing, a compiled arm), 10 to 90 ms each. 10 000 of each would take more than an hour.
    """
    if name.startswith(("checked ", "paired ")) or name == "arm":
        return 500 if whole else 25
    return 10_000 if whole else 500


MAPPING = """format = "clampid-mapping/1"
table = "poses"
delimiter = ";"
decimal = ","
repeats = "median"

[columns]
pose = {from = "Point"}
target = {value = "T1"}
q1 = {from = "J1", unit = "deg", scale = -1}
q2 = {from = "J2", unit = "deg"}
q3 = {from = "J3", unit = "deg"}
q4 = {from = "J4", unit = "deg"}
q5 = {from = "J5", unit = "deg"}
q6 = {from = "J6", unit = "deg"}
x = {from = "X", unit = "mm"}
y = {from = "Y", unit = "mm"}
z = {from = "Z", unit = "mm"}

[campaign]
robot = "ur10"
gravity_m_s2 = [0.0, 0.0, -9.81]
tool = {mass_kg = 12.0, com_m = [0.0, 0.0, 0.08]}
targets_m = {T1 = [0.10, 0.00, 0.12]}
instrument = {name = "tracker", position_std_m = 5e-5}
"""
POINTS = "Point;J1;J2;J3;J4;J5;J6;X;Y;Z\n" + "".join(
    f"{k};1{k},5;-2{k};3{k};{k};{k}5;0;{1000 + k},25;{k}00;500\n" for k in range(1, 6)
)
PEAKS = "gamma_rad,delta_rad,r_m,two_theta_rad,std_two_theta_rad\n" + "0.1,0.2,0.8,0.22,1e-5\n0.2,0.1,0.8,0.2,1e-5\n"
TOUCHED = """format = "clampid-touched/1"
robot = "ur10"
touches = "touches.csv"
gravity_m_s2 = [0.0, 0.0, -9.81]
[targets_m]
tip = [0.0, 0.0, 0.1]
[instrument]
position_std_m = 2e-5
[features.table]
kind = "plane"
point_m = [0.0, 0.0, 0.0]
normal = [0.0, 0.0, 1.0]
[features.ball]
kind = "sphere"
centre_m = [0.8, 0.2, 0.1]
radius_m = 0.02
"""
TOUCHES = "feature,q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad\n" + "table,0.1,-1.0,1.0,0.2,0.3,0.1\n" * 3
OBSTACLES = """[[box]]
centre_m = [1.0, 0.0, 0.2]
size_m = [0.2, 0.2, 0.4]
[[sphere]]
centre_m = [1.0, 1.0, 0.2]
radius_m = 0.1
[[cylinder]]
centre_m = [1.0, 1.0, 0.2]
radius_m = 0.1
length_m = 0.5
turn_rad = [0.1, 0.0, 0.0]
"""
MESH = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
STL = "solid a\n" + "facet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 1\nendloop\nendfacet\n" * 2

Reader = Callable[[Path], object]


def readers(folder: Path) -> dict[str, tuple[bytes, str, Reader]]:
    """Name → a good file, what it is called in its folder, and what reads it from there."""
    sys.path.insert(0, str(ROOT / "benchmarks"))
    from ik_arms import CELL, drawn_model

    from clampid.exports.dh_export import dh_table, read_dh, table_text
    from clampid.models.model import load_model, save_model
    from clampid.planning.free_air import plan_free_air
    from clampid.planning.logs import torque_noise_of
    from clampid.planning.obstacle_files import read_obstacles
    from clampid.planning.program import LogWishes
    from clampid.trusted import list_of_trusted, trust, trust_file
    from experiments.campaign import read_campaign
    from experiments.checks.check import check_campaign
    from experiments.foreign import import_tables, read_mapping
    from experiments.header import read_header
    from experiments.plans import cell_of, limits_of, read_plan, write_plan
    from experiments.simulate import simulate
    from experiments.touched import read_touched
    from kinematics.collision.mesh import read_mesh
    from kinematics.description import load_robot
    from kinematics.kuka_text import machine_data_text, read_machine_data
    from offline_ik.arm.identified import arm_of
    from offline_ik.cell.cell import read_cell
    from offline_ik.reflections.peak_table import read_peaks

    arm = simulate(folder / "arm", "ur10", seed=3, poses=8, tables=("poses",), file_format="csv")
    parquet = simulate(folder / "arm2", "ur10", seed=3, poses=8, tables=("poses",))
    save_model(drawn_model(effects=("geometry", "joint_compliance", "backlash")), folder / "large.json")
    save_model(drawn_model(effects=("joint_compliance", "backlash")), folder / "model.json")
    cell, robot = cell_of("kuka_kr20_r1810")[0], load_robot("kuka_kr20_r1810")
    plan = plan_free_air(cell, limits_of(robot)[0], torque_noise_of(cell, None, None)[0], LogWishes(time=60.0))
    write_plan(plan, folder / "plan.toml")
    os.environ["XDG_CONFIG_HOME"] = str(folder / "config")
    (folder / "own.py").write_text("EFFECT = 1\n")
    trust(folder / "own.py")
    (folder / "p.csv").write_text(POINTS)
    (folder / "map.toml").write_text(MAPPING)
    (folder / "touched.toml").write_text(TOUCHED)
    (folder / "touches.csv").write_text(TOUCHES)

    def campaign(path: Path) -> object:
        return check_campaign(read_campaign(path.parent))

    named, good_mapping = load_robot("ur10"), read_mapping(folder / "map.toml", [folder / "p.csv"])

    def imported(path: Path) -> object:
        return import_tables(read_mapping(path, [folder / "p.csv"]), named, ("T1",))

    from kinematics.kuka import nominal_machine_data

    description = (ROOT / "appendix_data" / "robots" / "kuka_kr20_r1810.toml").read_bytes()
    data = machine_data_text(nominal_machine_data(robot), {})
    table = table_text(dh_table(drawn_model(), "hayati"))
    return {
        "model": ((folder / "model.json").read_bytes(), "model.json", load_model),
        "campaign.toml": (
            (arm / "campaign.toml").read_bytes(),
            "arm/campaign.toml",
            lambda path: read_header(path.parent),
        ),
        "poses.csv": ((arm / "poses.csv").read_bytes(), "arm/poses.csv", table_of("poses", ("T1", "T2", "T3"))),
        "poses.parquet": (
            (parquet / "poses.parquet").read_bytes(),
            "arm2/poses.parquet",
            table_of("poses", ("T1", "T2", "T3")),
        ),
        "checked campaign.toml": ((arm / "campaign.toml").read_bytes(), "arm/campaign.toml", campaign),
        "checked poses.csv": ((arm / "poses.csv").read_bytes(), "arm/poses.csv", campaign),
        "checked poses.parquet": ((parquet / "poses.parquet").read_bytes(), "arm2/poses.parquet", campaign),
        "arm": ((folder / "large.json").read_bytes(), "large.json", lambda path: arm_of(load_model(path))),
        "robot": (description, "robot.toml", load_robot),
        "urdf": (_urdf(robot), "robot.urdf", load_robot),
        "plan": ((folder / "plan.toml").read_bytes(), "plan.toml", read_plan),
        "mapping": (MAPPING.encode(), "map.toml", imported),
        "points": (POINTS.encode(), "p.csv", lambda path: import_tables(good_mapping, named, ("T1",))),
        "cell": (CELL.encode(), "cell.toml", lambda path: read_cell(path, robot)),
        "touched": (TOUCHED.encode(), "touched.toml", read_touched),
        "touches": (TOUCHES.encode(), "touches.csv", lambda path: read_touched(folder / "touched.toml")),
        "peaks": (PEAKS.encode(), "peaks.csv", lambda path: read_peaks(path, 6, 1e-4)),
        "obstacles": (OBSTACLES.encode(), "obstacles.toml", read_obstacles),
        "obj": (MESH.encode(), "mesh.obj", read_mesh),
        "stl": (STL.encode(), "mesh.stl", read_mesh),
        "trusted": (trust_file().read_bytes(), "config/clampid/trusted_effects.json", lambda path: list_of_trusted()),
        "dh": (table.encode(), "dh.csv", lambda path: read_dh(path.read_text("utf-8", "replace"))),
        **more_readers(folder),
        "machine data": (data.encode(), "m.dat", lambda path: read_machine_data(path.read_text("utf-8", "replace"))),
    }


def _urdf(robot: Any) -> bytes:
    from kinematics.poe import forward
    from kinematics.urdf import write_urdf

    home = forward(robot.screws, robot.flange, np.zeros((1, robot.n)))[0]
    return write_urdf(robot.screws, home, robot).encode()


def misspelt(name: str, at: str, good: bytes, seed: int) -> bytes:
    """The file with other values, where its syntax is one that can be written."""
    if name == "journal":
        return miswritten(good, seed)
    said = Path(at).suffix in (".toml", ".json", ".csv") and name not in ("points", "dh", "answer")
    return misstated(good, seed, at) if said else spoilt(good, seed)


def miswritten(good: bytes, seed: int) -> bytes:
    """A journal with right checksums and entries that no run wrote."""
    from experiments.runs.journal import line_of, whole_lines

    entries = json.dumps(whole_lines(good)[0]).encode()
    found = json.loads(misstated(entries, seed, "journal.json"))
    lines = []
    for entry in found:
        try:
            lines.append(line_of(entry))
        except ValueError:  # no number of a journal
            lines.append(b"0" * 8 + b" {}\n")
    return b"".join(lines)


def is_refusal(error: Exception) -> bool:
    """Whether an error says what is wrong with a file: exit code 2 and one line."""
    from clampid.verbs.errors import is_wrong_input
    from experiments.instruments import InstrumentError
    from experiments.links.protocol import LinkError
    from experiments.virtual_controller.errors import ControllerError
    from kinematics.collision.mesh import MeshError
    from kinematics.kuka import MachineDataError

    # Verbs make wrong calls of the last three.
    known = (MeshError, MachineDataError, InstrumentError, LinkError, ControllerError)
    return is_wrong_input(error) or isinstance(error, known)


def outcomes(names: list[str], count: int | str, seed: int) -> Iterator[dict[str, Any]]:
    """Read spoilt files; what was neither read nor refused in words, and the counts of each reader.

    ``count`` is of each reader; ``share`` and ``whole``: what `share_of` says.
    """

    def late(*_: object) -> None:
        raise TimeoutError(f"not read within {SECONDS:g} s")

    from kinematics import description

    signal.signal(signal.SIGALRM, late)
    with tempfile.TemporaryDirectory(dir=MEMORY) as place:
        folder = Path(place)
        every = readers(folder)
        warnings.simplefilter("error", RuntimeWarning)  # a user would see its lines
        warnings.simplefilter("ignore", SyntaxWarning)  # of spoilt effect files, which are code
        description._parse = functools.lru_cache(maxsize=4)(description._parse)  # the robots that good files name
        gc.collect()
        gc.freeze()  # what is imported need not be looked at again and again
        for name in names or list(every):
            good, at, read = every[name]
            counts: Counter[str] = Counter()
            slowest = 0.0
            read(_put(folder / at, good))  # as it is, it is read
            for k in range(share_of(name, count == "whole") if isinstance(count, str) else count):
                number = seed * 1_000_003 + k
                path = _put(folder / at, misspelt(name, at, good, number) if k % 2 else spoilt(good, number))
                print(json.dumps({"trying": name, "seed": number}), flush=True)  # the last one, if a signal ends it
                begun = time.monotonic()
                signal.setitimer(signal.ITIMER_REAL, SECONDS)
                try:
                    read(path)
                    counts["read"] += 1
                except Exception as error:
                    refused = is_refusal(error)
                    counts["refused" if refused else "bad"] += 1
                    if not refused:
                        said = f"{type(error).__name__}: {str(error)[:200]}"
                        yield {"reader": name, "seed": number, "error": said, "at": _line_of(error)}
                finally:
                    signal.setitimer(signal.ITIMER_REAL, 0)
                slowest = max(slowest, time.monotonic() - begun)
            _put(folder / at, good)
            memory = most_memory()
            yield {"counts": name, **counts, "slowest_s": round(slowest, 2), "memory_MB": memory}


def most_memory() -> int:
    """The most memory of this program, MB. A child of a large process would begin with that one's ``ru_maxrss``."""
    status = Path("/proc/self/status")
    if status.exists():
        found = next((line for line in status.read_text().splitlines() if line.startswith("VmHWM:")), None)
        if found is not None:
            return int(found.split()[1]) // 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


def _line_of(error: Exception) -> str:
    where = error.__traceback__
    while where is not None and where.tb_next is not None:
        where = where.tb_next
    return f"{where.tb_frame.f_code.co_filename}:{where.tb_lineno}" if where else ""


def _put(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for found in outcomes(
        sys.argv[3:], sys.argv[1] if sys.argv[1] in ("share", "whole") else int(sys.argv[1]), int(sys.argv[2])
    ):
        print(json.dumps(found), flush=True)
