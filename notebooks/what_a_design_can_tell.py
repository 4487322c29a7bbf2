# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # What could a scan tell, before it is made?
#
# Two protocols of the same length: frames of 10 s at first, or of a minute. Which effects could each ever show, after
# the kinetics are fitted again? d' says how far an effect at the end of its plausible range stands out of the noise
# then: near 4 it is seen nine times in ten, at a level of 1 %, by one who knows where to look; below 1.5 it cannot be
# seen.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

from petkin.study.diagnose import foresee_study
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin.study.simulate import simulate
from petkin.study.simulation import SimulationSettings

PROTOCOLS = {"first frames of 10 s": "18x10,4x60,4x120,15x300", "first frames of 60 s": "7x60,4x120,15x300"}

# %%
told, alike = {}, {}
with tempfile.TemporaryDirectory() as folder:
    for number, (name, frames) in enumerate(PROTOCOLS.items()):
        study = simulate(SimulationSettings(out=Path(folder) / str(number), frames=frames, noise=20.0, seed=1))
        ((_, visible),) = foresee_study(DiagnoseRequest(study, include=("blood_volume",)))
        told[name] = {one.hypothesis.name: one.detectability for one in visible}
        alike[name] = {one.hypothesis.name: one.partners[0][0] for one in visible if one.partners}
strength = pd.DataFrame(told)

# %% [markdown]
# Effects of the input are those that short frames show.

# %%
shown = ["arterial_delay", "dispersion", "dead_time", "gain_step", "randoms_offset", "input_scale"]
figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
strength.loc[shown[::-1]].clip(lower=0.05).plot.barh(ax=axes, width=0.75)
axes.set_xscale("log")
axes.axvline(1.5, color="0.6", lw=1)
axes.set_xlabel("d' at the end of the plausible range (left of the line: cannot be seen)")
axes.legend(frameon=False, loc="lower right")
figure.savefig("what_a_design_can_tell.png", dpi=120)
strength.loc[shown].round(1)

# %% [markdown]
# And what each would be taken for: an effect that stands out may still look like another.

# %%
pd.DataFrame(alike).loc[[name for name in shown if name in alike[next(iter(alike))]]]
