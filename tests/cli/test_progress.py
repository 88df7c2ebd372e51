"""Progress: parts within parts, a time left, plain lines where work takes long, nothing with --quiet."""

from __future__ import annotations

import re

import pytest

from clampid.progress import Remaining, in_parts, innermost, left_in_words, listen, substep
from clampid.verbs.output import Output
from experiments.campaign import read_campaign
from experiments.simulate import simulate


def heard_of(work) -> list[tuple[float, str]]:
    heard: list[tuple[float, str]] = []
    with listen(lambda done, names: heard.append((done, names))):
        work()
    return heard


def test_parts_share_out_the_part_around_them() -> None:
    def work() -> None:
        for _ in in_parts(("a", "b"), str):
            with substep("x", 0.5), substep("y", 0.5):
                pass
            with substep("z"):
                pass

    found = heard_of(work)
    assert [names for _, names in found] == ["a", "a: x", "a: x: y", "a: z", "b", "b: x", "b: x: y", "b: z"]
    assert [done for done, _ in found] == pytest.approx([0, 0, 0, 0.25, 0.5, 0.5, 0.5, 0.75])


def test_parts_may_weigh_differently_and_a_failure_ends_its_part() -> None:
    def work() -> None:
        for item in in_parts((1, 2, 1), str, float):
            try:
                with substep("fails"):
                    raise ValueError
            except ValueError:
                pass
            assert item

    assert [done for done, names in heard_of(work) if ":" not in names] == pytest.approx([0, 0.25, 0.75])


def test_nobody_listens() -> None:
    assert list(in_parts("ab")) == ["a", "b"]

    @substep("a")
    def doubled(value: int) -> int:
        return 2 * value

    assert doubled(2) == 4
    assert [names for _, names in heard_of(lambda: doubled(1))] == ["a"]


def test_the_time_left_is_what_the_share_done_says() -> None:
    assert left_in_words(0.01, 50.0) == ""
    assert left_in_words(0.5, 20.0) == ", about 20 s left"
    assert left_in_words(0.1, 100.0) == ", about 15 min left"
    assert left_in_words(0.999, 100.0) == ", a few seconds left"


def test_of_rounds_that_nobody_counts_no_less_is_left_than_the_last_one_took() -> None:
    remaining = Remaining()
    assert remaining.words(0.9, 20.0) == ", about 20 s left"
    assert remaining.words(0.95, 60.0) == ", about 40 s left"
    assert remaining.words(0.95, 60.1) == ", about 40 s left"  # a part within the part that has just begun
    assert remaining.words(0.99, 61.0) == ", a few seconds left"


@pytest.fixture
def clock(monkeypatch):
    """A clock that moves by three seconds whenever it is read."""
    now = iter(range(0, 10_000, 3))
    monkeypatch.setattr("time.monotonic", lambda: float(next(now)))


def work(out: Output) -> None:
    with out.working("diagnosing"):
        for _ in in_parts(("free_air", "poses"), str):
            with substep("scoring the candidates"):
                pass


def test_plain_lines_name_the_parts_and_the_time_left(clock, capsys) -> None:
    work(Output())
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "diagnosing …"
    assert lines[-1].startswith("diagnosing: ")
    assert "  diagnosing: poses: scoring the candidates; 12 s so far, about 12 s left" in lines


@pytest.mark.parametrize(
    ("width", "said"),
    [
        (80, "mending: diagnosing: poses: scoring the candidates"),
        (45, "diagnosing: poses: scoring the candidates"),
        (40, "poses: scoring the candidates"),
        (10, "scoring the candidates"),
    ],
)
def test_of_parts_within_parts_the_innermost_are_named(width: int, said: str) -> None:
    assert innermost("mending", "diagnosing: poses: scoring the candidates", width) == said
    assert innermost("mending", "", width) == "mending"


def test_quiet_says_nothing(clock, capsys) -> None:
    work(Output(quiet=True))
    assert capsys.readouterr() == ("", "")


def test_a_terminal_gets_a_bar_with_the_part(clock, monkeypatch, capsys) -> None:
    from rich.console import Console

    out = Output()
    out.__dict__["errors"] = Console(stderr=True, force_terminal=True, width=100)
    monkeypatch.setenv("TERM", "xterm")
    work(out)
    text = capsys.readouterr().err
    assert "diagnosing: poses" in text
    assert "left" in text


def test_progress_on_a_terminal_is_one_line_without_ellipsis(clock, monkeypatch, capsys) -> None:
    from rich.console import Console

    out = Output()
    out.__dict__["errors"] = Console(stderr=True, force_terminal=True, width=80)
    monkeypatch.setenv("TERM", "xterm")
    with out.working("mending"), substep("diagnosing", 0.8):
        for _ in in_parts(("free_air", "poses"), str):
            with substep("fitting the effects again"):
                pass
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", lambda code: "" if code[0][-1] == "m" else "\n", capsys.readouterr().err)
    lines = [line for line in re.split(r"[\r\n]+", text) if line.strip()]
    assert max(map(len, lines)) <= 80
    assert "…" not in text
    assert any(re.match(r"poses: fitting the effects again +\S+ \d:\d\d:\d\d .* left", line) for line in lines), lines


def test_a_diagnosis_and_a_report_say_where_they_are(tmp_path) -> None:
    from clampid.diagnosis.diagnose import diagnose
    from clampid.identification.identify import identify
    from clampid.report import write_report

    campaign = read_campaign(simulate(tmp_path / "arm", seed=1, poses=25, tables=("poses",)))
    models = []
    assert "fitting poses" in [name for _, name in heard_of(lambda: models.append(identify(campaign)))]
    model = models[0]
    names = [name for _, name in heard_of(lambda: diagnose(model, campaign))]
    assert {"poses: fitting the effects again", "poses: scoring the candidates"} <= set(names)
    names = [name for _, name in heard_of(lambda: write_report(tmp_path / "report.html", model, campaign))]
    assert {"residuals", "error budget", "DH table"} <= set(names)
