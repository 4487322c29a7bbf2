"""The learning tables, ours beside the published.

Published figures: Ye Y, Vadhavkar S, Jiang X, Missel R, Liu H, Wang L. Unsupervised learning of hybrid latent dynamics:
a learn-to-identify framework. arXiv:2403.08194v1, tables of sections 4.2 and 4.3 and appendix C, raw units.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from petkin.errors import InputError

PUBLISHED = Path(__file__).parent / "published" / "meta_hylad.csv"
_FILE = "learning.csv"
#: Metrics, the first the first to be printed, and what they are.
_SAID = {
    "mse_z": "MSE of states z",
    "mse_q": "MSE of the states that are seen",
    "mse_x": "MSE of pictures x",
    "mse_cp": "MSE of c_p",
    "mse_f": "MSE of f_NN",
    "vpt_z": "valid share of states",
    "vpt_x": "valid share of pictures",
}
_METRICS = tuple(_SAID)
_REFINED = "refined, "
#: In and out of distribution, as the splits of a test are called that has, or has not, a name.
_SPLITS = (("ID", "OOD"), ("", " OOD"))
_LEGEND = (
    "n: seeds, whose mean is shown; ratio: ours / paper. refined: c_p and c_n fitted to seven series, from what "
    "encoders say at once; others are then predicted from a start fitted to their first frames. The paper's are not "
    "refined."
)
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
        return table, str(row["dynamics"]), _REFINED + _decoded(decoder), split
    if table == "strategy":
        test = str(row["test"]) if split == "ID" else f"{row['test']} {split}"
        return table, _STRATEGIES[str(row["strategy"])], f"k{row['k_train']}", test
    if decoder == "physics":
        return table, str(row["dynamics"]), _decoded(decoder), split
    return "baselines", str(row["dynamics"]), decoder, split


def _decoded(decoder: str) -> str:
    """How the published table calls a decoder."""
    return "physics_decoder" if decoder == "physics" else decoder


def print_tables(results: Path, preset: str) -> None:
    """To the terminal, a table a system and metric that fits into 80 columns."""
    found, console = compare(results, preset), Console()
    console.print(_LEGEND)
    for table, system in found[["table", "system"]].drop_duplicates().itertuples(index=False, name=None):
        for metric in (m for m in _METRICS if m in set(found["metric"])):
            rows = found.index[(found["table"] == table) & (found["system"] == system) & (found["metric"] == metric)]
            if len(rows):
                console.print(f"{table}: {system}, {_SAID[metric]}")
                console.print(_table(found.loc[rows]))


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    return [dict(zip(table.columns, row)) for row in table.itertuples(index=False, name=None)]


def _table(part: pd.DataFrame) -> Table:
    """Models, each with what refining makes of it, in and out of distribution."""
    figures = {(f["method"], f["variant"], f["split"]): f for f in _records(part)}
    columns = ("", "paper", "ratio") if any(pd.notna(f["published"]) for f in figures.values()) else ("",)
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("", no_wrap=True)
    for column in ("n", *(name or split for split in _SPLITS[0] for name in columns)):
        table.add_column(column, justify="right", no_wrap=True)
    for method, variant, tested in _lines(figures):
        keys = [(method, variant, f"{tested}{split}") for split in _SPLITS[tested != ""]]
        told = [figures.get((method, variant.removeprefix(_REFINED), split)) for _, _, split in keys]
        pair = [figures.get(key) for key in keys]
        cells = [cell for ours, like in zip(pair, told) for cell in _cells(ours, like)[: len(columns)]]
        table.add_row(_name(method, variant, tested), str(next(f["count"] for f in pair if f)), *cells)
    return table


def _lines(figures: Mapping[tuple[str, str, str], object]) -> list[tuple[str, str, str]]:
    """Method, variant and what it was tested on, refined ones after their like."""
    lines = dict.fromkeys((m, v, "" if s in ("ID", "OOD") else s.removesuffix(" OOD")) for m, v, s in figures)
    first = list(dict.fromkeys((m, v.removeprefix(_REFINED)) for m, v, _ in lines))
    return sorted(lines, key=lambda line: (first.index((line[0], line[1].removeprefix(_REFINED))), _REFINED in line[1]))


def _name(method: str, variant: str, tested: str) -> str:
    if variant.startswith(_REFINED):
        return "  refined"
    model = method.removesuffix("_hylad").replace("_", " ")
    variant = "" if variant == "physics_decoder" else f" {variant.replace('_', ' ')}"
    return f"{model}{variant}{', ' if tested else ''}{tested}"


def _cells(ours: Mapping[str, Any] | None, like: Mapping[str, Any] | None) -> tuple[str, str, str]:
    """Ours, the published figure (refined ones stand beside that of their like), the ratio."""
    if ours is None:
        return "", "", ""
    published = float(like["published"]) if like else float("nan")
    ratio = ours["mean"] / published if published else float("nan")
    return short(ours["mean"]), short(published), short(ratio)


def short(value: float) -> str:
    """Two digits in seven letters at most."""
    if pd.isna(value):
        return ""
    if value == 0 or 0.01 <= abs(value) < 1000:
        return f"{value:.2g}" if abs(value) < 100 else f"{value:.0f}"
    digits, _, power = f"{value:.1e}".partition("e")
    return f"{digits}e{int(power)}"
