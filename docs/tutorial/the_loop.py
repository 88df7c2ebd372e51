"""The tutorial as a notebook: cells that Jupyter (with Jupytext) and editors run one by one."""

# %% [markdown]
# # The loop in a notebook
#
# A robot is measured, a model is fitted, and the diagnosis says what is missing. It takes about half
# a minute. The tests run it.

# %%
import tempfile
from pathlib import Path

import clampid

folder = Path(tempfile.mkdtemp())

# %% [markdown]
# ## Measure
#
# The virtual robot hides an effect that the start model lacks: gear eccentricity at joint 3. Only poses are
# measured.

# %%
made = clampid.simulate(
    folder / "arm", "kuka_kr20_r1810", ["gear_eccentricity@joint3"], seed=3, poses=60, tables=("poses",)
)
campaign = clampid.read_campaign(made)

# %% [markdown]
# ## Fit and compare
#
# The error on poses that the fit did not see is far above the noise floor.

# %%
model = clampid.identify(campaign)
comparison = clampid.compare(model, campaign)
print(comparison.summary())
comparison.plot()

# %% [markdown]
# ## Diagnose
#
# There are four verdicts. Each needs another next step, so a script asks which one it is.

# %%
diagnosis = clampid.diagnose(model, campaign)
poses = diagnosis.stages["poses"]
print(diagnosis.summary())
diagnosis.to_frame()

# %% [markdown]
# ## Act on the verdict
#
# `missing`: the candidates are added. `ambiguous`: several effects explain the data equally well. Whatever is confirmed
# is added first. Of the rest none is added, because these poses do not separate them. The diagnosis says what to
# measure instead. `unknown` and `adequate`: there is nothing to add.

# %%
confirmed = [f"poses={c['name']}@{place}" for c in poses.candidates if not c["alternative"] for place in c["where"]]
alternatives = [c["name"] for c in poses.candidates if c["alternative"]]
mended = model
if confirmed:
    mended, addition = clampid.add(model, campaign, confirmed)
    print(addition.summary())
if poses.verdict == "ambiguous":
    print(f"These data do not distinguish {' and '.join(alternatives)}.")
    print(f"Measure next: {poses.next_measurement}")
elif poses.verdict == "unknown":
    print(f"No known effect explains an error that depends on {', '.join(poses.depends_on)}.")
else:
    print("No further effect was found.")

# %% [markdown]
# ## Measure what decides
#
# A log of torques in free air shows a balancer's torque, and does not show a gear's error. So the same arm is measured
# again, with such a log. What poses alone had confirmed is tested again, too, with loads and friction from the log.

# %%
if poses.verdict == "ambiguous":
    made = clampid.simulate(
        folder / "both",
        "kuka_kr20_r1810",
        ["gear_eccentricity@joint3"],
        seed=3,
        poses=60,
        tables=("free_air", "poses"),
    )
    both = clampid.read_campaign(made)
    mended, diagnosis = clampid.auto(both)
    print(diagnosis.summary())

# %%
print(clampid.compare(mended, both if poses.verdict == "ambiguous" else campaign).summary())
