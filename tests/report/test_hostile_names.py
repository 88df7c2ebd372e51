"""Names that are markup stay text: in the report, in a drawing, in a notebook."""

from __future__ import annotations

import json
import re
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import pytest

from clampid.cli import run
from clampid.models.model import Model, load_model
from experiments.simulate import simulate

MARKUP = "<script>alert(1)</script>"
TARGET = "T1'\"><img src=x onerror=alert(2)>"
ROBOT = Path(__file__).parents[2] / "appendix_data" / "robots" / "ur10.toml"


class Elements(HTMLParser):
    """Counts elements and notes attributes that run something."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: Counter[str] = Counter()
        self.text: list[str] = []
        self.handlers: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1
        self.handlers += [f"{tag} {name}={value}" for name, value in attrs if "alert(" in (value or "")]

    def handle_data(self, data: str) -> None:
        if self.lasttag != "script":
            self.text.append(data)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign whose robot, target and instrument have markup for names; a model and a report of it."""
    folder = tmp_path_factory.mktemp("named")
    arm = simulate(folder / "arm", "ur10", seed=3, poses=14, tables=("poses",), file_format="csv")
    (arm / "robot.toml").write_text(re.sub('^title = "', f'title = "{MARKUP}', ROBOT.read_text("utf-8"), flags=re.M))
    header = (arm / "campaign.toml").read_text().replace("virtual laser tracker", MARKUP)
    header = header.replace("T1 =", f"{json.dumps(TARGET)} =").replace('robot = "ur10"', 'robot = "robot.toml"')
    (arm / "campaign.toml").write_text(header)
    quoted = TARGET.replace('"', '""')
    (arm / "poses.csv").write_text((arm / "poses.csv").read_text().replace(",T1,", f',"{quoted}",'))
    model = str(folder / "model.json")
    assert run(["identify", str(arm), "-o", model, "-q"]) == 0
    assert run(["report", model, str(arm), "-o", str(folder / "r.html"), "-q"]) == 0
    return folder


def test_the_report_shows_them_and_runs_nothing(place: Path) -> None:
    text = (place / "r.html").read_text("utf-8")
    assert MARKUP not in text
    assert "<img src=x" not in text
    found = Elements()
    found.feed(text)
    assert not found.handlers
    assert not found.tags["img"]
    assert any(MARKUP in part for part in found.text)
    scripts = re.findall(r"<script([^>]*)>(.*?)</script>", text, re.DOTALL)
    assert not [kind for kind, script in scripts if "alert(1)" in script and "json" not in kind]


def test_a_drawing_has_a_title_and_no_script(place: Path) -> None:
    drawn = place / "r.svg"
    assert run(["robots", str(place / "arm" / "robot.toml"), "--svg", str(drawn), "-q"]) == 0
    every = list(ElementTree.fromstring(drawn.read_text("utf-8")).iter())
    assert not [one.tag for one in every if one.tag.rpartition("}")[2] in ("script", "a", "image", "foreignObject")]
    assert any(MARKUP in (one.text or "") for one in every)


def test_a_notebook_shows_them_and_runs_nothing(place: Path) -> None:
    model: Model = load_model(place / "model.json")
    html = model._repr_html_()
    found = Elements()
    found.feed(html)
    assert not found.handlers
    assert not found.tags["script"]
    assert not found.tags["img"]
