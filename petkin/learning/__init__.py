"""Learning: tissue known in part, identified by the hybrid engine from frames under known inputs."""

from petkin.learning.errors import SHARES, curve_errors, predict
from petkin.learning.population import PAPER, Population, draw
from petkin.learning.responses import Known, Responses
from petkin.learning.tissue import PRIORS, RESIDUALS, Conditions, tissue_model, tissue_task

__all__ = [
    "PAPER",
    "PRIORS",
    "RESIDUALS",
    "SHARES",
    "Conditions",
    "Known",
    "Population",
    "Responses",
    "curve_errors",
    "draw",
    "predict",
    "tissue_model",
    "tissue_task",
]
