"""Two effects hidden at once: what can be told apart is told, though what is beside it cannot."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from clampid.diagnosis.diagnose import diagnose
from clampid.identification.identify import identify
from clampid.loop.add import add
from experiments.campaign import Campaign

Simulated = Callable[..., Campaign]

STANDARD = ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction")


@pytest.mark.parametrize(
    "seed", [pytest.param(2, marks=pytest.mark.slow), *(pytest.param(s, marks=pytest.mark.study) for s in (1, 3))]
)
def test_what_is_beside_look_alikes_is_named(simulated: Simulated, seed: int) -> None:
    """A tilting base, joint 1's bearing and link 1 cannot be told apart; a faulty gear beside them is seen, too.

    Where poses alone cannot tell the gear from a balancer's torque, either, it is a group of look-alikes of its own.
    """
    hidden = ("base_tilt", "gear_eccentricity")
    campaign = simulated(seed=seed, poses=200, tables=("poses", "verification"), hidden=hidden)
    model = identify(campaign, STANDARD)
    found = diagnose(model, campaign).stages["poses"]
    groups: dict[int, list[str]] = {}
    for k, c in enumerate(found.candidates):
        groups.setdefault(c["group"] if c["alternative"] else -k, []).append(c["effect"])
    for effect in hidden:
        assert [effect in group for group in groups.values()].count(True) == 1, groups
    assert len(groups) == 2
    assert max(map(len, groups.values())) <= 3
    named = {min(group, key=lambda e: e not in hidden): group for group in groups.values()}
    terms = [f"poses={c['name']}@{p}" for c in found.candidates if c["effect"] in named for p in c["where"]]
    _, addition = add(model, campaign, terms)
    assert addition.stages["poses"].after.heldout_rms < 0.7 * addition.stages["poses"].before.heldout_rms
