"""What a simulated study says the answer is."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from petkin.io import read_table
from petkin.io.descriptions import MEASURE_UNITS
from petkin.io.names import kinpar_path
from petkin.kinetics import MODELS
from petkin.reporting import TruthRow
from petkin.study.simulation.truth import SEGMENTATION, TRUTH, TRUTH_FOLDER
from petkin.study.sources import Source


def known_truth(study: Path, source: Source) -> tuple[TruthRow, ...]:
    """True regional values that `petkin simulate` left beside a study; none for real data."""
    for model in MODELS:
        path = study / TRUTH_FOLDER / kinpar_path(source.entities, model.label, seg=SEGMENTATION, desc=TRUTH)
        if path.is_file():
            return _rows(path)
    return ()


def _rows(path: Path) -> tuple[TruthRow, ...]:
    table = read_table(path)
    rows = []
    for measure in (column for column in table.columns if column not in ("index", "name")):
        symbol, unit = ("vB" if measure == "VB" else str(measure)), MEASURE_UNITS.get(str(measure), "1")
        for name, value in zip(table["name"], table[measure].to_numpy(np.float64)):
            rows.append(TruthRow(str(name), symbol, unit, float(value), float("nan")))
    return tuple(rows)
