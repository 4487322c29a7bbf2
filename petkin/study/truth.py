"""What a simulated study says the answer is."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import numpy as np

from petkin.io import read_table
from petkin.io.descriptions import measure_name
from petkin.io.names import kinpar_path
from petkin.kinetics import MODELS, CompartmentModel
from petkin.reporting import TruthRow
from petkin.study.sources import Source

#: Folder below a simulated study, and label of the segmentation.
TRUTH_FOLDER = PurePosixPath("derivatives/phantom")
SEGMENTATION = "phantom"
#: desc label of everything that holds the truth, and of curves without noise.
TRUTH, NOISE_FREE = "truth", "noisefree"


def known_truth(study: Path, source: Source) -> tuple[TruthRow, ...]:
    """True regional values that `petkin simulate` left beside a study; none for real data."""
    for model in MODELS:
        path = study / TRUTH_FOLDER / kinpar_path(source.entities, model.label, seg=SEGMENTATION, desc=TRUTH)
        if path.is_file():
            return _rows(path, model)
    return ()


def _rows(path: Path, model: CompartmentModel) -> tuple[TruthRow, ...]:
    table = read_table(path)
    rows = []
    for quantity in (q for q in model.quantities if measure_name(q.symbol) in table):
        values = table[measure_name(quantity.symbol)].to_numpy(np.float64)
        for name, value in zip(table["name"], values):
            rows.append(TruthRow(str(name), quantity.symbol, quantity.unit, float(value), float("nan")))
    return tuple(rows)
