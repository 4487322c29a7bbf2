"""The PET table, ours beside the published one (arXiv:2403.08194v1, table of its appendix on dynamic PET)."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from rich.console import Console
from rich.table import Table

from petkin_bench.learning_tables import PUBLISHED
from petkin_bench.pet import FILE

_METRICS = ("mse_z", "mse_x", "psnr_x")
_HEADS = ["model", "sees", "noise_train", "noise_test", "split", "test"]


def compare_pet(results: Path, preset: str) -> pd.DataFrame:
    """One row a model and test: mean and spread over seeds, and the published figures where it has them."""
    path = results / f"{FILE}.csv"
    if not path.is_file():
        return pd.DataFrame()
    rows = pd.read_csv(path).query("preset == @preset")
    rows = rows.assign(sees=rows["sees"].fillna(""))
    if rows.empty:
        return rows
    columns = {m: (m, "mean") for m in _METRICS} | {f"{m}_spread": (m, "std") for m in _METRICS}
    columns |= {"seeds": ("seed", "nunique"), "cpu_s": ("cpu_s", "median")}
    found = pd.DataFrame(rows.groupby(_HEADS, sort=False).agg(**columns)).reset_index()
    published = pd.read_csv(PUBLISHED).query("table == 'pet'").pivot(index="method", columns="metric", values="mean")
    theirs = published[list(_METRICS)].add_suffix("_published").reset_index().rename(columns={"method": "model"})
    found = found.merge(theirs, on="model", how="left")
    same = (found["noise_test"].astype(float) == 0) & (found["split"] == "unseen") & (found["test"] == "others")
    found.loc[~same, [f"{m}_published" for m in _METRICS]] = float("nan")
    return found


def closed_share(found: pd.DataFrame, sees: str) -> float:
    """Share of the gap between purely and full physics that Meta-HyLaD closes: state MSE, unseen subjects, no noise."""
    rows = found.query("split == 'unseen' and test == 'others' and noise_test == 0 and noise_train == 0")
    error = {(row["model"], row["sees"]): float(row["mse_z"]) for row in rows.to_dict("records")}
    none, full = error["purely_physics", ""], error["full_physics", ""]
    return (none - error["meta_hylad", sees]) / (none - full)


def print_pet(results: Path, preset: str) -> None:
    """To the terminal."""
    found = compare_pet(results, preset)
    if found.empty:
        return
    table = Table(title="pet (ours / published = ratio); noise in percent, train and test", title_justify="left")
    for name in ("model", "noise", "split", "told by", "seeds", "cpu s", *_METRICS):
        table.add_column(name, no_wrap=True)
    for row in found.to_dict("records"):
        names = f"{row['model']} {row['sees']}".strip(), f"{row['noise_train']:g}, {row['noise_test']:g}"
        cells = [_cell(row[m], row[f"{m}_published"]) for m in _METRICS]
        table.add_row(*names, row["split"], row["test"], str(row["seeds"]), f"{float(row['cpu_s']):.0f}", *cells)
    Console().print(table)


def _cell(ours: float, published: float) -> str:
    return f"{ours:.3g}" if pd.isna(published) else f"{ours:.3g} / {published:.3g} = {ours / published:.2f}"
