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
# # Which effect does my simulator lack, and what does it do to VT?
#
# A scan is made with a mistake in it that no simulator knows of: from 30 min on all values are 5 % too large, as
# after a bed that was calibrated anew. A fit does not show it: two tissue compartments bend until they follow.
# `petkin diagnose` asks what was missing, and what that did to the numbers.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

from petkin.study.diagnose import diagnose_study
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin.study.simulate import simulate
from petkin.study.simulation import SimulationSettings

folder = tempfile.TemporaryDirectory()
study = simulate(SimulationSettings(out=Path(folder.name) / "study", effects=("gain_step=0.05,onset=30",), seed=1))

# %% [markdown]
# The simulator has two tissue compartments, blood volume and a delay of the blood; all else in the catalogue is a
# candidate.

# %%
KNOWN = ("blood_volume", "arterial_delay")
(asked,) = diagnose_study(DiagnoseRequest(study, include=KNOWN))
print(asked.answer["verdict"]["sentence"])
cause = asked.answer["causes"][0]
pd.DataFrame(cause["estimate"]).T

# %% [markdown]
# What the refit had made of it stands in the answer for every region, without the cause and with it. Here the truth
# is known.

# %%
shift = pd.DataFrame(asked.answer["parameters"]).query("symbol == 'VT'").set_index("region")
truth = pd.read_csv(next(study.glob("derivatives/phantom/**/*kinpar.tsv")), sep="\t").set_index("name")["VT"]
shift["truth"] = truth.reindex(shift.index)

figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
for name, marker in (("before", "o"), ("after", "D")):
    label = {"before": "cause left out", "after": "cause put in"}[name]
    axes.plot(shift.index, 100 * (shift[name] / shift["truth"] - 1), marker, label=label)
axes.axhline(0, color="0.6", lw=1)
axes.set_ylabel("error of VT (%)")
axes.legend(frameon=False)
figure.savefig("what_is_missing.png", dpi=120)

# %% [markdown]
# A named cause may hide another. With it in the simulator, ask again.

# %%
(again,) = diagnose_study(DiagnoseRequest(study, include=(*KNOWN, *cause["effects"])))
print(again.answer["verdict"]["sentence"])

# %%
folder.cleanup()
