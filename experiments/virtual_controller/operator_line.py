"""The operator of the controller, on a socket: the actions that a person does by hand at a real one.

=========================  ============================================================================================
``estop`` / ``estop off``  press or release the emergency stop; the drives stay off after it
``mode T1|T2|AUT|EXT``     turn the mode switch
``drives on|off``          switch the drives
``restart``                start the controller's programs anew
``kill-link``              cut both channels
``clamp`` / ``release``    clamp the flange of a robot that stands; open the clamp
``sight lost N``           the instrument finds no line of sight, N times
``sight silent SECONDS``   the instrument answers nothing for so long
``slip X Y Z``             the clamped block slips by so many mm along the base's axes
``rock X Y Z``             the clamped block rocks from now on, from rest to rest by so many mm along the base's axes
``speed X``                simulated seconds in a second
``fault NAME=VALUE``       arm a fault, see `experiments.virtual_controller.faults`
``state``                  what a person would see
=========================  ============================================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from experiments.virtual_controller.clock import MAX_SPEED, Clock
from experiments.virtual_controller.codes import Mode
from experiments.virtual_controller.errors import ControllerError
from experiments.virtual_controller.faults import Fault, parse_faults
from experiments.virtual_controller.programs import Controller
from experiments.virtual_controller.tracker import Tracker

__all__ = ["WORDS", "Operator"]

WORDS = frozenset({
    "estop", "mode", "drives", "restart", "kill-link", "clamp", "release", "sight", "slip", "rock", "speed", "fault",
    "state",
})  # fmt: skip


class Operator:
    """Answers an operator's lines.

    Parameters
    ----------
    controller, clock, tracker
        What hands can reach.
    restart, kill_link
        Start the programs anew; cut the channels.
    arm_fault
        Arms a fault.
    """

    def __init__(
        self,
        controller: Controller,
        clock: Clock,
        tracker: Tracker,
        *,
        restart: Callable[[], None],
        kill_link: Callable[[], None],
        arm_fault: Callable[[Fault], None],
    ) -> None:
        self._controller, self._clock, self._tracker = controller, clock, tracker
        self._arm_fault = arm_fault
        self._hands: dict[str, Callable[[], None]] = {
            "estop": lambda: controller.press_estop(True),
            "estop off": lambda: controller.press_estop(False),
            **{f"mode {mode.name}": partial(controller.switch_mode, mode) for mode in Mode},
            "drives on": self._drives_on,
            "drives off": lambda: controller.switch_drives(False),
            "restart": restart,
            "kill-link": kill_link,
            "clamp": lambda: controller.clamp(True),
            "release": lambda: controller.clamp(False),
            "state": lambda: None,
        }

    async def answer(self, line: str) -> dict[str, Any]:
        """Answer a line of the protocol."""
        words = line.split()
        hand = self._hands.get(" ".join(words))
        if hand is not None:
            hand()
            return self._state()
        match words:
            case ["sight", "lost", number] if number.isdecimal() and len(number) < 7:
                self._tracker.lost = int(number)
            case ["sight", "silent", number]:
                self._tracker.fall_silent(_number(number, 0.0, 3600.0))
            case ["slip", x, y, z]:
                self._controller.slip([_number(text, -5.0, 5.0) / 1000.0 for text in (x, y, z)])
            case ["rock", x, y, z]:
                self._controller.rock([_number(text, -5.0, 5.0) / 1000.0 for text in (x, y, z)])
            case ["speed", number]:
                self._speed(_number(number, 0.0, MAX_SPEED))
            case ["fault", *items] if items:
                self._faults(items)
            case _:
                known = ", ".join(self._hands)
                more = "sight lost N, sight silent SECONDS, slip X Y Z, rock X Y Z, speed X, fault NAME=VALUE"
                raise ControllerError(f"expected one of {known}, {more}")
        return self._state()

    def _drives_on(self) -> None:
        if self._controller.estop:
            raise ControllerError("the emergency stop is pressed: release it first (estop off)")
        self._controller.switch_drives(True)

    def _speed(self, speed: float) -> None:
        self._controller.due()
        self._clock.speed = speed

    def _faults(self, items: Sequence[str]) -> None:
        for fault in parse_faults(items):
            self._arm_fault(fault)

    def _state(self) -> dict[str, Any]:
        c = self._controller
        c.due()
        return {
            "boot": c.boot, "mode": c.mode.name, "drives": c.drives, "brakes_released": c.brakes, "estop": c.estop,
            "stopped": c.stopped, "running": c.running, "accepted": c.accepted, "finished": c.finished,
            "aborted": c.aborted, "point": c.point, "standing": c.standing(),
            "clamped": c.arm.clamped(self._clock.now()) is not None, "time_s": round(self._clock.now(), 3),
            "speed": self._clock.speed, "sight_lost": self._tracker.lost,
        }  # fmt: skip


def _number(text: str, least: float, most: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not least <= value <= most:
        raise ControllerError(f"expected a number from {least:g} to {most:g}, found {text[:20]!r}")
    return value
