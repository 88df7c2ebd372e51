"""``clampid serve`` with a robot in memory: SERVE MODEL CELL and what stands for its options."""

from __future__ import annotations

import sys

from memory_link import MemoryLink

from offline_ik.beamline.processes import Side
from offline_ik.inverse.opening import open_detector
from offline_ik.server.protocol import Speaker
from offline_ik.server.server import serve


def say(text: str) -> None:
    print(text, flush=True)


def main() -> None:
    model, cell, *options = sys.argv[1:]
    sides = [Side(name, f"offline_ik.beamline.{module}", tuple(own)) for name, module, *own in map(str.split, options)]
    detector = open_detector(model, cell)
    detector.warm_up()
    speaker = Speaker(detector, MemoryLink())
    assert serve(speaker, "127.0.0.1", 0, say, sides=sides, warn=lambda text: say(f"warning: {text}"))


if __name__ == "__main__":
    main()
