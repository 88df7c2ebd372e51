"""Looks pinned versions up in the databases of known vulnerabilities (pip-audit), and says what it could not look up.

Ends with 1 where a version has a known vulnerability. Where the databases cannot be reached, as on a machine without a
network or behind a mirror, it says so and ends with 0: that no answer came is no finding.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence

SECONDS = 300


def judged(report: str) -> tuple[int, list[str]]:
    """Exit code and lines for a person, of the JSON that pip-audit prints; empty where it printed none."""
    try:
        found = json.loads(report)["dependencies"]
    except (ValueError, KeyError, TypeError):
        return 0, ["NOT AUDITED: the databases of known vulnerabilities could not be reached"]
    skipped = [one["name"] for one in found if "skip_reason" in one]
    lines = [
        f"{one['name']} {one['version']}: {vulnerability['id']}, mended in "
        f"{', '.join(vulnerability.get('fix_versions', ())) or 'no version yet'}"
        for one in found
        for vulnerability in one.get("vulns", ())
    ]
    code = 1 if lines else 0
    if len(skipped) == len(found):
        lines.append(
            "NOT AUDITED: the databases of known vulnerabilities could not be reached, or know no package here"
        )
    else:
        lines.append(
            f"audited {len(found) - len(skipped)} of {len(found)} packages: {len(lines)} known vulnerabilities"
        )
        lines += [f"not audited: {', '.join(skipped)}"] if skipped else []
    return code, lines


def main(arguments: Sequence[str]) -> int:
    """Audit a file of pinned versions with the pip-audit of an interpreter."""
    python, pinned = arguments
    options = ["--no-deps", "--disable-pip", "--format", "json", "--progress-spinner", "off", "--timeout", "10"]
    command = [python, "-m", "pip_audit", "-r", pinned, *options]
    try:
        ran = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS, check=False)
        report, said = ran.stdout, ran.stderr.strip().splitlines()
    except (OSError, subprocess.TimeoutExpired) as error:
        report, said = "", [str(error)]
    code, lines = judged(report)
    if not report and said:
        lines.append(said[-1][:300])
    print("\n".join(lines))
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
