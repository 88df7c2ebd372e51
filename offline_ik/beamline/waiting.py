"""Clients that wait for the end of a motion: one look at the robot for all of them."""

from __future__ import annotations

import asyncio
from typing import Any

from offline_ik.beamline.robot import LOOK, LinkedRobot

__all__ = ["Waiting"]


class Waiting:
    """Who waits, on one asyncio loop."""

    def __init__(self) -> None:
        self._waiting: dict[asyncio.Future[Any], tuple[LinkedRobot, int, float]] = {}
        self._task: asyncio.Task[None] | None = None

    def until_ended(self, robot: LinkedRobot, number: int, patience: float) -> asyncio.Future[Any]:
        """Done when motion ``number`` has ended (0: whatever moves), and at the latest after ``patience`` s."""
        loop = asyncio.get_running_loop()
        done: asyncio.Future[Any] = loop.create_future()
        self._waiting[done] = (robot, number, loop.time() + patience)
        if self._task is None or self._task.done():
            self._task = loop.create_task(self._look())
        return done

    async def _look(self) -> None:
        while self._waiting:
            now = asyncio.get_running_loop().time()
            for done, (robot, number, limit) in list(self._waiting.items()):
                try:
                    if not done.done() and (robot.has_ended(number) or now >= limit):
                        done.set_result(None)
                except Exception as error:  # a link may raise anything: those who wait are told, and nobody else
                    done.set_exception(error)
                if done.done():
                    del self._waiting[done]
            if self._waiting:
                await asyncio.sleep(LOOK)

    def close(self) -> None:
        """End all waiting."""
        if self._task is not None:
            self._task.cancel()
        for done in self._waiting:
            done.cancel()
        self._waiting.clear()
