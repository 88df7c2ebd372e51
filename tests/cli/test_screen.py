"""The screen that a verb ends in: at most 24 lines of 80 columns, whole words, and commands that a shell can run."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clampid.diagnosis.headline import MOST_WORDS, equally_good, headline, named, notes, outcome
from clampid.screen import HEIGHT, WIDTH, Errors, Next, Screen, command_lines, laid_out, wrapped
from clampid.text_table import table_lines
from clampid.verbs.next_step import next_steps
from clampid.verbs.output import Output
from clampid.verbs.screens import comparison_screen

WORD = st.text("abcdefghijklmnopqrstuvwxyz_.@-", min_size=1, max_size=24)
TEXT = st.lists(WORD, max_size=60).map(" ".join)
COMMAND = st.lists(st.one_of(WORD, st.lists(WORD, min_size=2, max_size=12).map(",".join)), min_size=1, max_size=9)
SHORT = st.lists(WORD, min_size=1, max_size=9)
SCREENS = st.builds(
    Screen,
    st.lists(WORD, min_size=1, max_size=6).map(" ".join),
    st.one_of(
        st.none(),
        st.builds(
            Errors,
            TEXT,
            st.just(("nominal", "this model", "noise floor")),
            st.lists(st.tuples(WORD, st.tuples(WORD, WORD, WORD).map(lambda c: tuple(x[:9] for x in c)), WORD),
                     min_size=1, max_size=5).map(tuple),
        ),
    ),
    st.lists(st.tuples(WORD, TEXT), max_size=9).map(tuple),
    st.lists(WORD, max_size=12).map(" ".join),
    st.just(""),
    st.lists(TEXT, max_size=9).map(tuple),
    st.lists(WORD, max_size=4).map(" ".join),
    st.lists(st.builds(Next, st.just("Next:"), SHORT.map(shlex.join)), max_size=4).map(tuple),
)  # fmt: skip


@given(SCREENS)
def test_a_screen_has_at_most_24_lines_of_80_columns_and_breaks_no_word(screen: Screen) -> None:
    lines = [line.text for line in laid_out(screen)]
    assert len(lines) <= HEIGHT
    assert all(len(line) <= WIDTH for line in lines)
    words = {w for text in (screen.done, screen.verdict, screen.more, *screen.notes) for w in text.split()}
    known = words | {w for fact in screen.facts for text in fact for w in text.split()}
    known |= {w for n in screen.next for line in command_lines(n.command) for w in line.split()}
    if screen.errors is not None:
        parts = (
            screen.errors.title,
            *screen.errors.heads,
            *(c for r in screen.errors.rows for c in (r[0], *r[1], r[2])),
        )
        known |= {w for part in parts for w in part.split()}
    left = {w for line in lines for w in line.split()} - known - {"-", "…", "and", "more:", "--verbose", "→", "Next:"}
    assert not [w for w in left if not w.isdigit()]


@pytest.mark.parametrize(
    "value", ["9.0 h.", "−237 ± 14 µrad;", "12.3 Nm/rad", "0.5 m/s²,", "20 °C", "2.7 GB", "5 %", "1.15 σ", "7 kg·m²"]
)
def test_a_number_stays_on_the_line_of_its_unit(value: str) -> None:
    for before in range(1, 80):
        lines = wrapped(f"{'x' * before} {value} and so on")
        assert sum(value in line for line in lines) == 1
        assert " ".join(lines) == f"{'x' * before} {value} and so on"


def test_a_number_leaves_the_line_of_its_unit_where_both_are_too_long_for_it() -> None:
    assert wrapped("12.3 ± 0.4 µrad", 8) == ["12.3 ±", "0.4 µrad"]
    assert wrapped("of 2 members, 3 mice", 11) == ["of 2", "members, 3", "mice"]


@given(COMMAND.map(shlex.join))
def test_a_command_on_several_lines_is_the_same_command(command: str) -> None:
    lines = command_lines(command)
    typed = "\n".join(lines).replace("\\\n", "")  # as a shell reads it
    assert shlex.split(typed) == shlex.split(command)
    assert all(len(line) <= WIDTH for line in lines)


def test_a_long_list_of_terms_goes_on_in_the_first_column_where_a_shell_joins_it() -> None:
    terms = "poses=" + ",".join(f"joint_angle_curve@joint{j}" for j in range(1, 7))
    lines = command_lines(f"clampid add {terms} model.json arm -o mended.json")
    assert len(lines) == 3
    assert lines[0].endswith(",\\")
    assert not lines[1].startswith(" ")
    assert lines[-1].endswith("-o mended.json")


def test_notes_give_way_and_the_command_stays() -> None:
    many = tuple(f"note {k}" for k in range(40))
    lines = [line.text for line in laid_out(Screen("Done.", notes=many, next=(Next("Next:", "clampid check arm"),)))]
    assert len(lines) == HEIGHT
    assert lines[-1] == "  clampid check arm"
    assert any("more: --verbose" in line for line in lines)


def test_colours_only_where_a_terminal_has_them(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    screen = Screen("Done.", verdict="Good.", tone="good")
    monkeypatch.delenv("NO_COLOR", raising=False)
    Output().show(screen)
    assert "\x1b[" not in capsys.readouterr().out
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    Output().show(screen)
    assert "\x1b[" in capsys.readouterr().out
    monkeypatch.delenv("FORCE_COLOR")
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("NO_COLOR", "1")
    Output().show(screen)
    assert "\x1b[3" not in capsys.readouterr().out


def test_a_table_breaks_no_word_and_keeps_its_numbers() -> None:
    rows = [("coulomb_friction.Fc", "joint1", "1.0455 ± 0.0077 Nm"), ("a long remark of several words", "joint2", "2")]
    lines = table_lines(("parameter", "at", "value"), rows, 2, 40)
    assert any("1.0455 ± 0.0077 Nm" in line for line in lines)
    assert any(line.startswith("coulomb_friction.Fc") for line in lines)
    assert max(map(len, lines)) <= 50


def candidate(name: str, *where: str, group: int | None = None, after: float = 1e-4, **more: Any) -> dict[str, Any]:
    alternative = {"alternative": group is not None} | ({} if group is None else {"group": group})
    return {"effect": name, "name": name, "where": list(where), "heldout_rms_after": after, "parameters": [],
            **alternative, **more}  # fmt: skip


def part(verdict: str, *candidates: dict[str, Any], **more: Any) -> dict[str, Any]:
    numbers = {"unit": "m", "noise_floor": 9e-5, "heldout_rms_before": 2e-4, "heldout_rms_after": 1e-4}
    return {"verdict": verdict, "candidates": list(candidates), "depends_on": [], **numbers, **more}


def test_the_verdict_on_what_was_missing() -> None:
    stages = {"poses": part("missing", candidate("gear_eccentricity", "joint2"))}
    assert headline(stages) == (
        "Gear eccentricity at joint 2 was missing; with it the held-out error falls from 200 µm to 100 µm."
    )
    assert "is now in the model" in headline(stages, mended=True)
    assert (outcome(stages), outcome(stages, mended=True)) == ("open", "good")


def test_the_verdict_where_effects_explain_the_rest_equally_well() -> None:
    found = (candidate("a", "joint1"), candidate("b", "link2", group=1), candidate("c", "base", group=1))
    assert headline({"poses": part("ambiguous", *found)}) == (
        "A at joint 1 was missing; b at link 2 and c explain what is left equally well."
    )


def test_the_verdict_where_nothing_is_missing_or_nothing_is_known() -> None:
    nothing = "No missing effect was found: the held-out error is"
    assert headline({"poses": part("adequate", heldout_rms_before=9.2e-5)}) == f"{nothing} at the noise floor."
    near = part("adequate", heldout_rms_before=1.015e-4)
    assert headline({"poses": near}) == f"{nothing} 1.13 times the noise floor."
    torque = {**near, "unit": "sigma", "heldout_rms_before": 1.15, "noise_floor": 1.0}
    assert headline({"poses": near, "free_air": torque}) == f"{nothing} up to 1.15 times the noise floor."
    assert "at the noise floor" not in headline({"poses": part("adequate", noise_floor=None)})
    above = part("adequate", above_floor={"times_floor": 2.13, "reasons": ["the floor is too low"]})
    assert "2.1 times the noise floor" in headline({"poses": above})
    assert outcome({"poses": above}) == "open"
    unknown = part("unknown", depends_on=["q4", "dir4"])
    assert headline({"poses": unknown}) == "No known effect explains an error that depends on q4 and dir4."


@given(
    st.dictionaries(
        st.sampled_from(["free_air", "clamped", "poses"]),
        st.builds(
            lambda verdict, names, either, depends: part(
                verdict,
                *(candidate(n, "joint1", "joint3") for n in names),
                *(candidate(n, "link2", group=1) for n in either),
                depends_on=depends,
            ),
            st.sampled_from(["adequate", "missing", "ambiguous", "unknown"]),
            st.lists(
                st.sampled_from(["gear_eccentricity", "joint_angle_curve", "bearing_tilt", "a", "b"]), unique=True
            ),
            st.lists(st.sampled_from(["cross_coupled_stiffness", "coupling_ratio_error", "c", "d"]), unique=True),
            st.lists(st.sampled_from(["q1", "q2", "dir4", "temp_link2", "time"]), unique=True),
        ),
        min_size=1,
    )
)
def test_every_verdict_is_one_sentence_of_at_most_25_words(stages: dict[str, Any]) -> None:
    for mended in (False, True):
        said = headline(stages, mended)
        assert len(said.split()) <= MOST_WORDS, said
        assert said.endswith(".")


def test_an_alternative_whose_values_the_data_do_not_determine_is_not_offered() -> None:
    wild = candidate("gravity", "link2", group=0, parameters=[{"name": "gravity.my@link2", "identified": False}])
    tame = candidate("backlash", "joint2", group=0, parameters=[{"name": "backlash.gap@joint2", "identified": True}])
    worse = candidate("base_tilt", "base", group=0, after=1.33e-3)
    found = {"poses": part("ambiguous", wild, tame, worse)}
    assert equally_good(found["poses"]["candidates"]) == [tame]
    assert headline(found) == "Backlash at joint 2 explains the rest best."
    assert any("base tilt explains it less well: held-out error 1.33 mm" in n for n in notes("poses", found["poses"]))
    assert any(
        "gravity at link 2 is no alternative: the data do not determine" in n for n in notes("poses", found["poses"])
    )
    from pathlib import Path

    (step,) = next_steps({"stages": found}, Path("m.json"), [Path("arm")])
    assert step.command == "clampid add poses=backlash@joint2 m.json arm -o mended.json"


def test_places_in_words() -> None:
    assert named("gear_eccentricity", ["joint2"]) == "gear eccentricity at joint 2"
    assert named("joint_angle_curve", [f"joint{j}" for j in range(1, 7)]) == "joint angle curve at joints 1–6"
    assert named("base_tilt", ["base"]) == "base tilt"


def test_compare_says_at_the_noise_floor_only_of_an_error_that_is(tmp_path: Path) -> None:
    """52.8 µm and 1.15 σ were said to be at floors of 46.8 µm and 1.00 σ."""

    def verdict(**tables: tuple[str, float, float]) -> str:
        data = {"tables": {name: {"unit": unit, "rms": error, "noise_floor": floor}
                           for name, (unit, error, floor) in tables.items()}}  # fmt: skip
        return comparison_screen(data, {}, tmp_path / "m.json", tmp_path, None, None).verdict

    near, torque = ("m", 52.8e-6, 46.8e-6), ("sigma", 1.153, 1.0)
    assert verdict(poses=near) == "The held-out error is 1.13 times the noise floor."
    assert verdict(poses=near, free_air=torque) == "The held-out error is up to 1.15 times the noise floor."
    assert verdict(poses=("m", 47e-6, 46.8e-6)) == "The held-out error is at the noise floor."
    assert verdict(poses=("m", 107e-6, 46.8e-6)).startswith("poses: the held-out error is 2.3 times the noise floor")
