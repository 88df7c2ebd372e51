"""A bluesky RunEngine in a process of its own. Commands are lines of stdin, answers lines of stdout."""

from __future__ import annotations

import json
import sys
import threading
import time
from typing import Any

import bluesky.plan_stubs as bps
import bluesky.plans as bp
from bluesky.run_engine import RunEngine
from bluesky.utils import FailedStatus
from ophyd_async.core import init_devices, soft_signal_rw

from offline_ik.beamline.bluesky_device import DetectorRobot


class Client:
    def __init__(self, address: str) -> None:
        self.engine = RunEngine({}, call_returns_result=True)
        with init_devices():
            self.robot = DetectorRobot(address, name="detector")
            self.camera = soft_signal_rw(float, name="camera")
        self.documents: list[dict[str, Any]] = []
        self.engine.subscribe(lambda name, document: self.documents.append(document), "event")

    def run(self, plan: Any) -> Any:
        self.documents.clear()
        try:
            self.engine(plan)
        except FailedStatus as error:
            return {"failed": str(error.__cause__ or error.args[0])}
        return [document["data"] for document in self.documents]

    def stop_soon(self) -> None:
        def stop() -> None:
            time.sleep(0.5)
            self.engine.loop.call_soon_threadsafe(lambda: self.engine.loop.create_task(self.robot.stop()))

        threading.Thread(target=stop).start()

    def checked(self, value: dict[str, float]) -> str:
        import asyncio

        found = asyncio.run_coroutine_threadsafe(self.robot.check_value(value), self.engine.loop)
        try:
            found.result(20)
        except Exception as error:  # for the test to read
            return f"{type(error).__name__}: {error}"
        return ""

    def answer(self, command: dict[str, Any]) -> Any:
        robot, word = self.robot, command["do"]
        match word:
            case "set":
                return self.run(bps.mv(robot, command["value"]))
            case "axes":
                moves = [part for axis, there in command["value"].items() for part in (robot.axes[axis], there)]
                return self.run(bps.mv(*moves))
            case "grid":
                return self.run(
                    bp.grid_scan([self.camera, robot], robot.gamma, *command["gamma"], robot.delta, *command["delta"])
                )
            case "stopped":
                self.stop_soon()
                return self.run(bps.mv(robot, command["value"]))
            case "read":
                return self.run(bp.count([robot]))
            case "check":
                return self.checked(command["value"])
            case "locate":
                return self.engine(bps.locate(robot)).plan_result
        raise ValueError(word)


def main() -> None:
    client = Client(sys.argv[1])
    for line in sys.stdin:
        print(json.dumps(client.answer(json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
