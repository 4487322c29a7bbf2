"""What a fit report holds: plain values that the study layer fills, checked once before anything is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petkin.errors import InputError
from petkin.fitting.results import FitResult, Status
from petkin.imaging import FrameSchedule
from petkin.reporting.input_curves import InputCurves
from petkin.reporting.planes import Plane, orthogonal_planes


@dataclass(frozen=True)
class RegionCurves:
    """The measured regional curves that every model of a report was fitted to.

    Args:
        names: region names, R of them.
        frames: K frames.
        tacs: frame averages, kBq/mL, [R, K].
    """

    names: tuple[str, ...]
    frames: FrameSchedule
    tacs: NDArray[np.floating]

    def __post_init__(self) -> None:
        expected = (len(self.names), len(self.frames))
        if not self.names or np.shape(self.tacs) != expected:
            raise InputError(
                f"The report holds {expected[0]} region names and {expected[1]} frames but its curves have shape "
                f"{np.shape(self.tacs)}; give one row a region and one column a frame."
            )

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True)
class ParameterMap:
    """One fitted quantity over the voxels.

    Args:
        symbol: e.g. "VT"; "chi2" for the reduced chi-square.
        unit: unit of `value`; "" or "1" for none.
        value: one a voxel of the mask (N,), NaN where there is none; anything that becomes an array when it is asked.
        percent_se: standard error in percent of the value (N,), or None.
    """

    symbol: str
    unit: str
    value: ArrayLike
    percent_se: ArrayLike | None = None


@dataclass(frozen=True)
class MapSet:
    """The voxel maps of one model.

    Args:
        maps: one map a quantity.
        status: `petkin.fitting.results.Status` codes of the voxels in the mask (N,).
        mask: where they belong, [x, y, z], the first axis running fastest.
        voxel_mm: voxel edges along the three array axes, mm.
        axes: direction of rising index along each array axis, as `nibabel.aff2axcodes` gives it ("RAS", "LPS", ...);
            empty when it is not known: then planes are named after array axes and no side is marked.
        settings: what was chosen for the voxels (bounds, fixed values, smoothing, ...).
        remarks: what the voxel data cannot tell.
    """

    maps: tuple[ParameterMap, ...]
    status: NDArray[np.uint8]
    mask: NDArray[np.bool_]
    voxel_mm: tuple[float, float, float]
    axes: str = ""
    settings: Mapping[str, object] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    @cached_property
    def numbers(self) -> NDArray[np.int32]:
        """Which of the values a voxel has, [x, y, z]; -1 outside of the mask."""
        flat = np.full(self.mask.size, -1, np.int32)
        flat[self.mask.ravel(order="F")] = np.arange(self.status.size, dtype=np.int32)
        return flat.reshape(self.mask.shape, order="F")

    @cached_property
    def planes(self) -> list[Plane]:
        """Where its pictures are cut."""
        return orthogonal_planes(self.mask, self.voxel_mm, self.axes)

    def __post_init__(self) -> None:
        if self.mask.ndim != 3:
            raise InputError(f"The mask of a report's maps has shape {self.mask.shape}; it must have three axes.")
        _check_codes(self.status, "The status map of a report")
        inside = (int(np.count_nonzero(self.mask)),)
        shapes = {"status": self.status.shape}
        for entry in self.maps:
            shapes |= {entry.symbol: np.shape(entry.value)}
            shapes |= {} if entry.percent_se is None else {f"SE of {entry.symbol}": np.shape(entry.percent_se)}
        for name, shape in shapes.items():
            if shape != inside:
                raise InputError(
                    f"The {name} map of a report has shape {shape} but its mask holds {inside[0]} voxels; give one "
                    "value a voxel."
                )
        if self.axes and sorted(map("RLAPSI".find, self.axes.upper())) not in _one_of_each():
            raise InputError(f"Axis directions {self.axes!r} are not three of R/L, A/P and S/I; give e.g. 'RAS'.")


def _check_codes(codes: NDArray[np.uint8], where: str) -> None:
    unknown = sorted({int(c) for c in np.unique(codes)} - {int(s) for s in Status})
    if unknown:
        raise InputError(f"{where} holds the code {unknown[0]}, which is no status; use 0 to {max(Status)}.")


def _one_of_each() -> list[list[int]]:
    return [[x, y, z] for x in (0, 1) for y in (2, 3) for z in (4, 5)]


@dataclass(frozen=True)
class TruthRow:
    """One known value of a simulated study beside its estimate."""

    region: str
    symbol: str
    unit: str
    truth: float
    estimate: float

    @property
    def percent_error(self) -> float:
        """100 (estimate - truth) / |truth|; NaN for a truth of zero."""
        return 100.0 * (self.estimate - self.truth) / abs(self.truth) if self.truth else float("nan")


@dataclass(frozen=True)
class ModelSection:
    """One model's part of a report.

    Args:
        model: label, e.g. "2TCM".
        regional: the fit of the report's regional curves, in their order, or None.
        maps: voxel maps, or None.
        truth: known values of a simulated study.
        equations: the model as lines of plain text.
        methods: paragraphs of plain text.
        citations: references as plain text ("Innis RB et al. 2007, doi:...").
        comparable: False where AICc lives on other data than the frames (graphical methods).
    """

    model: str
    regional: FitResult | None = None
    maps: MapSet | None = None
    truth: tuple[TruthRow, ...] = ()
    equations: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    citations: tuple[str, ...] = ()
    comparable: bool = True

    def __post_init__(self) -> None:
        if self.regional is None and self.maps is None:
            raise InputError(f"The report's {self.model} section holds neither a regional fit nor maps; give one.")


@dataclass(frozen=True)
class FitReport:
    """A whole report; `petkin.reporting.write_fit_report` writes it.

    Args:
        title: heading.
        models: one section a model, in the order to show them.
        regions: the regional curves that every `ModelSection.regional` belongs to.
        input: the input function.
        scan: label and value of what is known of the scan (tracer, dose, frames, ...).
        command_line: what was typed.
        version: program and version.
        warnings: what was odd in the data, one sentence each.
        limits: what these data cannot tell, one sentence each.
        methods: paragraphs that hold for all models.
        citations: references that hold for all models.
        date: shown when given; nothing else in a report depends on the clock.
    """

    title: str
    models: tuple[ModelSection, ...]
    regions: RegionCurves | None = None
    input: InputCurves | None = None
    scan: tuple[tuple[str, str], ...] = ()
    command_line: str = ""
    version: str = ""
    warnings: tuple[str, ...] = ()
    limits: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    citations: tuple[str, ...] = ()
    date: str = ""

    def __post_init__(self) -> None:
        if not self.models:
            raise InputError("The report holds no model; give at least one fitted model.")
        for section in self.models:
            if section.regional is not None:
                _check_regional(section.regional, self.regions)


def _check_regional(fit: FitResult, regions: RegionCurves | None) -> None:
    if regions is None:
        raise InputError(f"The report holds a regional {fit.model} fit but no regional curves; give `regions`.")
    if fit.status.shape != (len(regions),):
        raise InputError(f"The {fit.model} fit has {fit.status.size} curves but the report {len(regions)} regions.")
    _check_codes(fit.status, f"The status of the {fit.model} fit")
    if fit.predicted is not None and fit.predicted.shape != regions.tacs.shape:
        raise InputError(
            f"The {fit.model} fit predicts shape {fit.predicted.shape} but the curves have {regions.tacs.shape}."
        )
