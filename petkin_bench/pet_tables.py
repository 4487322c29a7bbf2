"""The PET table, ours beside the published one (arXiv:2403.08194v1, table of its appendix on dynamic PET)."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from petkin_bench.learning_tables import PUBLISHED, short
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
    console, table = Console(), Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in ("", "noise", "split", "told by"):
        table.add_column(name, no_wrap=True)
    for name in ("n", "CPU s", "MSE z", "paper", "PSNR", "paper"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in found.to_dict("records"):
        model = f"{str(row['model']).removesuffix('_hylad').replace('_', ' ')} {row['sees']}".strip()
        noise = f"{row['noise_train']:g}, {row['noise_test']:g}"
        figures = short(row["cpu_s"]), short(row["mse_z"]) or "nan", short(row["mse_z_published"])
        peaks = (f"{row[name]:.1f}" for name in ("psnr_x", "psnr_x_published"))
        cells = (*figures, *peaks) if row["psnr_x_published"] > 0 else (*figures, next(peaks))
        table.add_row(model, noise, row["split"], row["test"], str(row["seeds"]), *cells)
    console.print("pet: states C_T and PSNR of pictures (dB); noise in percent, train and test")
    console.print(table)
