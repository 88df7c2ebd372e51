"""An unmodified caproto client in a process of its own. Commands are lines of stdin, answers lines of stdout."""

from __future__ import annotations

import json
import sys
import threading
from typing import Any

from caproto.threading.client import Context


class Client:
    def __init__(self, prefix: str) -> None:
        self.prefix, self.context = prefix, Context(timeout=30)
        self.seen: dict[str, list[float]] = {}
        self.kept: list[Any] = []  # caproto holds what it calls weakly

    def pv(self, name: str) -> Any:
        (found,) = self.context.get_pvs(self.prefix + name)
        found.wait_for_connection(timeout=20)
        return found

    def read(self, name: str) -> Any:
        found = self.pv(name).read()
        data = found.data.tolist() if hasattr(found.data, "tolist") else list(found.data)
        return bytes(data).rstrip(b"\0").decode() if found.data_type.name == "CHAR" else data

    def put(self, *pairs: str) -> list[bool]:
        """Put several at once, each with completion; whether they succeeded."""
        done: dict[int, bool] = {}
        pvs = [self.pv(name) for name in pairs[::2]]

        def one(k: int, value: float) -> None:
            done[k] = bool(pvs[k].write(value, wait=True, timeout=30).status.success)

        threads = [threading.Thread(target=one, args=(k, float(v))) for k, v in enumerate(pairs[1::2])]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return [done[k] for k in range(len(pvs))]

    def limits(self, name: str) -> list[float]:
        found = self.pv(name).read(data_type="control").metadata
        return [found.lower_ctrl_limit, found.upper_ctrl_limit]

    def watch(self, name: str) -> None:
        """Note every value from now on, the present one first; what was noted before is forgotten."""
        seen = self.seen[name] = []
        subscription = self.pv(name).subscribe()

        def heard(_: Any, response: Any) -> None:
            seen.append(float(response.data[0]))

        self.kept += [subscription, heard]
        subscription.add_callback(heard)

    def answer(self, word: str, *given: str) -> Any:
        match word:
            case "read":
                return self.read(*given)
            case "put":
                return self.put(*given)
            case "send":  # without completion
                self.pv(given[0]).write(float(given[1]), wait=False)
                return None
            case "text":
                return bool(self.pv(given[0]).write(given[1].encode(), wait=True).status.success)
            case "limits":
                return self.limits(*given)
            case "alarm":
                return int(self.pv(given[0]).read(data_type="time").metadata.severity)
            case "watch":
                return self.watch(*given)
            case "seen":
                return self.seen[given[0]]
        raise ValueError(word)


def main() -> None:
    client = Client(sys.argv[1])
    for line in sys.stdin:
        try:
            told = {"ok": client.answer(*line.split())}
        except Exception as error:  # for the test to read
            told = {"failed": f"{type(error).__name__}: {error}"}
        print(json.dumps(told), flush=True)
    client.context.disconnect()


if __name__ == "__main__":
    main()
