"""Checks a campaign that follows the contract: what is improbable, and what cannot be identified from it.

What breaks the contract never gets here: `experiments.campaign.read_campaign` refuses it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from experiments.campaign import Campaign
from experiments.checks.angles import angle_findings
from experiments.checks.clock import clock_findings, counts_rows
from experiments.checks.distances import distance_findings
from experiments.checks.finding import Finding
from experiments.checks.friction import friction_findings
from experiments.checks.further import further_findings, further_variables
from experiments.checks.motion import motion_findings, moved_joints, replicates
from experiments.checks.moving_log import moving_logs
from experiments.checks.points import point_findings
from experiments.checks.signals import signal_findings
from experiments.checks.speeds import speed_findings
from experiments.checks.sweeps import sweep_findings
from experiments.checks.temperatures import temperature_findings
from experiments.checks.torques import torque_findings
from experiments.columns import QUATERNION, temperature_columns

__all__ = ["Finding", "check_campaign", "holdings"]

_ORDER = {"error": 0, "warning": 1, "note": 2}


def check_campaign(campaign: Campaign, *, fits: bool = False) -> tuple[Finding, ...]:
    """Find what is wrong with a campaign, and what cannot be identified from it, before anything is fitted.

    Parameters
    ----------
    campaign
        The campaign, as read.
    fits
        Whether a geometry is to be fitted to this campaign alone: too few poses for its parameters are an error then.

    Returns
    -------
    tuple of Finding
        Errors first, then warnings, then notes.
    """
    angles = tuple(angle_findings(campaign))
    wrong = frozenset(finding.table for finding in angles if finding.severity == "error")
    logs = {table: log for table, log in moving_logs(campaign).items() if table not in wrong}
    torques = tuple(torque_findings(campaign, logs))
    weighed = frozenset(finding.table for finding in torques if finding.severity == "error")
    findings = [
        *angles,
        *point_findings(campaign, wrong, fits),
        *distance_findings(campaign, wrong, fits),
        *torques,
        *signal_findings(campaign, wrong, weighed),
        *friction_findings(campaign, {table: log for table, log in logs.items() if table not in weighed}),
        *temperature_findings(campaign),
        *further_findings(campaign),
        *clock_findings(campaign),
        *motion_findings(campaign, wrong),
        *speed_findings(campaign, wrong),
    ]
    findings += [Finding("note", table, None, None, log.words) for table, log in campaign.long.items()]
    if "clamped" in campaign.tables and campaign.robot.transmission_known and "clamped" not in wrong | weighed:
        findings += sweep_findings(campaign)
    return tuple(sorted(findings, key=lambda finding: _ORDER[finding.severity]))


def holdings(campaign: Campaign) -> dict[str, Any]:
    """Say what a campaign holds, for people and as JSON.

    Parameters
    ----------
    campaign
        The campaign.

    Returns
    -------
    dict
        ``campaign``, ``robot``, ``joints``, ``instrument``, ``targets``, ``stated`` (what is known beforehand, see
        :meth:`experiments.stated.Stated.to_json`), ``fingerprint`` and, per table in ``tables``:
        ``rows``, ``duration_s`` (None where times only count rows), ``joints_moved`` (from 1; in ``clamped`` those
        driven), ``temperatures``; for logs
        ``runs`` (or ``sweeps``) and ``velocities`` or ``fixture``; for poses ``poses``, ``visits``, ``replicates``,
        ``targets``, ``orientation``, ``directions`` and ``variables`` (further columns that effects can depend on), for
        distances ``anchors``, too; for inclinations ``bodies``.
    """
    return {
        "campaign": campaign.name,
        "robot": campaign.robot.name,
        "joints": campaign.robot.n,
        "instrument": campaign.instrument.name,
        "targets": list(campaign.targets),
        "stated": campaign.stated.to_json(),
        "fingerprint": campaign.fingerprint,
        "tables": {table: _table(campaign, table) for table in campaign.tables},
    }


def _duration(frame: pd.DataFrame) -> float | None:
    """How long a table took, s; None where its times only count rows."""
    time = frame["time_s"].to_numpy(dtype=np.float64)
    return None if counts_rows(time) else float(np.ptp(time))


def _table(campaign: Campaign, table: str) -> dict[str, Any]:
    frame, long = campaign.tables[table], campaign.long.get(table)
    summary: dict[str, Any] = {
        "rows": long.table.rows if long else len(frame),
        "duration_s": long.seconds if long else _duration(frame),
        "joints_moved": [i + 1 for i in moved_joints(campaign, table)],
        "temperatures": list(temperature_columns(map(str, frame.columns))),
    }
    if table == "inclination":
        return summary | {"bodies": sorted(frame["at"].unique())}
    if table == "clamped":
        return summary | {"sweeps": int(frame["sweep"].nunique()), "fixture": "fixture_x_m" in frame}
    if table in ("free_air", "wrist"):
        runs = long.runs if long else int(frame["run"].nunique())
        return summary | {"runs": runs, "velocities": "qd1_rad_s" in frame}
    return summary | {
        "poses": int(frame["pose"].nunique()),
        "visits": len(frame[["pose", "visit"]].drop_duplicates()),
        "replicates": replicates(campaign) if table == "poses" else 0,
        "targets": sorted(set(frame["target"])),
        **({"anchors": sorted(set(frame["anchor"]))} if table == "distances" else {}),
        "orientation": QUATERNION[0] in frame,
        "directions": bool(frame.filter(regex=r"^dir\d+$").to_numpy().any()),
        "variables": further_variables(campaign, table),
    }
