"""Every option of every verb with values that cannot be meant; run as a program, it says what came of each call."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from readers import OBSTACLES, PEAKS, most_memory

SECONDS = 10.0
TEXTS = (
    "", " ", "-", "--", "-1", "0", "1", "1.5", "1e308", "-1e308", "1e-320", "1e400", "nan", "inf", "-inf", "1e99999999",
    "9" * 400, "9" * 5000, "9223372036854775808", "-9223372036854775809", "1,2,3", "1,2,3,4,5,6", "0,0,0,0,0,0", ",,,",
    "nan,nan,nan", "1e308,1e308,1e308", "1;2", "x" * 5000, "joint1", "joint99", "link99", "poses", "poses=geometry",
    "geometry", "geometri", "poses=", "=", "a=b=c", "geometry@joint1", "backlash@joint2:nan", "payload:1e9", "free",
    "nearest", "\x1b[2J", "a\nb", "\u202eabc", "ä", "\udc80", "/dev/zero", "/dev/null/x", "/proc/self/mem", "nowhere",
    ".", "..", "127.0.0.1:0", "127.0.0.1:99999", "::::", "eki://x:1?y=1", "tcp://a:0", "folder:nowhere?a",
    "true", "[1, 2]", "{}", "$(id)", "%s", "*", "~", "S2T35", "S9T999", "T1", "std(backlash@joint2) < 5 arcsec",
)  # fmt: skip
"""What stands in the place of a value."""
OUTPUTS = {"--output", "--json", "--report", "--plan", "--svg", "--truth", "--picture", "--poni", "--out"}
POSITION = ["--gamma", "0.3", "--delta", "0.2", "--r", "0.8"]
CALLS: dict[str, list[str]] = {
    "check": ["arm"],
    "identify": ["arm", "-o", "out/m.json"],
    "auto": ["nowhere", "-o", "out/m.json"],
    "compare": ["m.json", "arm"],
    "diagnose": ["m.json", "nowhere"],
    "add": ["geometry", "m.json", "nowhere", "-o", "out/n.json"],
    "history": ["m.json"],
    "undo": ["m.json", "arm", "-o", "out/n.json"],
    "report": ["m.json", "nowhere", "-o", "out/r.html"],
    "export dh": ["m.json", "-o", "out/dh.csv"],
    "export urdf": ["m.json", "-o", "out/a.urdf"],
    "export angles": ["m.json", "-o", "out/a.csv"],
    "export kuka": ["m.json", "-o", "out/k.dat"],
    "export dynamics": ["m.json", "-o", "out/d.json"],
    "base": ["arm"],
    "effects": ["backlash"],
    "effect new": ["mine", "--depends-on", "q4", "--at", "joint4", "-o", "out/mine.py"],
    "robots": ["ur10"],
    "simulate": ["--robot", "ur10", "--poses", "2", "--tables", "poses", "-o", "out/arm"],
    "import": ["nowhere.toml", "nowhere.csv", "-o", "out/new"],
    "plan free-air": ["--time", "1", "--robot", "nowhere", "-o", "out/p.toml"],
    "plan wrist": ["--like", "nowhere", "-o", "out/p.toml"],
    "plan clamping": ["--like", "nowhere", "-o", "out/p.toml"],
    "plan poses": ["--poses", "1", "-o", "out/p.toml"],
    "plan iso9283": ["--like", "nowhere", "-o", "out/p.toml"],
    "plan line": ["--like", "nowhere", "-o", "out/p.toml"],
    "plan fixed-point": ["--like", "nowhere", "-o", "out/p.toml"],
    "plan warm-up": ["--like", "nowhere", "-o", "out/p.toml"],
    "run": ["nowhere.toml", "-o", "out/run"],
    "ik": ["m.json", *POSITION],
    "sample": ["m.json", "peaks.csv"],
    "serve": ["nowhere.json"],
    "link-files": ["-o", "out/files"],
    "virtual-robot": ["--listen", "nowhere"],
}
"""A call of each verb that ends soon; the last ones and those with ``nowhere`` are refused for that at the latest."""


def options() -> dict[str, list[tuple[str, bool]]]:
    """Verb → its options, and whether each takes a value."""
    import typer

    from clampid.cli import app

    known: dict[str, list[tuple[str, bool]]] = {}
    program: Any = typer.main.get_command(app())
    for name, verb in program.commands.items():
        inner = verb.commands.items() if hasattr(verb, "commands") else [("", verb)]
        for second, one in inner:
            takes = [(p.opts[0], not p.is_flag) for p in one.params if p.param_type_name == "option"]
            known[f"{name} {second}".strip()] = takes
    return known


def spoilt_call(verb: str, known: list[tuple[str, bool]], rng: random.Random) -> list[str]:
    """A call with one to three options, or an argument, that cannot be meant."""
    call = list(CALLS[verb])
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        if rng.random() < 0.15 and call:
            call[rng.randrange(len(call))] = rng.choice(TEXTS)
            continue
        option, takes = rng.choice(known)
        if option in OUTPUTS:
            call += [option, rng.choice(("/dev/null/x", "arm", "arm/poses.csv", "m.json", "", "out", "x" * 300))]
        else:
            call += [f"{option}={rng.choice(TEXTS)}"] if takes and rng.random() < 0.5 else [option]
            call += [rng.choice(TEXTS)] if takes and call[-1] == option else []
    return [*verb.split(), *call]


def fill(folder: Path) -> None:
    """Make the inputs, and go there."""
    from clampid.cli import run
    from experiments.simulate import simulate

    simulate(folder / "arm", "ur10", seed=3, poses=14, tables=("poses",), file_format="csv")
    os.chdir(folder)
    assert run(["identify", "arm", "-o", "m.json", "-q", "--effects", "poses=geometry"]) == 0
    Path("peaks.csv").write_text(PEAKS)
    Path("obstacles.toml").write_text(OBSTACLES)
    Path("out").mkdir()


def outcomes(count: int, seed: int) -> Iterator[dict[str, Any]]:
    """Make calls; what was bad of them, and the counts of each verb."""
    from clampid.cli import run

    def late(*_: object) -> None:
        traceback.print_stack()
        raise KeyboardInterrupt(f"no answer within {SECONDS:g} s")

    signal.signal(signal.SIGALRM, late)
    with tempfile.TemporaryDirectory() as place:
        with contextlib.redirect_stdout(io.StringIO()):
            fill(Path(place))
        known, before, rng = options(), _hashes(), random.Random(seed)
        assert set(known) - set(CALLS) == {"demo", "worked-example", "effect trust"}, set(known) ^ set(CALLS)
        warnings.simplefilter("error", RuntimeWarning)
        for verb in CALLS:
            counts, slowest = Counter[str](), 0.0
            for _ in range(count):
                call = spoilt_call(verb, known[verb], rng)
                print(json.dumps({"trying": call}), flush=True)
                said, printed, begun = io.StringIO(), io.StringIO(), time.monotonic()
                signal.setitimer(signal.ITIMER_REAL, SECONDS)
                try:
                    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(printed):
                        code = run(call)
                except BaseException as error:  # what a user would see as a traceback
                    code = -1
                    said.write(f"{type(error).__name__}: {error}")
                finally:
                    signal.setitimer(signal.ITIMER_REAL, 0)
                slowest = max(slowest, time.monotonic() - begun)
                lines = [line for line in said.getvalue().splitlines() if line.startswith("clampid: ")]
                fine = code == 0 or (code == 2 and len(lines) == 1 and len(said.getvalue()) < 6000)
                fine = fine and "Traceback" not in said.getvalue()
                counts["right" if fine and code == 0 else "refused" if fine else "bad"] += 1
                if not fine:
                    yield {"verb": verb, "call": call, "code": code, "error": said.getvalue()[-600:]}
                if _hashes() != before:
                    yield {"verb": verb, "call": call, "error": "an input was changed"}
                    before = _hashes()
            yield {"counts": verb, **counts, "slowest_s": round(slowest, 2), "memory_MB": most_memory()}


def _hashes() -> dict[str, str]:
    """Of the inputs."""
    every = [p for p in Path().rglob("*") if p.is_file() and p.parts[0] in ("arm", "m.json", "peaks.csv")]
    return {str(p): hashlib.sha256(p.read_bytes()).hexdigest() for p in every}


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for found in outcomes(int(sys.argv[1]), int(sys.argv[2])):
        print(json.dumps(found), flush=True)
