"""Phantoms: where tissue is, and which kinetics it has."""

from petkin.phantoms.definition import Folds, HalfSpace, Phantom, Region, Shape
from petkin.phantoms.painting import PaintedPhantom, paint
from petkin.phantoms.population import (
    SYMBOLS,
    Blood,
    ParentFraction,
    Population,
    Spread,
    draw_kinetics,
    draw_voxels,
    population_names,
    read_population,
)
from petkin.phantoms.reading import catalogue_folder, phantom_names, phantom_with, read_phantom
from petkin.phantoms.streams import random_stream

__all__ = [
    "SYMBOLS",
    "Blood",
    "Folds",
    "HalfSpace",
    "PaintedPhantom",
    "ParentFraction",
    "Phantom",
    "Population",
    "Region",
    "Shape",
    "Spread",
    "catalogue_folder",
    "draw_kinetics",
    "draw_voxels",
    "paint",
    "phantom_names",
    "phantom_with",
    "population_names",
    "random_stream",
    "read_phantom",
    "read_population",
]
