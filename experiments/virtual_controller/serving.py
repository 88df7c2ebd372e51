"""The virtual controller as a whole: its sockets, its timer, and the faults that strike it."""

from __future__ import annotations

import asyncio
import re
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from experiments.virtual_controller import operator_line, tracker
from experiments.virtual_controller.arm import Arm
from experiments.virtual_controller.channel import Channel
from experiments.virtual_controller.clock import Clock
from experiments.virtual_controller.codes import Event
from experiments.virtual_controller.config import Config
from experiments.virtual_controller.errors import ControllerError
from experiments.virtual_controller.faults import Fault
from experiments.virtual_controller.journal import Journal
from experiments.virtual_controller.lines import LINE_BYTES, LineService
from experiments.virtual_controller.operator_line import Operator
from experiments.virtual_controller.programs import Controller
from experiments.virtual_controller.tracker import Tracker
from experiments.virtual_controller.varproxy import VarProxy

__all__ = ["Address", "VirtualRobot", "parse_address"]

RESTART_S = 0.3  # s of the wall clock, in which a controller that starts lets nobody in
MOTION_TAGS = {
    "Move/Boot",
    "Move/Id",
    "Move/Point",
    "Move/Count",
    "Move/Speed",
    *(f"Move/Axis/@A{k}" for k in range(1, 7)),
}
STATE_TAGS = {"Ask/Sequence", "Ask/Kind", "Ask/From"}
ATTEMPTS = 50  # at two free ports side by side


# Parts of a host's name of more than 63 characters are an error of another kind where the name is looked up.
_IPV6 = r"\[[0-9A-Fa-f:.]{2,45}\]|[0-9A-Fa-f]*:[0-9A-Fa-f:.]{1,45}"
_ADDRESS = re.compile(rf"({_IPV6}|\w[\w-]{{0,62}}(?:\.\w[\w-]{{0,62}}){{0,8}}):([0-9]{{1,5}})", re.ASCII)


@dataclass(frozen=True)
class Address:
    """Where to listen; port 0 takes a free one."""

    host: str
    port: int


def parse_address(text: str, what: str) -> Address:
    """Read ``HOST:PORT``."""
    found = _ADDRESS.fullmatch(text)
    if found is None or int(found[2]) > 65535:
        raise ControllerError(f"{what} {text[:80]!r}: expected HOST:PORT")
    return Address(found[1].strip("[]"), int(found[2]))


class VirtualRobot:
    """A robot with its controller, on sockets.

    Parameters
    ----------
    arm, clock
        The robot, and its time.
    configs
        Config files of the motion channel and of the state channel.
    journal
        Keeps the truth.

    Raises
    ------
    ControllerError
        A config file lacks an element that the programs read or send.
    """

    def __init__(self, arm: Arm, clock: Clock, configs: tuple[Config, Config], journal: Journal) -> None:
        self.clock, self.journal = clock, journal
        self.controller = Controller(arm, clock, boot=journal.boot, notify=self._notify)
        for config, wanted in zip(configs, (MOTION_TAGS, STATE_TAGS), strict=True):
            if missing := wanted - {tag.path for tag in config.receive}:
                raise ControllerError(f"{config.name}: expected RECEIVE elements {', '.join(sorted(missing))}")
        self.motion = Channel(configs[0], self._take_point, self._motion_closed)
        self.state = Channel(configs[1], self._ask, lambda: None)
        self._check_sent()
        self.tracker = Tracker(arm, clock)
        self.operator = Operator(
            self.controller, clock, self.tracker,
            restart=self.restart, kill_link=self.kill_link, arm_fault=self.arm_fault,
        )  # fmt: skip
        self.varproxy = VarProxy(self.controller)
        self.restart_time = RESTART_S
        self._servers: list[asyncio.Server] = []
        self._timer: asyncio.TimerHandle | None = None
        self._restart_at_point: int | None = None
        self._ended: asyncio.Future[None] | None = None

    def _check_sent(self) -> None:
        for channel, known in ((self.motion, set(_moved({}))), (self.state, set(self.controller.state()))):
            if strange := set(channel.config.send) - known:
                raise ControllerError(
                    f"{channel.config.name}: SEND has elements unknown here: {', '.join(sorted(strange))}"
                )

    # Sockets.

    async def listen(self, address: Address) -> tuple[str, int]:
        """Listen for the two channels, on a port and the next one; return where."""
        loop = asyncio.get_running_loop()
        first, second = _side_by_side(address)
        self._servers += [
            await loop.create_server(self.motion.new_client, sock=first),
            await loop.create_server(self.state.new_client, sock=second),
        ]
        name = first.getsockname()
        return str(name[0]), int(name[1])

    async def listen_besides(self, what: str, address: Address) -> tuple[str, int]:
        """Listen for the instrument's, the operator's or KUKAVARPROXY's clients; return where."""
        client = {
            "tracker": LineService(self.tracker.answer, tracker.WORDS).client,
            "operator": LineService(self._operate, operator_line.WORDS).client,
            "varproxy": self.varproxy.client,
        }[what]
        sock = _bound(address.host, address.port)
        self._servers.append(await asyncio.start_server(client, sock=sock, limit=LINE_BYTES))
        name = sock.getsockname()
        return str(name[0]), int(name[1])

    async def run(self) -> None:
        """Serve until cancelled.

        Raises
        ------
        ControllerError
            The true values cannot be written any more, so the motions could not be counted.
        """
        self._ended = asyncio.get_running_loop().create_future()
        await self._ended

    def close(self) -> None:
        """Stop listening and hang up."""
        for server in self._servers:
            server.close()
        self.kill_link()
        self.journal.close()

    # What the programs do.

    def _take_point(self, record: Mapping[str, Any]) -> None:
        self.controller.take_point(record)
        self._wake()

    def _ask(self, record: Mapping[str, Any]) -> None:
        self.state.send(self.controller.ask(record))
        self._wake()

    async def _operate(self, line: str) -> dict[str, Any]:
        try:
            return await self.operator.answer(line)
        finally:
            self._wake()

    def _motion_closed(self) -> None:
        self.controller.motion_closed()

    def _notify(self, event: Mapping[str, Any]) -> None:
        """Report an event of the programs: first on the disk, then to the client."""
        if not self._kept(event) or "restart" in event or not isinstance(event["event"], Event):
            return
        self.motion.send(_moved(event))
        if event["event"] == Event.ACCEPTED and self._restart_at_point is not None:
            self._strike_at_point(self._restart_at_point)

    def _kept(self, event: Mapping[str, Any]) -> bool:
        """Write an event; where that cannot be done, this controller hangs up and ends, and tells nobody."""
        try:
            self.journal.add(event)
        except ControllerError as error:
            self.kill_link()
            if self._ended is not None and not self._ended.done():
                self._ended.set_exception(error)
            return False
        return True

    def _wake(self) -> None:
        """Set the timer to what is due next: none while the robot stands."""
        if self._timer is not None:
            self._timer.cancel()
        left = self.controller.next_due()
        loop = asyncio.get_running_loop()
        self._timer = None if left is None else loop.call_later(max(left, 0.0), self._due)

    def _due(self) -> None:
        self._timer = None
        self.controller.due()
        self._wake()

    # What people and faults do.

    def restart(self) -> None:
        """Start the controller's programs anew; nobody is let in for a moment."""
        for channel in (self.motion, self.state):
            channel.open = False
            channel.close()
        self.controller.restart()
        self._kept({"event": "started", "boot": self.controller.boot, "time": self.clock.now()})
        asyncio.get_running_loop().call_later(self.restart_time, self._started)
        self._wake()

    def _started(self) -> None:
        self.motion.open = self.state.open = True

    def kill_link(self) -> None:
        """Cut both channels."""
        self.motion.close()
        self.state.close()

    def arm_fault(self, fault: Fault) -> None:
        """Arm a fault."""
        if fault.name == "restart-at":
            if fault.point:
                self._restart_at_point = int(fault.value)
            else:
                asyncio.get_running_loop().call_later(fault.value, self.restart)
        elif fault.name in ("split", "coalesce", "padding"):
            self.motion.faults.arm(fault)
            self.state.faults.arm(fault)
        else:
            (self.motion if fault.channel == "motion" else self.state).faults.arm(fault)

    def _strike_at_point(self, point: int) -> None:
        """Restart in the middle of the move to a point of the program that has just been accepted."""
        span = self.controller.span(point)
        if span is not None:
            self._restart_at_point = None
            wait = max(self.clock.left(sum(span) / 2), 0.0)
            asyncio.get_running_loop().call_later(wait, self.restart)


def _moved(event: Mapping[str, Any]) -> dict[str, int]:
    return {f"Moved/{name}": int(event.get(name.lower(), 0)) for name in ("Boot", "Event", "Id", "Point", "Reason")}


def _bound(host: str, port: int) -> socket.socket:
    try:
        family, kind, protocol, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        sock = socket.socket(family, kind, protocol)
    except (OSError, UnicodeError) as error:
        raise ControllerError(f"cannot listen on {host}:{port}: {error}") from None
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(where)
    except OSError as error:
        sock.close()
        raise ControllerError(f"cannot listen on {host}:{port}: {error.strerror}") from None
    return sock


def _side_by_side(address: Address) -> tuple[socket.socket, socket.socket]:
    """Two sockets bound to a port and the next one."""
    for _ in range(ATTEMPTS):
        first = _bound(address.host, address.port)
        port = int(first.getsockname()[1])
        try:
            if port == 65535:
                raise ControllerError(f"{address.host}:{port}: expected a port with one after it")
            return first, _bound(address.host, port + 1)
        except ControllerError:
            first.close()
            if address.port:
                raise
    raise ControllerError(f"no two free ports side by side on {address.host}")
