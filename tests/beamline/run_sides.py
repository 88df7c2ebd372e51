"""Sides in a process that does nothing else: ADDRESS of a server, and what stands for the options."""

from __future__ import annotations

import asyncio
import signal
import sys

from offline_ik.beamline.processes import Side, Sides
from offline_ik.errors import DetectorError


def say(text: str) -> None:
    print(text, flush=True)


async def run(address: str, sides: list[Side]) -> int:
    beside, end = Sides(sides, say, lambda text: say(f"warning: {text}")), asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, end.set)
    try:
        await beside.start(address)
        await end.wait()
    except DetectorError as error:
        say(str(error))
        return 2
    finally:
        await beside.close()
    return 0


def main() -> None:
    address, *options = sys.argv[1:]
    sides = [Side(name, f"offline_ik.beamline.{module}", tuple(own)) for name, module, *own in map(str.split, options)]
    sys.exit(asyncio.run(run(address, sides)))


if __name__ == "__main__":
    main()
