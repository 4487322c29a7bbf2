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
# # Can the standard errors be believed?
#
# `petkin fit` puts a percent standard error and a status beside every estimate. If they are right, then over many
# regions the error of an estimate whose status is OK, divided by its standard error, scatters as a normal deviate:
# two thirds within 1, 95 % within 2. Where a parameter stands at a bound, or the data do not determine it, a flag
# says so, and no error can be believed.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from petkin.fitting import Status
from petkin.study.fit import fit_study
from petkin.study.request import FitRequest
from petkin.study.simulate import simulate
from petkin.study.simulation import SimulationSettings
from petkin.study.truth import known_truth

SYMBOLS = ("K1", "VT", "k3")

# %% [markdown]
# Eight people with sixteen regions each, and noise enough to leave some regions undetermined.

# %%
rows = []
with tempfile.TemporaryDirectory() as folder:
    settings = SimulationSettings(out=Path(folder) / "study", subjects=8, roi=16, voxel_size=8, noise=20.0, seed=3)
    study = simulate(settings)
    for fitted in fit_study(FitRequest(study, level="region")):
        fit, result = fitted.fit, fitted.fit.regional[0]
        truth = {(row.region, row.symbol): row.truth for row in known_truth(study, fit.source)}
        for symbol in SYMBOLS:
            for i, region in enumerate(fit.curves.names):
                se = result[symbol][i] * result.percent_se(symbol)[i] / 100
                flagged = result.status[i] != Status.OK
                rows.append((symbol, flagged, (result[symbol][i] - truth[region, symbol]) / se))
errors = pd.DataFrame(rows, columns=["symbol", "flagged", "z"])

# %%
figure, axes = plt.subplots(1, len(SYMBOLS), figsize=(8, 2.8), sharey=True, layout="constrained")
grid = np.linspace(-4, 4, 200)
for ax, symbol in zip(axes, SYMBOLS):
    of_it = errors.query("symbol == @symbol")
    z = [of_it.query("not flagged")["z"].clip(-4, 4), of_it.query("flagged")["z"].clip(-4, 4)]
    ax.hist(z, bins=np.linspace(-4, 4, 17), stacked=True, color=["0.75", "tab:red"], label=["OK", "flagged"])
    ax.plot(grid, 0.5 * len(z[0]) * np.exp(-(grid**2) / 2) / np.sqrt(2 * np.pi), label="as it should be")
    ax.set_title(symbol)
    ax.set_xlabel("error / standard error")
axes[0].set_ylabel("regions")
figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=3, frameon=False)
figure.savefig("how_sure_is_a_fit.png", dpi=120)

# %%
errors.groupby(["flagged", "symbol"])["z"].agg(
    regions="size",
    sd="std",
    within_1_SE=lambda z: (z.abs() <= 1).mean(),
    within_2_SE=lambda z: (z.abs() <= 2).mean(),
).round(2)
