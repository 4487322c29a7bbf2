"""Hybrid: systems known in part, whose unknown part is identified from a few series of the same dynamics."""

from petkin.hybrid.aggregate import Aggregate, Attention, mean
from petkin.hybrid.checkpoint import load_model, load_tensors, save_tensors
from petkin.hybrid.decoders import Decoder
from petkin.hybrid.encoders import Curve, Head, Moments, SpatioTemporal, Stack
from petkin.hybrid.episodes import Dataset, episodes, of_others
from petkin.hybrid.field import HybridField
from petkin.hybrid.flow import Flow, RungeKutta
from petkin.hybrid.metrics import measure, measure_refined, signal_to_noise, valid_share
from petkin.hybrid.model import Encoded, HyperNetwork, Identifier
from petkin.hybrid.parallel import device, place, processes
from petkin.hybrid.refine import Refined, refine
from petkin.hybrid.residual import Network, Residual, into_rows, run_layers
from petkin.hybrid.schedule import Settings, learning_rate
from petkin.hybrid.strategies import STRATEGIES, find_strategy
from petkin.hybrid.task import Emission, Task
from petkin.hybrid.train import Run, train
from petkin.hybrid.uncertainty import ErrorBars, Spread, context_features, errors_of, teach_error_bars

__all__ = [
    "STRATEGIES",
    "Aggregate",
    "Attention",
    "Curve",
    "Dataset",
    "Decoder",
    "Emission",
    "Encoded",
    "ErrorBars",
    "Flow",
    "Head",
    "HybridField",
    "HyperNetwork",
    "Identifier",
    "Moments",
    "Network",
    "Refined",
    "Residual",
    "Run",
    "RungeKutta",
    "Settings",
    "SpatioTemporal",
    "Spread",
    "Stack",
    "Task",
    "context_features",
    "device",
    "episodes",
    "errors_of",
    "find_strategy",
    "into_rows",
    "learning_rate",
    "load_model",
    "load_tensors",
    "mean",
    "measure",
    "measure_refined",
    "of_others",
    "place",
    "processes",
    "refine",
    "run_layers",
    "save_tensors",
    "signal_to_noise",
    "teach_error_bars",
    "train",
    "valid_share",
]
