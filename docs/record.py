"""Record what the commands of a page print: ``python docs/record.py docs/how-to/read-a-verdict.md``.

Console blocks are run in order in one new folder, with the remarks before them (``first: …``), as the tests do. What
stands below a command is replaced by what it prints. Blocks with a remark ``not run`` stay as they are, and so do
commands below which nothing stands.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

BLOCK = re.compile(r"(?:<!--(?P<remark>[^>]*?)-->\n)?```console\n(?P<text>.*?)^```$", re.DOTALL | re.MULTILINE)


def main() -> None:
    """Run the commands of a page and write it anew."""
    page = Path(sys.argv[1])
    text = page.read_text(encoding="utf-8")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    env = {**os.environ, "PATH": path, "COLUMNS": "80"}
    with tempfile.TemporaryDirectory() as folder:

        def printed(command: str) -> str:
            done = subprocess.run(
                ["bash", "-c", command], cwd=folder, env=env, stdout=subprocess.PIPE, text=True, check=True
            )
            return done.stdout

        def recorded(match: re.Match[str]) -> str:
            remark = (match["remark"] or "").strip()
            if remark.startswith("not run"):
                return match[0]
            if remark.startswith("first:"):
                printed(remark.removeprefix("first:"))
            out = []
            for part in re.split(r"^(?=\$ )", match["text"], flags=re.MULTILINE):
                command, _, below = part.partition("\n")
                if command:
                    now = printed(command.removeprefix("$ "))
                    out.append(f"{command}\n{now if below.strip() else ''}")
            return match[0].replace(match["text"], "".join(out))

        page.write_text(BLOCK.sub(recorded, text), encoding="utf-8")


if __name__ == "__main__":
    main()
