"""What a diagnosis starts from: regional curves of every scan, and the simulator that they are compared with."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from petkin.errors import InputError
from petkin.imaging import FrameObservation
from petkin.io import RegionalCurves, require_cover
from petkin.study.arterial import Reading, arterial_input
from petkin.study.diagnosis.blood import allowing, errors_of, read_at, reading_nodes, recorded_input
from petkin.study.diagnosis.including import settled
from petkin.study.diagnosis.regional import RegionalSimulator
from petkin.study.diagnosis.request import FITTED, DiagnoseRequest
from petkin.study.reading import read_sources
from petkin.study.request import FitRequest
from petkin.study.series import regional_curves
from petkin.study.sources import Source

#: Fewer frames than this with activity cannot carry a diagnosis.
_FEWEST_FRAMES = 10


def sources_of(request: DiagnoseRequest) -> tuple[str, Path, tuple[Source, ...]]:
    """Name of the study, folder for its results, and the scans that the request means."""
    return read_sources(_reading(request))


def _reading(request: DiagnoseRequest) -> FitRequest:
    return FitRequest(
        target=request.target,
        out=request.out,
        models=(request.compartments.label,),
        level="region",
        subjects=request.subjects,
        sessions=request.sessions,
        seg=request.seg,
        command_line=request.command_line,
    )


def prepared(source: Source, request: DiagnoseRequest) -> tuple[RegionalCurves, RegionalSimulator]:
    """Regional curves of a scan, and the simulator that they are compared with; settings of what it includes are those
    that suit the curves.

    Raises:
        InputError: no curves, no blood, too few frames, or values that are not finite.
    """
    curves = regional_curves(source)
    if source.blood is None:
        raise InputError(f"{source.label}: there is no blood (_blood.tsv); the simulator needs an arterial input.")
    _check(curves, source.label)
    require_cover(source.blood, source.frames)
    end = float(curves.frames.end[-1])
    fitted = request.blood == FITTED
    arterial = arterial_input(source, Reading()) if fitted else recorded_input(source.blood, end)
    nodes = reading_nodes(arterial, end)
    errors = errors_of(arterial, nodes, request.blood)
    arterial = allowing(arterial, nodes, errors, request.blood)
    simulator = RegionalSimulator(
        curves.names,
        request.compartments.label,
        read_at(arterial, nodes),
        FrameObservation(curves.frames, source.decay),
        request.included,
        nodes,
        frozenset({"parent_fraction"}) if source.blood.metabolites_measured else frozenset(),
        errors=errors,
    )
    return curves, settled(simulator, curves.values)


def _check(curves: RegionalCurves, label: str) -> None:
    if not np.isfinite(curves.values).all():
        r, k = np.argwhere(~np.isfinite(curves.values))[0]
        raise InputError(
            f"{label}: region {curves.names[r]!r} has no finite value in frame {k + 1}; leave the region out."
        )
    if curves.values.shape[1] < _FEWEST_FRAMES:
        raise InputError(
            f"{label}: {curves.values.shape[1]} frames are too few for a diagnosis; {_FEWEST_FRAMES} is the least."
        )
    for name, row in zip(curves.names, curves.values):
        if not row.max() > 0:
            raise InputError(f"{label}: region {name!r} holds no activity in any frame; leave it out.")
