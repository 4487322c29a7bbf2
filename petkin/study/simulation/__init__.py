"""Simulating a study: settings and plan, scenes, images, blood, sidecars, truth."""

from petkin.study.simulation.planning import Plan, plan, tissue_model
from petkin.study.simulation.settings import PRESETS, SimulationSettings, read_settings

__all__ = ["PRESETS", "Plan", "SimulationSettings", "plan", "read_settings", "tissue_model"]
