"""A client in a process of its own that behaves as contrast's KUKA motors do towards their Tango device.

Written from the behaviour of contrast/motors/KukaMotor.py (maxiv-science/contrast, MIT), not from its text: the source
is the device itself, never its cache; a move waits for ON, looking every half second; reads ``position``, changes one
element and writes all three; where that raises DevFailed it calls Init, waits, calls Connect, waits, and tries again,
for ever. Commands are lines of stdin, answers lines of stdout.
"""

from __future__ import annotations

import json
import sys
import time

import tango

WAIT = 0.5  # s


class Robot:
    def __init__(self, path: str) -> None:
        self.device = tango.DeviceProxy(path)
        self.device.set_source(tango.DevSource.DEV)
        self.again = 0

    def busy(self) -> bool:
        return bool(self.device.State() != tango.DevState.ON)

    def move(self, axis: int, value: float) -> None:
        while self.busy():
            time.sleep(WAIT)
        target = self.device.position.copy()
        target[axis] = value
        while True:
            try:
                self.device.position = target
                return
            except tango.DevFailed:
                self.again += 1
                self.device.Init()
                time.sleep(WAIT)
                self.device.Connect()
                time.sleep(WAIT)

    def answer(self, word: str, *given: str) -> object:
        match word:
            case "move":
                self.move(int(given[0]), float(given[1]))
                return {"again": self.again, "state": str(self.device.State())}
            case "write":
                self.device.position = [float(v) for v in given]
                return str(self.device.State())
            case "read":
                found = self.device.read_attribute(given[0]).value
                return found if isinstance(found, str) else [float(v) for v in found]
            case "wait":
                while self.busy():
                    time.sleep(0.02)
                return self.device.State().name
            case _:
                return str(getattr(self.device, word)(*given))


def main() -> None:
    robot = Robot(sys.argv[1])
    for line in sys.stdin:
        try:
            told = {"ok": robot.answer(*line.split())}
        except tango.DevFailed as error:
            told = {"failed": error.args[0].desc}
        print(json.dumps(told), flush=True)


if __name__ == "__main__":
    main()
