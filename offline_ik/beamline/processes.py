"""The sides of the beamline that ``clampid serve`` starts, in processes of their own."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec

from offline_ik.errors import DetectorError

__all__ = ["Side", "Sides", "check_installed"]

READY = 60.0  # s until a side must have said that it is ready
AGAIN = 2.0  # s before one that has ended is started again
END = 1.0  # s that one may take to end


@dataclass(frozen=True)
class Side:
    """A side: what it is called, and the arguments of its module, without the server's address."""

    name: str
    module: str
    arguments: tuple[str, ...]


def check_installed(package: str, option: str, extra: str) -> None:
    """Refuse an option whose package is not there.

    Raises
    ------
    DetectorError
        It is not; the message has the command that installs it.
    """
    if find_spec(package) is None:
        raise DetectorError(
            f"{option} needs {package}, which is not installed: python -m pip install 'clampid[{extra}]'"
        )


class Sides:
    """Runs sides for as long as the server does.

    Parameters
    ----------
    say, warn
        Are told where a side answers, and when one has ended and is started again.
    """

    def __init__(self, sides: Sequence[Side], say: Callable[[str], None], warn: Callable[[str], None]) -> None:
        self.sides, self._say, self._warn = sides, say, warn
        self._tasks: list[asyncio.Task[None]] = []
        self._running: set[asyncio.subprocess.Process] = set()

    async def start(self, address: str) -> None:
        """Start all of them, against the server's address.

        Raises
        ------
        DetectorError
            One does not get ready: its port is in use, say.
        """
        for side in self.sides:
            process = await self._begin(side, address)
            self._tasks.append(asyncio.create_task(self._keep(side, address, process)))

    async def _begin(self, side: Side, address: str) -> asyncio.subprocess.Process:
        command = ("-m", side.module, *side.arguments, "--server", address)
        process = await asyncio.create_subprocess_exec(
            sys.executable, *command, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
            start_new_session=True,
        )  # fmt: skip
        self._running.add(process)
        assert process.stdout is not None
        line = b""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(READY):
                line = await process.stdout.readline()
                while line and not line.startswith(side.name.encode()):
                    line = await process.stdout.readline()
        if not line:
            await self._end(process)
            raise DetectorError(f"--{side.name}: it did not start; what it says is above")
        self._say(line.decode(errors="replace").rstrip())
        return process

    async def _keep(self, side: Side, address: str, process: asyncio.subprocess.Process) -> None:
        while True:
            code = await process.wait()
            self._running.discard(process)
            self._warn(f"{side.name}: it ended by itself (exit code {code}) and is started again")
            await asyncio.sleep(AGAIN)
            try:
                process = await self._begin(side, address)
            except DetectorError as error:
                self._warn(str(error))

    async def _end(self, process: asyncio.subprocess.Process) -> None:
        if process.stdin is not None:
            process.stdin.close()  # it ends by itself then
        try:
            async with asyncio.timeout(END):
                await process.wait()
        except TimeoutError:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()
        self._running.discard(process)

    async def close(self) -> None:
        """End all of them."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*map(self._end, list(self._running)))
