"""An adaptive run over sockets, as a user calls it: what it decided, why, and what diagnose says before and after.

    python benchmarks/run_adaptive.py FOLDER [--case arm|cable|balancer|bending] [--budget 20]

The virtual robot hides one effect that looks like another one in a short plan. The plan is run with and without
``--adaptive``. The commands are printed as they run.
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
    """What is hidden in which robot, and a plan, by kind and options, with which it is not to be distinguished."""

    hidden: str
    seed: int
    kind: str
    options: tuple[str, ...]
    stage: str


LOG = ("--time", "120", "--range-share", "0.25")
POSES = ("--poses", "24", "--replicates", "2", "--range-share", "0.35", "--verification", "0", "--measure-time", "1")
FEW = ("--poses", "24", "--replicates", "1", "--verification", "0", "--measure-time", "1")
CASES = {
    "arm": Case("link_bending@link2:1", 2, "poses", FEW, "poses"),
    "cable": Case("dress_pack@joint4:2", 3, "free-air", LOG, "free_air"),
    "balancer": Case("gravity_compensator@joint2:1.5", 3, "free-air", LOG, "free_air"),
    "bending": Case("link_bending@link2:3", 1, "poses", POSES, "poses"),
}


def adaptive(folder: Path, case: Case, budget: int = 20) -> dict[str, Any]:
    """Run it; by whether it was adaptive: rows, the run's own words, the verdict, and its candidates."""
    found: dict[str, Any] = {}
    plan = str(folder / "plan.toml")
    clampid("plan", case.kind, "-o", plan, *case.options, "-q")
    for name, more in (("plain", ()), ("adaptive", ("--adaptive", "--budget", str(budget)))):
        campaign, ran, judged = (str(folder / f"{name}{end}") for end in ("", "_run.json", "_found.json"))
        with virtual_robot(folder, case.hidden, case.seed) as ports:
            faster(ports["operator"], 100 if case.kind == "poses" else 10)
            tracker = ("--instrument", f"tcp://127.0.0.1:{ports['tracker']}") if case.kind == "poses" else ()
            link = f"eki://127.0.0.1:{ports['listening']}?torque=Nm"
            clampid("run", plan, "-o", campaign, "--link", link, *tracker, "--yes", *more, "-q", "--json", ran)
        clampid("identify", campaign, "-o", f"{campaign}.json", "-q")
        clampid("diagnose", f"{campaign}.json", campaign, "-q", "--json", judged)
        stage = json.loads(Path(judged).read_text(encoding="utf-8"))["stages"][case.stage]
        told = json.loads(Path(ran).read_text(encoding="utf-8"))
        found[name] = {
            "rows": told["rows"],
            "decided": told["notes"],
            "verdict": stage["verdict"],
            "candidates": [f"{c['name']}@{','.join(c['where'])}" for c in stage["candidates"]],
        }
    return found


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--case", choices=list(CASES), default="cable")
    parser.add_argument("--budget", type=int, default=20)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    print(json.dumps(adaptive(given.folder, CASES[given.case], given.budget), indent=1))


if __name__ == "__main__":
    main()
