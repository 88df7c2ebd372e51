"""Runs a plan on a robot, from where it stood: opens the journal, asks the person, runs, converts.

While a plan runs, its journal lies in ``.CAMPAIGN.run`` beside the campaign's folder. The folder appears, or gets its
further tables, when the plan is done.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import stat
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from experiments.instruments import Instrument, InstrumentError
from experiments.links.protocol import Link, LinkError, LinkLostError, Status
from experiments.outputs import write_text
from experiments.plans.errors import PlanError
from experiments.plans.model import Plan
from experiments.plans.read import read_plan
from experiments.plans.validate import validate_plan
from experiments.plans.write import plan_text
from experiments.runs.context import Block, Context, degrees
from experiments.runs.errors import RunStopped
from experiments.runs.folder import check_folder_for, convert, is_in, tables_of, work_folder
from experiments.runs.journal import Journal
from experiments.runs.logs import run_logs
from experiments.runs.people import Person
from experiments.runs.poses import run_poses
from experiments.runs.robot import LinkedRobot
from experiments.runs.sweeps import run_sweeps

__all__ = ["Asked", "Outcome", "begun", "run"]

OWN_FILES = re.compile(r"journal\.jsonl|plan(-[0-9]+)?\.toml|\..*partial.*", re.DOTALL)
"""What a run writes into the folder of its own; hidden: what a kill left of a write."""
TRACES = ("move", "row", "log", "skipped", "clamped", "complete")
"""What in a journal shows that the robot was moved or something recorded."""


@dataclass
class Asked:
    """What a run needs besides its plan.

    Attributes
    ----------
    link, instrument, person
        The robot, what measures points, and who looks.
    resume
        Whether an unfinished run may be gone on with.
    say, progress, finished
        As in `experiments.runs.context.Context`.
    more
        Asked when the plan is done, with it and the journal's entries: a plan that goes on, or None, and why.
    """

    link: Callable[[], Link]
    instrument: Callable[[], Instrument] | None
    person: Person
    resume: bool = False
    say: Callable[[str], None] = lambda text: None
    progress: Callable[[float, str], None] = lambda done, text: None
    finished: Callable[[Block], str | None] = lambda block: None
    more: Callable[[Plan, Sequence[Mapping[str, Any]]], tuple[Plan | None, str]] | None = None
    journal: Journal | None = field(default=None, init=False)


@dataclass(frozen=True)
class Outcome:
    """What a run left: the campaign, rows by table, skipped targets, and why it ended early, if it did."""

    folder: Path
    rows: Mapping[str, int]
    skipped: tuple[str, ...]
    enough: str | None
    notes: tuple[str, ...]


def begun(folder: Path) -> bool:
    """Whether there is a run of this campaign that is not finished."""
    return (work_folder(folder) / "journal.jsonl").is_file()


def run(plan: Plan, folder: Path, asked: Asked) -> Outcome:
    """Run a plan and write, or extend, the campaign.

    Raises
    ------
    PlanError
        The call is wrong: nothing has moved.
    RunStopped
        It stopped safely before its end; what was recorded is kept.
    """
    validate_plan(plan)
    work = work_folder(folder)
    text = plan_text(plan, work)
    _check_work(work, text, folder, resume=asked.resume)
    work.mkdir(parents=True, exist_ok=True)
    if not (work / "plan.toml").is_file():
        write_text(work / "plan.toml", text)
    try:
        outcome = _run(plan, folder, asked, work)
    except (PlanError, RunStopped, InstrumentError):
        if asked.journal is not None and not any(e["what"] in TRACES for e in asked.journal.entries):
            shutil.rmtree(work)  # nothing has happened that a later run needs
        raise
    shutil.rmtree(work)
    return outcome


def _run(plan: Plan, folder: Path, asked: Asked, work: Path) -> Outcome:
    with Journal(work / "journal.jsonl") as journal:
        asked.journal = journal
        if journal.dropped:
            asked.say(f"The journal's last line was not whole ({journal.dropped} bytes): what it was of is done again.")
        if any(journal.of("complete")) and is_in(journal.entries, folder):
            enough = next(iter(journal.of("complete"))).get("enough")
        else:
            check_folder_for(plan, folder)
            enough = _finish(plan, asked, journal)
            convert(plan, journal.entries, folder, journal=journal.path)
        return _outcome(folder, journal, enough)


def _check_work(work: Path, text: str, folder: Path, *, resume: bool) -> None:
    """An unfinished run is gone on with only when that is asked for, and with its own plan.

    Its folder is removed when the run has ended: it holds a run's own files only, and is no link to another folder.
    """
    if os.path.lexists(work):
        other = "a link" if work.is_symlink() else "a file" if not work.is_dir() else _foreign(work)
        if other:
            raise PlanError(f"{work}: expected nothing, or the folder of a run that was stopped, found {other}")
    if not (work / "journal.jsonl").is_file():
        return
    copy = work / "plan.toml"
    if copy.is_file() and _mark(copy.read_bytes()) != _mark(text.encode()):
        raise PlanError(
            f"{folder}: expected the plan whose run was stopped (a copy is {copy}), found another; finish that one "
            f"with --resume, or remove {work}"
        )
    if not resume:
        raise PlanError(f"{folder}: a run of this plan was begun; go on with --resume, or remove {work}")


def _foreign(work: Path) -> str:
    """What in a run's folder is no file that a run writes; empty: nothing."""
    for one in sorted(work.iterdir()):
        if not stat.S_ISREG(one.lstat().st_mode) or not OWN_FILES.fullmatch(one.name):
            return f"{one.name[:80]!r} in it"
    return ""


def _mark(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _finish(plan: Plan, asked: Asked, journal: Journal) -> str | None:
    """Run what is left; returns why it ended early, if enough was known."""
    if any(journal.of("complete")):
        enough = next(iter(journal.of("complete"))).get("enough")
        return None if enough is None else str(enough)
    link = instrument = None
    try:
        link = asked.link()
        instrument = None if asked.instrument is None else asked.instrument()
        robot = LinkedRobot(link, plan.cell.robot, journal, asked.say)
        _begin_session(robot, journal, asked)
        now = _grown(plan, journal)
        context = Context(now, robot, instrument, asked.person, journal, asked.say, asked.progress, asked.finished)
        enough = _PARTS[plan.kind](context)
        while enough is None and asked.more is not None:
            grown, why = asked.more(context.plan, journal.entries)
            if grown is None:
                journal.add("note", words=why)
                break
            context.plan = _keep_grown(grown, why, journal)
            enough = _PARTS[plan.kind](context)
        journal.add("complete", **({} if enough is None else {"enough": enough}))
        return enough
    except LinkError as error:
        question = None if link is None else link.open_question()
        journal.add("stopped", why=str(error))
        raise RunStopped(f"link: {error}" + (f" ({question})" if question else "")) from None
    except (RunStopped, KeyboardInterrupt) as error:
        journal.add("stopped", why=str(error) or "interrupted")
        if isinstance(error, KeyboardInterrupt):
            _stop(link)
            raise RunStopped("interrupted from the keyboard; the robot was told to stop") from None
        raise
    finally:
        if instrument is not None:
            instrument.close()
        if link is not None:
            link.close()


def _grown(plan: Plan, journal: Journal) -> Plan:
    """The plan with the steps that were decided during the run."""
    last = next((entry for entry in reversed(journal.entries) if entry["what"] == "extended"), None)
    if last is None:
        return plan
    name = str(last.get("file"))
    if Path(name).name != name:
        raise PlanError(f"{journal.path}: expected the name of a plan beside it, found {name[:80]!r}")
    return read_plan(journal.path.with_name(name))


def _keep_grown(grown: Plan, why: str, journal: Journal) -> Plan:
    """Put a plan that goes on on the disk, before anything of it is run."""
    file = f"plan-{2 + sum(1 for _ in journal.of('extended'))}.toml"
    write_text(journal.path.with_name(file), plan_text(grown, journal.path.parent))
    journal.add("extended", file=file, why=why)
    journal.add("note", words=why)
    return read_plan(journal.path.with_name(file))


_PARTS: Mapping[str, Callable[[Context], str | None]] = {
    "poses": run_poses,
    "free_air": run_logs,
    "wrist": run_logs,
    "clamping": run_sweeps,
}


def _stop(link: Link | None) -> None:
    if link is not None:
        try:
            link.stop()
        except LinkError:
            return


def _begin_session(robot: LinkedRobot, journal: Journal, asked: Asked) -> None:
    """Set the campaign's clock, and after a break have a person look at the robot before anything moves."""
    status = robot.rest()
    clock = 0.0 if status.clock is None else status.clock
    last = next((entry for entry in reversed(journal.entries) if "clock" in entry), None)
    if last is None:
        robot.offset = -clock
    elif last["boot"] == status.boot and clock >= last["clock"]:
        robot.offset = last["offset"]
    else:  # the controller was started again: its clock begins anew, how long it took the computer's clock knows
        latest = max(float(entry["wall"]) for entry in journal.entries)
        newest = max((float(f["time_s"].max()) for f in tables_of(journal.entries).values()), default=0.0)
        gone = max(newest, last["clock"] + last["offset"])
        robot.offset = gone + max(time.time() - latest, 1.0) - clock
    question = robot.link.open_question()
    if any(entry["what"] != "session" for entry in journal.entries) or question:
        asked.person.confirm(_facts(status, journal, question), "Have you looked at the robot, and may it go on?")
        journal.add("confirmed", question=question)
        if question:
            robot.link.confirm()
    if status.stopped:
        asked.person.confirm("The robot's stop is set.", "Lift the stop?")
        robot.link.release()
        _wait_released(robot)
    journal.add("session", boot=status.boot, clock=clock, offset=robot.offset, at=status.joints.tolist())


def _wait_released(robot: LinkedRobot) -> None:
    end = time.monotonic() + 5.0
    while robot.next_status().stopped:
        if time.monotonic() > end:
            raise LinkLostError("the controller does not lift the stop")


def _facts(status: Status, journal: Journal, question: str | None) -> str:
    """What a person has to know before the robot moves again."""
    drives = "on" if status.drives else "off" if status.drives is False else "not known"
    lines = [
        f"The robot stands at {degrees(status.joints)} deg; mode {status.mode}, drives {drives}.",
        f"Programs: accepted {status.accepted}, finished {status.finished}, aborted {status.aborted}"
        + (f" ({status.reason})" if status.aborted and status.reason else "")
        + ".",
    ]
    if question:
        lines.append(f"The link asks: {question}.")
    move = next((e for e in reversed(journal.entries) if e["what"] in ("move", "moved", "ended")), None)
    if move is not None and move["what"] == "move":
        lines.append(f"The last motion was on its way when the run ended: {move['step']}.")
    lines += [f"It had stopped: {e['why']}." for e in list(journal.of("stopped"))[-1:]]
    rows = ", ".join(f"{len(frame)} rows of {name}" for name, frame in tables_of(journal.entries).items())
    lines.append(f"Recorded so far: {rows or 'nothing'}.")
    return "\n".join(lines)


def _outcome(folder: Path, journal: Journal, enough: str | None) -> Outcome:
    rows = {name: len(frame) for name, frame in tables_of(journal.entries).items()}
    skipped = tuple(f"{entry['key'][3]} at pose {entry['key'][1]}: {entry['why']}" for entry in journal.of("skipped"))
    notes = tuple(entry["words"] for entry in journal.of("note"))
    return Outcome(folder, rows, skipped, enough, notes)
