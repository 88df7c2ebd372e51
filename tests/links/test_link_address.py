"""Addresses: the scheme chooses the link, and what is none is said in one line."""

from __future__ import annotations

from importlib.metadata import EntryPoint

import pytest

from clampid.cli import run
from experiments.instruments.connect import instrument_of
from experiments.instruments.protocol import InstrumentError
from experiments.links import address as address_module
from experiments.links.address import LinkAddress, installed, open_link, parse_address
from experiments.links.protocol import LinkError


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("eki://172.31.1.147:54600", LinkAddress("eki", "172.31.1.147", 54600)),
        ("172.31.1.147:54600", LinkAddress("eki", "172.31.1.147", 54600)),
        ("varproxy://krc:7000?torque=%25", LinkAddress("varproxy", "krc", 7000, {"torque": "%"})),
        ("eki://[::1]:54600/?torque=Nm&current=A", LinkAddress("eki", "::1", 54600, {"torque": "Nm", "current": "A"})),
    ],
)
def test_addresses(text: str, found: LinkAddress) -> None:
    assert parse_address(text) == found


@pytest.mark.parametrize(
    "text", ["", "krc", "krc:0", "krc:99999", "eki://:1", "eki:krc:1", "eki://a b:1", "a:1?b=1&b=2", "x" * 600 + ":1"]
)
def test_what_is_no_address(text: str) -> None:
    with pytest.raises(LinkError, match="link: expected"):
        parse_address(text)


def test_a_placeholder_is_no_address() -> None:
    with pytest.raises(LinkError, match=r"robot's own address for HOST, found 'eki://HOST:54600'"):
        parse_address("eki://HOST:54600")
    with pytest.raises(InstrumentError, match="its own address for HOST and PORT, found 'tcp://HOST:PORT'"):
        instrument_of("tcp://HOST:PORT")


def test_an_unknown_scheme_lists_what_is_installed() -> None:
    assert {"eki", "rsi", "varproxy"} <= set(installed())
    with pytest.raises(LinkError, match=r"installed schemes \(.*eki.*varproxy.*\), found abb"):
        open_link("abb://robot:30004")


@pytest.mark.parametrize("query", ["speed=3", "torque=kg", "current=mA", "patience=0", "patience=x", "patience=nan"])
def test_a_setting_that_is_none_is_refused_before_anything_is_connected(query: str) -> None:
    with pytest.raises(LinkError, match="eki link: "):
        open_link(f"eki://192.0.2.1:54600?{query}")


def test_another_vendor_is_one_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint("other", "tests_other_link:connect", address_module.GROUP)
    monkeypatch.setattr(EntryPoint, "load", lambda self: lambda address: (self.name, address.host))
    monkeypatch.setattr(address_module, "entry_points", lambda group: [point])
    assert open_link("other://robot:1") == ("other", "robot")


def test_serve_says_it_in_a_line(tmp_path: object, capsys: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "model.json"
    model.write_text("{}", encoding="utf-8")
    assert run(["serve", str(model), "--listen", "127.0.0.1:0", "--link", "abb://robot:30004"]) == 2
    err = capsys.readouterr().err
    assert "clampid: --link abb://robot:30004: link abb://robot:30004: expected one of the installed schemes" in err
    assert err.count("\n") == 1
