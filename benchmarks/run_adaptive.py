"""An adaptive run over sockets, as a user calls it: what it decided, why, and what diagnose says before and after.

    python benchmarks/run_adaptive.py FOLDER [--pair arm|wrist] [--budget 20] [--seed 1]

The virtual robot hides one effect of a pair that look alike. A plan of few poses is run with ``--adaptive``; the same
plan without it shows what it would have been. The commands are printed as they run.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from run_session import clampid, faster, virtual_robot


@dataclass(frozen=True)
class Case:
    """What is hidden, and a plan with which it is not to be told from another effect."""

    hidden: str
    plan: tuple[str, ...]


CASES = {
    "arm": Case("link_bending@link2:3", ("--poses", "24", "--replicates", "2", "--range-share", "0.35")),
    "wrist": Case("thermal_expansion@link4:3", ("--poses", "24", "--replicates", "2")),
}


def adaptive(folder: Path, case: Case, seed: int = 1, budget: int = 20) -> dict[str, Any]:
    """Run it; verdicts before and after, candidates, how many visits were added, and the run's own words."""
    found: dict[str, Any] = {}
    for kind in ("free-air", "wrist"):
        clampid("plan", kind, "-o", str(folder / f"{kind}.toml"), "--time", "60", "-q")
    poses = str(folder / "poses.toml")
    clampid("plan", "poses", "-o", poses, *case.plan, "--verification", "0", "--measure-time", "1", "-q")
    for name, more in (("before", ()), ("after", ("--adaptive", "--budget", str(budget)))):
        campaign = str(folder / name)
        with virtual_robot(folder, case.hidden, seed) as ports:
            link, tracker = f"eki://127.0.0.1:{ports['listening']}?torque=Nm", f"tcp://127.0.0.1:{ports['tracker']}"
            faster(ports["operator"], 10)
            for kind in ("free-air", "wrist"):
                clampid("run", str(folder / f"{kind}.toml"), "-o", campaign, "--link", link, "--yes", "-q")
            faster(ports["operator"], 100)
            clampid("run", poses, "-o", campaign, "--link", link, "--instrument", tracker, "--yes", *more, "-q",
                    "--json", str(folder / f"{name}_run.json"))  # fmt: skip
        clampid("identify", campaign, "-o", f"{campaign}.json", "-q")
        clampid("diagnose", f"{campaign}.json", campaign, "-q", "--json", str(folder / f"{name}_found.json"))
        ran = json.loads((folder / f"{name}_run.json").read_text(encoding="utf-8"))
        stage = json.loads((folder / f"{name}_found.json").read_text(encoding="utf-8"))["stages"]["poses"]
        found[name] = {
            "rows": ran["rows"],
            "decided": ran["notes"],
            "verdict": stage["verdict"],
            "candidates": [f"{c['name']}@{','.join(c['where'])}" for c in stage["candidates"]],
        }
    return found


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--pair", choices=list(CASES), default="arm")
    parser.add_argument("--budget", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    print(json.dumps(adaptive(given.folder, CASES[given.pair], given.seed, given.budget), indent=1))


if __name__ == "__main__":
    main()
