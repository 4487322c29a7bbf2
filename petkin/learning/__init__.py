"""Learning: tissue known in part, identified by the hybrid engine from frames under known inputs."""

from petkin.learning.errors import SHARES, curve_errors, predict
from petkin.learning.flux import Course, Read, Reader, Scene, lacking
from petkin.learning.members import Members, open_members
from petkin.learning.population import PAPER, Population, draw
from petkin.learning.prior import Curves, Keep, TissuePrior, identify, learn
from petkin.learning.responses import Known, Responses
from petkin.learning.tissue import PRIORS, RESIDUALS, Conditions, tissue_model, tissue_task
from petkin.learning.tracer import (
    Identified,
    Mapped,
    Measured,
    conditions_of,
    drawn_curves,
    identify_scan,
    identify_voxels,
    together,
    train_tracer,
    try_out,
)

__all__ = [
    "PAPER",
    "PRIORS",
    "RESIDUALS",
    "SHARES",
    "Conditions",
    "Course",
    "Curves",
    "Identified",
    "Keep",
    "Known",
    "Mapped",
    "Measured",
    "Members",
    "Population",
    "Read",
    "Reader",
    "Responses",
    "Scene",
    "TissuePrior",
    "conditions_of",
    "curve_errors",
    "draw",
    "drawn_curves",
    "identify",
    "identify_scan",
    "identify_voxels",
    "lacking",
    "learn",
    "open_members",
    "predict",
    "tissue_model",
    "tissue_task",
    "together",
    "train_tracer",
    "try_out",
]
