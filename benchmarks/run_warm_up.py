"""Hours of warm-up through ``clampid run`` on the virtual controller: memory and open files of both processes.

    python benchmarks/run_warm_up.py [--hours 6] [--speed 500]

Swings of all joints at 30 % speed, a reference point every five minutes. Resident memory (MB) and open files of runner
and controller are read once a second. Printed are those at a few times, and the growth per simulated hour after the
first tenth, by least squares.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from run_session import faster, virtual_robot

NAMES = ("runner_MB", "runner_files", "controller_MB", "controller_files")
FIRST = 0.1  # of the time, in which processes get what they need


def usage(number: int) -> tuple[float, int]:
    """Resident memory, MB, and open files of a process."""
    status = Path(f"/proc/{number}/status").read_text(encoding="ascii")
    kilobytes = next(line.split()[1] for line in status.splitlines() if line.startswith("VmRSS"))
    return int(kilobytes) / 1024.0, len(list(Path(f"/proc/{number}/fd").iterdir()))


def warm_up(hours: float, speed: float, folder: Path) -> dict[str, Any]:
    """Run it; figures."""
    plan = str(folder / "warm.toml")
    made = [sys.executable, "-m", "clampid", "plan", "warm-up", "--hours", str(hours), "--posture"]
    subprocess.run([*made, "0,-1.57,1.2,0,0,0", "--swing", "0.6", "--speed", "0.3", "-o", plan, "-q"], check=True)
    with virtual_robot(folder, "gear_eccentricity@joint2", 3) as ports:
        controller = ports.pop("process")
        faster(ports["operator"], speed)
        words = ["run", plan, "-o", str(folder / "C"), "--link", f"eki://127.0.0.1:{ports['listening']}?torque=Nm"]
        words += ["--instrument", f"tcp://127.0.0.1:{ports['tracker']}", "--yes", "-q"]
        start, rows = time.monotonic(), []
        with subprocess.Popen([sys.executable, "-m", "clampid", *words]) as runner:
            while runner.poll() is None:
                try:
                    rows.append((time.monotonic() - start, *usage(runner.pid), *usage(controller)))
                except (OSError, StopIteration):  # it has just ended
                    break
                time.sleep(1.0)
            code = runner.wait()
    table = np.array(rows)
    late = table[:, 0] > FIRST * table[-1, 0]
    share = table[late, 0] / table[-1, 0] * hours
    slope = {name: float(np.polyfit(share, table[late, k], 1)[0]) for k, name in enumerate(NAMES, 1)}
    at = [table[int(f * (len(table) - 1))].round(1).tolist() for f in (0.1, 0.25, 0.5, 0.75, 1.0)]
    return {"exit": code, "seconds": float(table[-1, 0]), "at": at, "per_hour": slope, "columns": ("s", *NAMES)}


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=6.0)
    parser.add_argument("--speed", type=float, default=500.0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        for key, value in warm_up(given.hours, given.speed, Path(place)).items():
            print(f"{key}: {value}")


if __name__ == "__main__":
    main()
