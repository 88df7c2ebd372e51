"""Keys that docstrings and effects cite exist."""

import kinematics
from kinematics import load_sources

KEYS = {
    "Thesis", "UniversalModel", "XCTDrift", "VisualInspection", "IRB1200Drift", "LynchPark2017", "Hayati1985",
    "DenavitHartenberg1955", "Nordin2002", "ISO9283", "Olsson1998", "Klimchik", "Dumas2011", "Bittencourt2010",
    "Waiboer2005", "Armstrong1994", "Stribeck1902", "Young1989",
}  # fmt: skip


def test_keys_and_titles():
    sources = load_sources()
    assert set(sources) >= KEYS
    assert sources["Thesis"] == "Calibration and Implementation of Robot for Detection of X-rays"
    assert all(title and "{" not in title for title in sources.values())


def test_public_names_exist():
    assert len(set(kinematics.__all__)) == len(kinematics.__all__)
    for name in kinematics.__all__:
        assert getattr(kinematics, name) is not None
