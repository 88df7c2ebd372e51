"""What goes onto the controller: config files, KRL and RSI config agree with the schema, and with each other."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clampid.cli import run
from experiments.links.eki_config import CONNECT_MS
from experiments.links.files import link_files
from experiments.links.schema import ALIVE_FLAGS, CHANNELS, DATA_FLAGS, MOTION, STATE, Event, Kind, Reason
from kinematics.description import DescriptionError, load_robot

ROBOT = load_robot("kuka_kr20_r1810")
FILES = link_files(ROBOT)
KRL = {name: text for name, text in FILES.items() if name.startswith("clampid_")}
PROGRAMS = {name: text for name, text in KRL.items() if not name.endswith(".dat")}


def bare(text: str) -> list[str]:
    """Lines without remarks."""
    return [line for line in text.split("\r\n") if line and not line.startswith((";", "&"))]


@pytest.mark.parametrize("channel", CHANNELS, ids=lambda c: c.name)
def test_a_config_file_says_what_the_schema_says(channel: object) -> None:
    root = ET.fromstring(FILES[f"{channel.name}.xml"])
    assert root.tag == "ETHERNETKRL"
    assert [part.tag for part in root] == ["CONFIGURATION", "RECEIVE", "SEND"]
    assert root.findtext("CONFIGURATION/EXTERNAL/TYPE") == "Client"
    internal = root.find("CONFIGURATION/INTERNAL")
    assert internal.findtext("ENVIRONMENT") == channel.environment
    assert internal.find("BUFFERING").attrib == {"Mode": "FIFO", "Limit": str(channel.limit)}
    assert 1 <= channel.limit <= 512
    assert int(internal.find("BUFFSIZE").get("Limit")) <= 65534
    assert int(internal.find("TIMEOUT").get("Connect")) <= 65535
    assert int(internal.find("ALIVE").get("Set_Flag")) == ALIVE_FLAGS[CHANNELS.index(channel)]
    assert int(internal.findtext("PORT")) == 54600 + channel.offset
    received = [(e.get("Tag"), e.get("Type")) for e in root.findall("RECEIVE/XML/ELEMENT")]
    assert received[:-1] == [(e.tag, e.type) for e in channel.receive]
    whole = root.findall("RECEIVE/XML/ELEMENT")[-1]
    assert whole.attrib == {
        "Tag": channel.receive[0].root,
        "Set_Flag": str(DATA_FLAGS[CHANNELS.index(channel)]),
    }
    assert [e.get("Tag") for e in root.findall("SEND/XML/ELEMENT")] == [e.tag for e in channel.send]


def test_krl_reads_and_writes_every_element_with_its_type() -> None:
    calls = re.findall(r'EKI_(Get|Set)(Int|Real|Bool)\("(\w+)","([^"]+)",', "".join(PROGRAMS.values()))
    verbs = {"INT": "Int", "REAL": "Real", "BOOL": "Bool"}
    for channel in CHANNELS:
        for way, elements in (("Get", channel.receive), ("Set", channel.send)):
            wanted = [(verbs[e.type], e.tag) for e in elements]
            assert sorted((t, tag) for w, t, c, tag in calls if (w, c) == (way, channel.name)) == sorted(wanted)


@pytest.mark.parametrize("name", PROGRAMS)
def test_krl_blocks_are_closed(name: str) -> None:
    ends = {"IF": "ENDIF", "FOR": "ENDFOR", "WHILE": "ENDWHILE", "LOOP": "ENDLOOP", "SWITCH": "ENDSWITCH",
            "DEF": "END", "DEFFCT": "ENDFCT"}  # fmt: skip
    open_: list[str] = []
    for line in bare(PROGRAMS[name]):
        word = line.split()[0]
        if word in ends:
            assert word != "IF" or line.endswith(" THEN")
            open_.append(ends[word])
        elif word in ends.values():
            assert open_.pop() == word, line
    assert not open_


def test_krl_names_are_declared_called_and_short() -> None:
    text = "\n".join(line for krl in KRL.values() for line in bare(krl))
    outside = re.sub(r'"[^"]*"', "", text)
    declared = set(re.findall(r"^DECL (?:GLOBAL )?\w+ (CL_\w+)", text, re.MULTILINE))
    defined = set(re.findall(r"^DEF(?:FCT INT)? (CL_\w+)", text, re.MULTILINE))
    used = set(re.findall(r"\bCL_\w+", outside))
    assert used == declared | defined
    assert max(map(len, re.findall(r"[A-Za-z_]\w*", outside))) <= 24
    shared = set(re.findall(r"\bCL_\w+", " ".join(bare(KRL["clampid_state.sub"]))))
    public = set(re.findall(r"^DECL GLOBAL \w+ (CL_\w+)", text, re.MULTILINE))
    assert shared <= public, "the submit interpreter sees only global data"
    for name in PROGRAMS:
        for block in re.split(r"(?m)^DEF", "\n".join(bare(PROGRAMS[name])))[1:]:
            local = set(re.findall(r"\b(?:[A-Z]\w*)\b", " ".join(re.findall(r"(?m)^DECL \w+ (.*)$", block))))
            head = set(re.findall(r"(\w+):IN", block.split("\n", maxsplit=1)[0]))
            assert head <= local, "parameters are declared"
            for target in re.findall(r"(?m)^([A-Z]\w*)(?:\[\w+\])?=", block):
                assert target in local or target.startswith("CL_"), target


def test_krl_sends_the_numbers_of_the_schema() -> None:
    motion, state = KRL["clampid_motion.src"], KRL["clampid_state.sub"]
    assert {int(n) for n in re.findall(r"CL_SAY\((\d)", motion)} == set(Event)
    refusals = {int(n) for n in re.findall(r"CL_REFUSE\((\d+)\)|RETURN (\d+)|CL_WHY=(\d+)", motion) for n in n if n}
    refusals |= {int(n) for n in re.findall(r"^(?:CL_)?WHY=(\d+)\r?$", state, re.MULTILINE)}
    assert refusals == {int(r) for r in Reason} - {Reason.CLOSED}
    assert {int(k) for k in re.findall(r"KIND==(\d)", state)} == {Kind.STOP, Kind.RELEASE, Kind.RECORDING}


def test_limits_are_the_robots_and_rounded_inward() -> None:
    dat = KRL["clampid_motion.dat"]
    for side, values in (("MIN", ROBOT.lower), ("MAX", ROBOT.upper)):
        found = [float(v) for v in re.findall(rf"CL_{side}\[\d\]=(\S+)", dat)]
        np.testing.assert_allclose(found, np.degrees(values), atol=1e-9)
    third = replace(ROBOT.joints[2], lower=-1.0, upper=1.0)
    odd = link_files(replace(ROBOT, joints=(*ROBOT.joints[:2], third, *ROBOT.joints[3:])))["clampid_motion.dat"]
    assert "CL_MIN[3]=-57.2957\r\n" in odd
    assert "CL_MAX[3]=57.2957\r\n" in odd


def test_a_name_does_not_become_a_line_of_krl() -> None:
    files = link_files(replace(ROBOT, title="x\r\n$MAMES[1]=99\r\n;é", name="y"))
    for name, text in files.items():
        assert text.isascii(), name
        assert not any(line.startswith("$MAMES") for line in text.splitlines())


def test_other_arms_are_refused_in_a_line() -> None:
    for name in ("ur10", "abb_irb2400_12_155"):
        with pytest.raises(DescriptionError, match="expected a six-axis arm of KUKA's form"):
            link_files(load_robot(name))
    with pytest.raises(DescriptionError, match="found 5 joints"):
        link_files(
            replace(ROBOT, joints=ROBOT.joints[:5], links=(), transmission=np.eye(5), dh=None, linkage=np.eye(5))
        )
    endless = replace(ROBOT.joints[5], upper=np.inf)
    with pytest.raises(DescriptionError, match="A6 has no limits"):
        link_files(replace(ROBOT, joints=(*ROBOT.joints[:5], endless)))


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"port": 80}, "port"),
        ({"port": 54615}, "port"),
        ({"address": "a<b"}, "address"),
        ({"listener": "::1"}, "listener"),
    ],
)
def test_what_cannot_be_is_refused(given: dict[str, object], why: str) -> None:
    with pytest.raises(ValueError, match=f"^{why}: expected"):
        link_files(ROBOT, **given)


def test_addresses_go_into_the_files() -> None:
    files = link_files(ROBOT, 54604, "172.31.1.147", "172.31.1.10")
    assert "<IP>172.31.1.147</IP>\n      <PORT>54605</PORT>" in files["ClampidState.xml"]
    rsi = ET.fromstring(files["ClampidRSI.xml"])
    assert rsi.findtext("CONFIG/IP_NUMBER") == "172.31.1.10"
    assert rsi.findtext("CONFIG/ONLYSEND") == "TRUE"
    tags = [e.get("TAG") for e in rsi.findall("SEND/ELEMENTS/ELEMENT")]
    assert {"DEF_AIPos", "DEF_ASPos", "DEF_MACur", "DEF_Delay", "Gear.A6"} <= set(tags)
    assert not rsi.findall("RECEIVE/ELEMENTS/ELEMENT"), "nothing comes from outside"
    assert "54604" in files["README.txt"]


def test_the_verb_writes_the_files_and_says_what_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["link-files", "-o", str(tmp_path / "krc")]) == 0
    assert "virtual controller only" in " ".join(capsys.readouterr().out.split())
    assert {p.name: p.read_bytes().decode() for p in (tmp_path / "krc").iterdir()} == dict(FILES)
    assert run(["link-files", "-o", str(tmp_path / "krc")]) == 2
    assert run(["link-files", "-o", str(tmp_path / "other"), "--robot", "ur10"]) == 2
    err = capsys.readouterr().err
    assert "expected a new or empty folder" in err
    assert "expected a six-axis arm of KUKA's form" in err
    assert not (tmp_path / "other").exists()


def test_what_the_state_channel_answers_fits_its_buffers() -> None:
    from experiments.links.schema import LONGEST_PROGRAM, document

    longest = document(
        MOTION.receive, {e.tag: -123.456789e-9 if e.type == "REAL" else 2**31 - 1 for e in MOTION.receive}
    )
    assert MOTION.limit > LONGEST_PROGRAM
    assert MOTION.buffer > LONGEST_PROGRAM * len(longest)
    asked = document(STATE.receive, {e.tag: 2**31 - 1 for e in STATE.receive})
    assert STATE.limit * len(asked) < STATE.buffer


def blocks(name: str) -> dict[str, list[str]]:
    """Lines of each DEF and DEFFCT."""
    found: dict[str, list[str]] = {}
    for line in bare(PROGRAMS[name]):
        if head := re.match(r"DEF(?:FCT \w+)? (\w+) \(", line):
            found[head[1]] = lines = []
        else:
            lines.append(line)
    return found


def test_resume_ends_the_motion_and_not_what_reports_it() -> None:
    """RESUME goes on behind the call out of the block in which its interrupt was declared (KRL)."""
    found = blocks("clampid_motion.src")
    resuming = {name for name, lines in found.items() if "RESUME" in lines}
    assert resuming == {"CL_HALT", "CL_STARVED"}
    for handler in resuming:
        ((where, number),) = [
            (name, m[1])
            for name, lines in found.items()
            for line in lines
            if (m := re.match(rf"INTERRUPT DECL (\d+) WHEN .* DO {handler}\(\)$", line))
        ]
        (moving,) = [name for name, lines in found.items() if f"INTERRUPT ON {number}" in lines]
        behind = found[where][found[where].index(f"{moving}()") + 1 :]
        assert any(line.startswith("CL_SAY(5,") for line in behind), "the abort is told after RESUME"
        assert "CL_RUNNING=0" in behind
        assert found[moving][-2:] == ["WAIT SEC 0", "END"], "the advance run stays in the block that RESUME ends"


def test_a_channel_that_nobody_takes_is_opened_again_before_it_stops_listening() -> None:
    assert 100 * int(re.search(r"CL_WAITED>=(\d+)", KRL["clampid_motion.src"])[1]) < CONNECT_MS
    assert int(re.search(r"-OPENED>(\d+)", KRL["clampid_state.sub"])[1]) < CONNECT_MS


def test_the_clock_begins_anew_before_it_overflows() -> None:
    state = "\n".join(blocks("clampid_state.sub")["CLAMPID_STATE"])
    pattern = r"LOOP\nIF \(\$TIMER\[19\]>(\d+)\) AND \(CL_RUNNING==0\) THEN\n(.*?)ENDIF"
    full, then = re.search(pattern, state, re.DOTALL).groups()
    assert 0 < int(full) < 2**31 - 1 - 24 * 3600 * 1000
    assert {"CL_BOOT=CL_BOOT+1", "$TIMER[19]=0", "DUE=0", "ASKED=0", "OPENED=0"} <= set(then.split("\n"))
