"""The detector over the sockets: a beamline client, the server, EthernetKRL, a virtual controller, and an instrument.

    python benchmarks/detector_link.py [--seed 3] [--positions 78] [--poses 250] [--hours 6] [--speed 50]

A KR20 with hidden geometry, springs, clearances and warm-up is measured by its own campaign and identified. The same
robot then stands behind the virtual controller, cold. `clampid serve` moves it to positions on an eighth of a sphere; a
simulated tracker says where the detector is. Once more with each effect left out of the model says what it is worth.
Then the arm moves for hours, and positions are measured each hour, with the temperatures of now told to the server and
with those of the beginning.

Where the detector should be follows here from the definition of the angles, not from the program's own functions.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from detector_sphere import EFFECTS, HEIGHT, ROBOT, R, octant

from clampid.identification.identify import identify
from clampid.models.model import Model, save_model
from experiments.campaign import Campaign, read_campaign
from experiments.simulate import simulate
from offline_ik.cell.cell import default_cell
from offline_ik.inverse.opening import open_detector

POINTS = 25  # of the instrument, averaged
QUICK = 1000  # simulated seconds in a second, while the arm only warms up
TEMPERATURES = ("link", "motor")


class Lines:
    """A connection of lines out and JSON lines in."""

    def __init__(self, address: str) -> None:
        host, port = address.rsplit(":", 1)
        self._socket = socket.create_connection((host, int(port)), timeout=600.0)
        self._file = self._socket.makefile("rb")

    def ask(self, line: str) -> dict[str, Any]:
        self._socket.sendall(line.encode() + b"\n")
        answer = json.loads(self._file.readline())
        if answer.get("ok") is False or "error" in answer:
            raise RuntimeError(f"{line}: {answer}")
        return dict(answer)

    def close(self) -> None:
        self._file.close()
        self._socket.close()


@contextmanager
def program(*arguments: str, lines: int = 1) -> Iterator[dict[str, str]]:
    """A process of this suite, and the addresses that it says it listens on."""
    command = [sys.executable, "-m", "clampid", *arguments]
    with (
        tempfile.TemporaryFile("w+") as errors,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True) as process,
    ):
        try:
            assert process.stdout is not None
            said = [process.stdout.readline().split() for _ in range(lines)]
            if not all(said):
                errors.seek(0)
                raise RuntimeError(f"{arguments[0]} did not start: {errors.read()}")
            yield {words[0]: words[-1] for words in said}
        finally:
            process.terminate()


@dataclass(frozen=True)
class Bench:
    """The robot's controller with its instrument and operator, and where detector and targets should be."""

    controller: str
    tracker: Lines
    operator: Lines
    campaign: Campaign
    frame: np.ndarray  # (4, 4): the robot's base in the instrument's frame, as identified; it only places the octant

    def temperatures(self) -> dict[str, list[float]]:
        said = self.tracker.ask("temperatures")
        return {kind: said[f"{kind}_C"] for kind in TEMPERATURES}

    def measured(self) -> np.ndarray:
        """Where the targets are ``(targets, 3)``, m, instrument frame."""
        seen = [self.tracker.ask(f"measure {POINTS} {name}")["points_m"] for name in self.campaign.targets]
        return np.array([np.median(points, axis=0) for points in seen])


def rigid(nominal: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """The motion ``(4, 4)`` that brings points ``(t, 3)`` best onto others; Arun, Huang & Blostein (1987)."""
    a, b = nominal.mean(axis=0), seen.mean(axis=0)
    U, _, Vt = np.linalg.svd((nominal - a).T @ (seen - b))
    turn = Vt.T @ np.diag([1.0, 1.0, np.linalg.det(Vt.T @ U.T)]) @ U.T
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = turn, b - turn @ a
    return out


def direction(gamma: float, delta: float, beam: np.ndarray, up: np.ndarray) -> np.ndarray:
    """From the sample to the detector ``(3,)``; `thesis` in docs/how-to/point-the-detector.md."""
    x = np.cross(up, beam)
    return np.sin(gamma) * np.cos(delta) * x + np.sin(delta) * up + np.cos(gamma) * np.cos(delta) * beam


def cell_text(campaign: Campaign, frame: np.ndarray) -> tuple[str, np.ndarray, np.ndarray, np.ndarray]:
    """A cell file with the octant in the instrument's frame; its beam, up and sample there."""
    usual = default_cell(campaign.robot).convention
    beam, up = (frame[:3, :3] @ np.asarray(v) for v in (usual.beam, usual.up))
    sample = frame[:3, :3] @ np.asarray(usual.sample) + frame[:3, 3]
    targets = ", ".join(f"{name} = {list(map(float, at))}" for name, at in campaign.targets.items())
    text = f"""format = "clampid-cell/1"
robot = "{ROBOT}"
gravity_m_s2 = {campaign.gravity.tolist()}
[convention]
name = "thesis"
beam = {beam.tolist()}
up = {up.tolist()}
sample_m = {sample.tolist()}
frame = "instrument"
[detector]
position_m = [0.0, 0.0, {HEIGHT}]
size_m = [0.1, 0.1, 0.02]
targets_m = {{{targets}}}
[tool]
mass_kg = {campaign.tool.mass}
com_m = {campaign.tool.com.tolist()}
"""
    return text, beam, up, sample


def variants(model: Model) -> dict[str, Model]:
    """The model, the model without each effect, and with nothing but its place in the room and its targets."""

    def with_only(kept: Sequence[bool]) -> Model:
        stage = model.stages["poses"]
        return model.with_stage(replace(stage, theta=np.where(kept, stage.theta, 0.0)))

    slots = model.stages["poses"].slots
    placed = [s.parameter.startswith(("base_", "target_")) for s in slots]
    out = {"full model": model}
    for effect in EFFECTS:
        kept = [s.effect != effect or p for s, p in zip(slots, placed, strict=True)]
        out[f"without {effect}"] = with_only(kept)
    return {**out, "nominal": with_only(placed)}


def visited(
    bench: Bench, server: Lines, angles: np.ndarray, at: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> np.ndarray:
    """Errors along the sphere and along the line of sight ``(k, 2)``, m, of the positions that can be reached."""
    beam, up, sample = at
    nominal = np.array([*bench.campaign.targets.values()], dtype=float)
    middle = np.array([0.0, 0.0, HEIGHT, 1.0])
    out = []
    for gamma, delta in angles.tolist():
        answer = server.ask(f"move gamma={gamma!r} delta={delta!r} r={R!r} wait=yes")
        if not answer.get("reachable", True) or answer.get("ended", {}).get("how", "arrived") != "arrived":
            continue
        found = (rigid(nominal, bench.measured()) @ middle)[:3]
        way = direction(gamma, delta, beam, up)
        off = found - (sample + R * way)
        radial = float(off @ way)
        out.append((float(np.linalg.norm(off - radial * way)), abs(radial)))
    return np.array(out).reshape(-1, 2)


@contextmanager
def served(bench: Bench, model: Model, cell: Path, folder: Path) -> Iterator[Lines]:
    """The server of a model, with the temperatures of now."""
    file = folder / "served.json"
    save_model(model, file)
    with program("serve", str(file), "--cell", str(cell), "--link", f"eki://{bench.controller}", "--listen",
                 "127.0.0.1:0", "-q") as said:  # fmt: skip
        server = Lines(said["listening"])
        server.ask("hello name=benchmark")
        tell(server, bench.temperatures())
        yield server
        server.close()


def tell(server: Lines, temperatures: dict[str, list[float]]) -> None:
    pairs = " ".join(f"{kind}={','.join(map(repr, values))}" for kind, values in temperatures.items())
    server.ask(f"temperature {pairs}")


def warmed(bench: Bench, server: Lines, seconds: float, speed: float) -> None:
    """Let the arm move between two far positions for so many simulated seconds."""
    bench.operator.ask(f"speed {QUICK}")
    until = bench.operator.ask("state")["time_s"] + seconds
    while bench.operator.ask("state")["time_s"] < until:
        for gamma, delta in ((0.2, 0.2), (1.2, 0.9)):
            server.ask(f"move gamma={gamma} delta={delta} r={R} wait=yes")
    bench.operator.ask(f"speed {speed:g}")


def line(name: str, found: np.ndarray) -> str:
    if not len(found):
        return f"  {name:32} no position was reached"
    along, radial = 1e6 * found.mean(axis=0)
    return f"  {name:32} {len(found):3} positions, along the sphere {along:7.0f} µm, radial {radial:7.0f} µm (means)"


def main() -> None:
    """Print a line per model, then a line per hour."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--positions", type=int, default=78)
    parser.add_argument("--poses", type=int, default=250, help="of the campaign")
    parser.add_argument("--hours", type=int, default=6)
    parser.add_argument("--speed", type=float, default=50.0, help="simulated seconds in a second")
    parser.add_argument("--only-full", action="store_true", help="no effect left out")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        simulate(folder / "arm", hidden=["thermal_expansion"], seed=given.seed, poses=given.poses)
        campaign = read_campaign(folder / "arm")
        model = identify([campaign], {"poses": EFFECTS})
        frame = open_detector(model).arm.base
        text, *at = cell_text(campaign, frame)
        cell = folder / "cell.toml"
        cell.write_text(text, encoding="utf-8")
        angles = octant(given.positions, given.seed)
        with program("virtual-robot", "--seed", str(given.seed), "--hide", "thermal_expansion", "--speed",
                     f"{given.speed:g}", "--listen", "127.0.0.1:0", "--tracker", "127.0.0.1:0", "--operator",
                     "127.0.0.1:0", lines=3) as said:  # fmt: skip
            bench = Bench(said["listening"], Lines(said["tracker"]), Lines(said["operator"]), campaign, frame)
            for label, variant in variants(model).items():
                if label not in ("full model", "nominal") and given.only_full:
                    continue
                with served(bench, variant, cell, folder) as server:
                    print(line(label, visited(bench, server, angles, (at[0], at[1], at[2]))), flush=True)
            if not given.hours:
                return
            some = angles[: max(len(angles) // 6, 1)]
            with served(bench, model, cell, folder) as server:
                cold = bench.temperatures()
                for hour in range(given.hours + 1):
                    for way, temperatures in (("told now", bench.temperatures()), ("as at first", cold)):
                        tell(server, temperatures)
                        found = visited(bench, server, some, (at[0], at[1], at[2]))
                        print(line(f"hour {hour}, temperatures {way}", found), flush=True)
                    if hour < given.hours:
                        warmed(bench, server, 3600.0, given.speed)


if __name__ == "__main__":
    main()
