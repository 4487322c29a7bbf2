"""The learning tables, ours beside the published.

Published figures: Ye Y, Vadhavkar S, Jiang X, Missel R, Liu H, Wang L. Unsupervised learning of hybrid latent dynamics:
a learn-to-identify framework. arXiv:2403.08194v1, tables of sections 4.2 and 4.3 and appendix C, raw units.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table

from petkin.errors import InputError

PUBLISHED = Path(__file__).parent / "published" / "meta_hylad.csv"
_FILE = "learning.csv"
_METRICS = ("mse_x", "mse_z", "mse_q", "vpt_x", "vpt_z", "mse_cp", "mse_f")
#: Ours -> the paper's names where they differ.
_THEIRS = {"mse_f": "mse_cn"}
_STRATEGIES = {"reconstruct": "recon_hylad", "meta": "meta_hylad", "mixed": "mixed_hylad"}


def compare(results: Path, preset: str) -> pd.DataFrame:
    """One row a figure: which it is, ours with spread over seeds, the published one, the ratio.

    Raises:
        InputError: no results of this preset.
    """
    rows = read_rows(results).query("preset == @preset")
    if rows.empty:
        raise InputError(f"{results / _FILE}: no rows of preset {preset!r}.")
    tables, methods, variants, splits = zip(*(_names(row) for row in _records(rows)))
    rows = rows.assign(table=tables, method=methods, variant=variants, split=splits)
    keys = ["table", "system", "method", "variant", "split", "metric"]
    long = rows.melt([*keys[:-1], "seed"], [m for m in _METRICS if m in rows], "metric")
    ours = long.dropna().groupby(keys, sort=False)["value"].agg(["mean", "std", "count"]).reset_index()
    theirs = pd.read_csv(PUBLISHED).rename(columns={"mean": "published", "std": "published_spread"})
    theirs["metric"] = theirs["metric"].replace({b: a for a, b in _THEIRS.items()})
    found = ours.merge(theirs, on=keys, how="left")
    return found.assign(ratio=found["mean"] / found["published"])


def read_rows(results: Path) -> pd.DataFrame:
    """All rows; those from before decoders could be chosen have the system's own.

    Raises:
        InputError: there are none.
    """
    path = results / _FILE
    if not path.is_file():
        raise InputError(f"{path}: there are no results yet; make some with petkin-bench run.")
    table = pd.read_csv(path)
    return table.assign(decoder=table["decoder"].fillna("physics") if "decoder" in table else "physics")


def _names(row: Mapping[str, object]) -> tuple[str, str, str, str]:
    """Table, method, variant and split as the published tables name them."""
    table, split, decoder = (str(row[name]) for name in ("table", "split", "decoder"))
    if row["test"] == "refined":
        return table, str(row["dynamics"]), f"refined, {decoder}", split
    if table == "strategy":
        test = str(row["test"]) if split == "ID" else f"{row['test']} {split}"
        return table, _STRATEGIES[str(row["strategy"])], f"k{row['k_train']}", test
    if decoder == "physics":
        return table, str(row["dynamics"]), "physics_decoder", split
    return "baselines", str(row["dynamics"]), decoder, split


def print_tables(results: Path, preset: str) -> None:
    """To the terminal, a table a system."""
    found, console = compare(results, preset), Console()
    for name, system in found[["table", "system"]].drop_duplicates().itertuples(index=False, name=None):
        rows = found.index[(found["table"] == name) & (found["system"] == system)]
        console.print(_table(f"{name}: {system} (ours / published = ratio)", found.loc[rows]))


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    return [dict(zip(table.columns, row)) for row in table.itertuples(index=False, name=None)]


def _table(title: str, part: pd.DataFrame) -> Table:
    table = Table(title=title, title_justify="left")
    metrics = [m for m in _METRICS if m in set(part["metric"])]
    for column in ("method", "split", "seeds", *metrics):
        table.add_column(column, no_wrap=True)
    rows: dict[tuple[str, str], dict[str, str]] = {}
    for figure in _records(part):
        cells = rows.setdefault((f"{figure['method']}\n{figure['variant']}", str(figure["split"])), {})
        cells["seeds"] = str(figure["count"])
        cells[str(figure["metric"])] = _cell(figure["mean"], figure["published"], figure["ratio"])
    for names, cells in rows.items():
        table.add_row(*names, *(cells.get(column, "") for column in ("seeds", *metrics)))
    return table


def _cell(ours: float, published: float, ratio: float) -> str:
    return f"{ours:.2g}" if pd.isna(published) else f"{ours:.2g} / {published:.2g}\n= {ratio:.2g}"
