"""Verbs in processes that are killed or find the disk full; run as a program, it says what was found after each.

The program imports everything once and forks a child for each trial, so that a trial costs its own work alone.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

Call = Callable[[], int]
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT
EVENTS = frozenset({"os.rename", "os.link", "os.mkdir", "os.rmdir", "os.remove", "os.chmod", "os.truncate"})
OLD = {
    "m.json": '{"format": "clampid-model/0"}',
    "r.json": '{"old": 1}',
    "m.diagnosis.json": '{"format": "clampid-diagnosis/0"}',
    "r.html": "<html>old</html>",
    "dh.csv": "row,old\n",
    "arm.urdf": "<robot/>",
}
"""What stands where an output goes: of the same kind, and no result."""
MAPPING = (
    """format = "clampid-mapping/1"
table = "poses"
[columns]
pose = {from = "pose"}
visit = {from = "visit"}
target = {from = "target"}
"""
    + "".join(f'q{i} = {{from = "q{i}_rad", unit = "rad"}}\ndir{i} = {{from = "dir{i}"}}\n' for i in range(1, 7))
    + """
x = {from = "x_m", unit = "m"}
y = {from = "y_m", unit = "m"}
z = {from = "z_m", unit = "m"}
[campaign]
"""
)


class Bench:
    """A folder with inputs, the calls of each verb, and the outputs that each should leave."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.out = folder, folder / "out"
        arm, model = f"{folder}/arm", f"{folder}/in.json"
        json_to = ["--json", f"{self.out}/r.json"]
        self.calls = {
            "identify": ["identify", arm, "-o", f"{self.out}/m.json", *json_to],
            "auto": ["auto", arm, "-o", f"{self.out}/m.json", "--report", f"{self.out}/r.html", *json_to],
            "import": ["import", f"{folder}/map.toml", f"{arm}/poses.csv", "-o", f"{self.out}/new", *json_to],
            # Its own geometry: the fit of a table would take most of each trial, and nothing is written meanwhile.
            "export": ["export", "dh", model, "--fit", "static", "-o", f"{self.out}/dh.csv"],
            "urdf": ["export", "urdf", model, "-o", f"{self.out}/arm.urdf"],
            "simulate": ["simulate", "--robot", "ur10", "--poses", "8", "-o", f"{self.out}/new"],
            "serve": ["serve", model, "--listen", "127.0.0.1:0"],
        }

    def fill(self) -> None:
        """Make the inputs."""
        from clampid.cli import run
        from experiments.simulate import simulate

        simulate(self.folder / "arm", "ur10", seed=3, poses=14, tables=("poses",), file_format="csv")
        header = tomllib.loads((self.folder / "arm" / "campaign.toml").read_text())
        rest = {k: v for k, v in header.items() if k not in ("format", "tables", "robot")}
        lines = "".join(f"{key} = {_inline(value)}\n" for key, value in {"robot": "ur10", **rest}.items())
        (self.folder / "map.toml").write_text(MAPPING + lines)
        assert run(["identify", f"{self.folder}/arm", "-o", f"{self.folder}/in.json", "-q"]) == 0

    def clear(self, old: dict[str, str] | None = None) -> None:
        """Leave nothing in the folder of outputs but what is old."""
        shutil.rmtree(self.out, ignore_errors=True)
        self.out.mkdir()
        for name, content in (old or {}).items():
            if not name.startswith("new/"):
                (self.out / name).write_text(content)

    def inputs(self) -> dict[str, str]:
        """Hashes of all that is read."""
        kept = [p for p in self.folder.iterdir() if p.name not in ("out", "cache", "run")]
        return {k: v for p in kept for k, v in digests(p).items()}


def _inline(value: Any) -> str:
    """A value as TOML in one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_inline(part)}" for key, part in value.items()) + "}"
    return json.dumps(value)


def digests(place: Path) -> dict[str, str]:
    """The hash of every file, by its path from ``place``; of a folder that is empty, too."""
    every = sorted(place.rglob("*")) if place.is_dir() else [place]
    return {
        str(p.relative_to(place)): hashlib.sha256(p.read_bytes()).hexdigest() if p.is_file() else "a folder"
        for p in every
        if not p.is_dir() or not any(p.iterdir())
    }


def child(arguments: list[str], before: Callable[[], None] = lambda: None) -> int:
    """Fork a process that runs the command; its number. What it prints goes to the file ``said``."""
    number = os.fork()
    if number:
        return number
    code = 99
    try:
        handle = os.open("said", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(handle, 1)
        os.dup2(handle, 2)
        from clampid.cli import run

        before()
        code = run([*arguments, "-q"] if arguments[0] != "simulate" else arguments)
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def events(act: Callable[[int, str], None]) -> None:
    """Call ``act`` at each of this process's writes of files, with its number from 1 and what it is."""
    count = 0

    def step(name: str) -> None:
        nonlocal count
        count += 1
        act(count, name)

    def heard(event: str, given: tuple[Any, ...]) -> None:
        if event == "open":
            path, _, flags = given
            if isinstance(flags, int) and flags & WRITING and str(path) not in ("/dev/null", "said"):
                step("open")
        elif event in EVENTS:
            step(event)

    sys.addaudithook(heard)
    write, fsync = os.write, os.fsync

    def written(descriptor: int, data: Any) -> int:
        half = memoryview(data)[: max(1, len(data) // 2)]  # what is cut off is cut off in the middle
        done = write(descriptor, half)
        step("os.write")
        return done

    def flushed(descriptor: int) -> None:
        step("os.fsync")
        fsync(descriptor)

    os.write, os.fsync = written, flushed


def counted(bench: Bench, verb: str) -> tuple[int, float]:
    """How many writes a call makes, and how long it takes, s."""
    tally, raw = Path("tally"), os.write

    def note(number: int, name: str) -> None:
        raw(descriptor, f"{number} {name}\n".encode())

    descriptor = os.open(tally, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    begun = time.monotonic()
    status = os.waitpid(child(bench.calls[verb], lambda: events(note)), 0)[1]
    os.close(descriptor)
    assert os.waitstatus_to_exitcode(status) == 0, Path("said").read_text()
    return len(tally.read_text().splitlines()), time.monotonic() - begun


def results(bench: Bench, verb: str) -> dict[str, str]:
    """Hashes of what a call leaves in the folder of outputs when nothing happens to it."""
    bench.clear()
    number = child(bench.calls[verb])
    assert os.waitstatus_to_exitcode(os.waitpid(number, 0)[1]) == 0, Path("said").read_text()
    return digests(bench.out)


def old_of(verb: str, new: dict[str, str]) -> dict[str, str]:
    """An older file in the place of each output."""
    return {name: OLD[name] for name in new if name in OLD}


def wrong(now: dict[str, str], old: dict[str, str], new: dict[str, str], partials: bool) -> list[str]:
    """What of a folder of outputs is neither as it was nor as it should become."""
    before = {name: hashlib.sha256(text.encode()).hexdigest() for name, text in old.items()}
    bad = [f"{n} is half-written" for n, mark in now.items() if n in new and mark not in (new[n], before.get(n))]
    bad += [f"{n} is lost" for n in before if n not in now]
    left = [n for n in now if n not in new and not (partials and n.startswith(".") and ".partial" in n)]
    folder = {n for n in new if "/" in n}
    if folder and folder & set(now) and not folder <= set(now):
        bad.append("a campaign lacks files")
    return bad + [f"{n} is left over" for n in left]


def kills(bench: Bench, verb: str, count: int, seed: int) -> Iterator[dict[str, Any]]:
    """Kill a verb ``count`` times at random moments, half of them at a random one of its writes."""
    rng = random.Random(f"{verb} {seed}")
    new, before = results(bench, verb), bench.inputs()
    bench.clear()
    writes, took = counted(bench, verb)
    killed = ended = 0
    while killed < count:
        old = old_of(verb, new) if rng.random() < 0.5 else {}
        bench.clear(old)
        at = rng.randint(1, writes) if writes and rng.random() < 0.5 else 0

        def die(number: int, _: str, at: int = at) -> None:
            if number == at:
                os.kill(os.getpid(), signal.SIGKILL)

        number = child(bench.calls[verb], lambda die=die, at=at: events(die) if at else None)
        if not at:
            time.sleep(rng.uniform(0.0, took))
            os.kill(number, signal.SIGKILL)
        status = os.waitpid(number, 0)[1]
        died = os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL
        killed, ended = killed + died, ended + (not died)
        bad = wrong(digests(bench.out), old, new, partials=True)
        if bad:
            yield {"bad": bad, "verb": verb, "write": at}
        if ended > 2 * count:
            yield {"bad": ["it ends before it is killed"], "verb": verb}
            break
    # The next call finds the place as the last one left it, and leaves it clean.
    shutil.rmtree(bench.out / "new", ignore_errors=True)  # a whole campaign is not written over
    number = child(bench.calls[verb])
    if os.waitstatus_to_exitcode(os.waitpid(number, 0)[1]) != 0:
        yield {"bad": [f"the next call failed: {Path('said').read_text()[:300]}"], "verb": verb}
    if digests(bench.out) != new or bench.inputs() != before:
        yield {"bad": ["the next call did not leave what it should"], "verb": verb, "now": list(digests(bench.out))}
    yield {"verb": verb, "killed": killed, "ended before": ended, "writes": writes}


def served(bench: Bench, count: int, seed: int) -> Iterator[dict[str, Any]]:
    """Kill servers at random moments, with an empty cache first, so that some die while they compile."""
    rng, verb = random.Random(f"serve {seed}"), "serve"
    before, cache = bench.inputs(), bench.folder / "cache"
    shutil.rmtree(cache, ignore_errors=True)
    os.environ["XDG_CACHE_HOME"] = str(cache)
    bench.clear()
    for k in range(count):
        number = child(bench.calls[verb])
        time.sleep(rng.uniform(0.0, 2.0 if k < count // 2 else 0.6))
        os.kill(number, signal.SIGKILL)
        os.waitpid(number, 0)
    number = child(bench.calls[verb])
    until = time.monotonic() + 120.0
    while "listening" not in Path("said").read_text() and time.monotonic() < until:
        time.sleep(0.05)
    os.kill(number, signal.SIGTERM)
    code = os.waitstatus_to_exitcode(os.waitpid(number, 0)[1])
    left = [p.name for p in (cache / "clampid" / "compiled").iterdir() if p.suffix != ".so"]
    bad = [f"{name} is left over" for name in left] + ([] if code == 0 else [f"the next server ended with {code}"])
    if bench.inputs() != before or digests(bench.out):
        bad.append("something was written")
    if bad:
        yield {"bad": bad, "verb": verb, "said": Path("said").read_text()[-300:]}
    yield {"verb": verb, "killed": count, "ended before": 0, "writes": 0}


def full(bench: Bench, verb: str, stride: int) -> Iterator[dict[str, Any]]:
    """Let the disk be full from each of a verb's writes on; then, for what compiled code writes, at some sizes."""
    new, before = results(bench, verb), bench.inputs()
    bench.clear()
    writes, _ = counted(bench, verb)
    sizes = [int(1000 * 3.0**k) for k in range(4)] if verb in ("simulate", "import") else []
    points = [*range(1, writes + 1, stride), *(-size for size in sizes)]
    for at in points:
        old = old_of(verb, new)
        bench.clear(old)

        def fail(number: int, _: str, at: int = at) -> None:
            if number >= at and _ not in ("os.remove", "os.rmdir"):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        def begin(at: int = at, fail: Callable[[int, str], None] = fail) -> None:
            if at > 0:
                events(fail)
            else:
                resource.setrlimit(resource.RLIMIT_FSIZE, (-at, -at))

        code = os.waitstatus_to_exitcode(os.waitpid(child(bench.calls[verb], begin), 0)[1])
        said = Path("said").read_text(errors="replace")
        bad = wrong(digests(bench.out), old, new, partials=False)
        lines = [line for line in said.splitlines() if line.startswith("clampid: ")]
        if at > 0 and code == 0 and digests(bench.out) != new:
            bad.append("it says that all is well")
        named = len(lines) == 1 and (str(bench.out) in lines[0] or tempfile.gettempdir() + "'" in lines[0])
        named = (named and code == 1) or "No usable temporary directory" in said
        if code != 0 and (not named or "Traceback" in said):
            bad.append(f"exit {code}, not 1 with one line that names the file")
        if bad:
            yield {"bad": bad, "verb": verb, "write": at, "said": said[-300:]}
    if bench.inputs() != before:
        yield {"bad": ["an input was changed"], "verb": verb}
    yield {"verb": verb, "tried": len(points), "writes": writes}


def main(what: str, folder: str, seed: str, *verbs: str) -> None:
    """Print what was found, a JSON a line."""
    bench = Bench(Path(folder))
    (bench.folder / "run").mkdir()
    os.chdir(bench.folder / "run")
    Path("said").touch()
    bench.fill()
    for verb in verbs:
        name, _, count = verb.partition(":")
        if what == "full":
            found = full(bench, name, int(count or 1))
        elif name == "serve":
            found = served(bench, int(count), int(seed))
        else:
            found = kills(bench, name, int(count), int(seed))
        for one in found:
            print(json.dumps(one), flush=True)


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    main(*sys.argv[1:])
