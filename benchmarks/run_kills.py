"""Kills the runner, the controller, the network and the instrument at random moments, resumes, and counts.

Every process is real: the virtual controller, and the runner, which is killed with SIGKILL. The controller's own
journal of what moved is the truth. ``python benchmarks/run_kills.py --kills 200`` takes about ten minutes.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import signal
import socket
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from experiments.plans import Plan, PlanError
from experiments.runs.errors import RunStopped
from experiments.runs.folder import tables_of, work_folder
from experiments.runs.intended import targets_of
from experiments.runs.journal import whole_lines
from experiments.runs.runner import run

KINDS = ("runner", "controller", "network", "instrument")


@dataclass
class Counts:
    """What a campaign of kills did."""

    kills: Counter[str] = field(default_factory=Counter)
    sessions: int = 0
    lost: int = 0
    twice: int = 0
    executed_twice: int = 0
    unintended: int = 0
    rows: int = 0
    expected: int = 0

    def harm(self) -> int:
        return self.lost + self.twice + self.executed_twice + self.unintended + abs(self.rows - self.expected)


class Relay:
    """Passes a TCP connection on, until it is cut."""

    def __init__(self, port: int) -> None:
        self.to, self.server = port, socket.create_server(("127.0.0.1", 0))
        self.port = self.server.getsockname()[1]
        self.open: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                one, _ = self.server.accept()
            except OSError:
                return
            try:
                other = socket.create_connection(("127.0.0.1", self.to), 2)
            except OSError:
                one.close()
                continue
            self.open += [one, other]
            for a, b in ((one, other), (other, one)):
                threading.Thread(target=self._pass, args=(a, b), daemon=True).start()

    def _pass(self, one: socket.socket, other: socket.socket) -> None:
        try:
            while data := one.recv(65536):
                other.sendall(data)
        except OSError:
            pass
        for each in (one, other):
            each.close()

    def cut(self) -> None:
        for each in self.open:
            try:
                each.shutdown(socket.SHUT_RDWR)
            except OSError:
                continue
        self.open.clear()


def keys_of(entries: list[dict[str, Any]]) -> Counter[tuple[Any, ...]]:
    """Rows that a journal holds, by key, those that were declared void left out."""
    found: Counter[tuple[Any, ...]] = Counter()
    for entry in entries:
        if entry["what"] == "row":
            found[tuple(entry["key"])] += 1
        elif entry["what"] == "log":
            found["log", entry["run"], entry["move"]] += 1
        elif entry["what"] == "void":
            for key in [k for k in found if k[0] == "clamped" and k[1] in entry["sweeps"]]:
                del found[key]
    return found


def voided(entries: list[dict[str, Any]]) -> set[int]:
    return {number for entry in entries if entry["what"] == "void" for number in entry["sweeps"]}


def _session(plan: Plan, folder: Path, asked: Callable[[], Any]) -> None:
    """One runner, in a process of its own."""
    try:
        run(plan, folder, asked())
    except PlanError as error:
        print(f"refused: {error}", file=sys.stderr, flush=True)
        os._exit(2)
    except (RunStopped, ValueError):
        os._exit(3)
    os._exit(0)


def wanted_keys(plan: Plan) -> set[tuple[Any, ...]]:
    visits = {(v.table, v.pose, v.visit, t) for v in plan.visits for t in v.targets}
    moves = {("log", n, m) for n, r in enumerate(plan.runs, 1) for m in range(1, len(r.course.duration) + 1)}
    steps = {("clamped", n, k) for n, s in enumerate(plan.sweeps, 1) for k in range(1, len(s.offset) + 1)}
    return visits | moves | steps


def kill_and_resume(
    controller: Any,
    plan: Plan,
    folder: Path,
    kills: int,
    seed: int,
    longest: float = 1.5,
    kinds: tuple[str, ...] = KINDS,
) -> Counts:
    """Run a plan with so many kills; ``controller`` is that of tests/runs/conftest.py."""
    counts, rng, context = Counts(), random.Random(seed), multiprocessing.get_context("fork")
    relay = Relay(controller.ports["tracker"])
    journal = work_folder(folder) / "journal.jsonl"
    before: Counter[tuple[Any, ...]] = Counter()
    first = True
    while True:

        def asked(resume: bool = not first) -> Any:
            made = controller.asked(resume=resume and journal.is_file())
            from experiments.instruments import connect_instrument

            made.instrument = lambda: connect_instrument(f"tcp://127.0.0.1:{relay.port}")
            return made

        process = context.Process(target=_session, args=(plan, folder, asked))
        process.start()
        counts.sessions += 1
        first = False
        while sum(counts.kills.values()) < kills:
            process.join(rng.uniform(0.05, longest))
            if not process.is_alive():
                break
            kind = rng.choice(kinds)
            _strike(kind, controller, process, relay)
            counts.kills[kind] += 1
            if kind in ("runner", "controller"):
                break
        process.join(120)
        if process.is_alive():
            process.kill()
            raise TimeoutError("a session did not end")
        entries = whole_lines(journal.read_bytes())[0] if journal.is_file() else []
        if entries:
            now = keys_of(entries)
            gone = before - now
            counts.lost += sum(n for key, n in gone.items() if not (key[0] == "clamped" and key[1] in voided(entries)))
            before = now
        # Killed between its end and its exit, a run leaves its campaign and no work folder; a second call is refused.
        if process.exitcode == 0 or (any((folder / "journals").glob("*.jsonl")) and not work_folder(folder).exists()):
            break
        if process.exitcode == 2:
            raise RuntimeError("the call was refused: nothing would ever be measured")
    relay.server.close()
    final = whole_lines(next((folder / "journals").glob("*.jsonl")).read_bytes())[0]
    found, wanted = keys_of(final), wanted_keys(plan)
    counts.expected, counts.rows = len(wanted), len(found.keys() & wanted)
    counts.twice += sum(n - 1 for n in found.values()) + len(found.keys() - wanted)
    counts.executed_twice = sum(n - 1 for n in controller.executions().values())
    allowed = np.array(targets_of(plan))
    for event in controller.journal():
        if event["event"] == 1:
            for point in event["points"]:
                if np.min(np.max(np.abs(allowed - np.radians(point)), axis=1)) > 1e-6:
                    counts.unintended += 1
    assert sum(len(frame) for frame in tables_of(final).values()) > 0
    return counts


def _strike(kind: str, controller: Any, process: Any, relay: Relay) -> None:
    if kind == "runner":
        os.kill(process.pid, signal.SIGKILL)
    elif kind == "controller":
        controller.kill()
        controller.start()
    elif kind == "network":
        controller.operate("kill-link")
    else:
        relay.cut()


def main() -> None:
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "runs"))
    from run_controller import CLAMPED, Controller, clamping_plan, free_air_plan, poses_plan

    from experiments.plans import cell_of, limits_of

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    cell = cell_of("kuka_kr20_r1810")[0]
    limits = limits_of(cell.robot)[0]
    plans = [poses_plan(cell, limits, 40), free_air_plan(cell, limits, 10)]
    plans.append(clamping_plan(cell, limits, [(1, joint, CLAMPED) for joint in (1, 2, 1, 2)]))
    done = number = 0
    total = Counts()
    while done < given.kills:
        with tempfile.TemporaryDirectory() as place:
            speed = "20" if number % 3 else "50"
            controller = Controller(Path(place) / "truth.json", ("--speed", speed, "--seed", "3")).start()
            try:
                found = kill_and_resume(controller, plans[number % 3], Path(place) / "C", 20, given.seed + number, 1.0)
            finally:
                controller.stop()
        number += 1
        done += sum(found.kills.values())
        for name in ("lost", "twice", "executed_twice", "unintended", "rows", "expected", "sessions"):
            setattr(total, name, getattr(total, name) + getattr(found, name))
        total.kills += found.kills
        print(f"{done} kills: {total}", flush=True)


if __name__ == "__main__":
    main()
