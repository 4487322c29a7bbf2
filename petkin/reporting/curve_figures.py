"""Regional curves with their fits, and what the fits leave."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.results import FitResult, Status
from petkin.imaging import FrameSchedule
from petkin.reporting.canvas import (
    DATA_INK,
    EXCLUDED_INK,
    FAINT,
    FIT_INK,
    QUIET,
    Picture,
    drawable,
    new_figure,
    picture,
    square_root_time,
)
from petkin.reporting.contents import RegionCurves
from petkin.reporting.residuals import percent_rms, sign_runs, standardised_residuals
from petkin.reporting.wording import number, percent, status_short

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Residual maps end here; beyond it a misfit is a misfit, however large.
_RESIDUAL_LIMIT = 4.0
_SHOWN = 12


def chosen_regions(fit: FitResult) -> list[int]:
    """Twelve regions to show first: the six with the largest chi2 (none counts as largest), six over the rest."""
    n = fit.status.size
    if n <= _SHOWN:
        return list(range(n))
    worst_first = np.argsort(-np.where(np.isfinite(fit.chi2), fit.chi2, np.inf), kind="stable")
    worst, rest = worst_first[: _SHOWN // 2], np.sort(worst_first[_SHOWN // 2 :])
    spread = rest[np.linspace(0, rest.size - 1, _SHOWN - _SHOWN // 2).round().astype(int)]
    return sorted({int(i) for i in (*worst, *spread)})


def curve_pictures(curves: RegionCurves, fit: FitResult, regions: list[int]) -> list[Picture]:
    """One small picture a region, so that a page can set them in as many columns as it is wide."""
    if not regions:
        return []
    residuals = standardised_residuals(curves, fit)
    panel = CurvePanel(curves, fit, residuals)
    pictures = []
    for r in regions:
        panel.show(r)
        heading, caption = f"{r + 1}. {curves.names[r]}", _caption(curves, fit, r)
        pictures.append(picture(panel.figure, alt=_describe(curves, residuals, r), heading=heading, caption=caption))
    return pictures


class CurvePanel:
    """One figure that is redrawn for region after region: setting up axes costs more than drawing them."""

    def __init__(self, curves: RegionCurves, fit: FitResult, residuals: NDArray[np.float64]) -> None:
        self._curves, self._fit, self._residuals = curves, fit, residuals
        self._weights = np.broadcast_to(np.asarray(fit.weights), curves.tacs.shape)
        self.figure: Figure = new_figure(3.9, 3.15)
        self._top = self.figure.add_axes((0.155, 0.40, 0.825, 0.575))
        self._low = self.figure.add_axes((0.155, 0.145, 0.825, 0.20))
        for ax in (self._top, self._low):
            _time_axis(ax, curves.frames)
        self._top.tick_params(labelbottom=False)
        self._top.set_ylabel("activity (kBq/mL)")
        self._low.set_xlabel(_time_label(curves.frames))
        self._low.set_ylabel("residual (SD)")
        self._low.axhspan(-2, 2, color=FAINT, alpha=0.5, linewidth=0)
        self._low.axhline(0, color=QUIET, linewidth=0.6)
        bar = {"linewidth": 2.0, "solid_capstyle": "round"}
        self._fitted = self._top.plot([], [], color=FIT_INK, linewidth=1.1, zorder=2)[0]
        self._measured = self._top.plot([], [], color=DATA_INK, zorder=3, **bar)[0]
        self._excluded = self._top.plot([], [], color=EXCLUDED_INK, zorder=3, **bar)[0]
        self._stems = self._low.plot([], [], color=DATA_INK, linewidth=0.7)[0]
        self._left_over = self._low.plot([], [], color=DATA_INK, **bar)[0]
        self._note = self._top.text(0.5, 0.5, "", transform=self._top.transAxes, ha="center", color=QUIET)

    def show(self, region: int) -> None:
        """Draw this region."""
        frames, tac = self._curves.frames, self._curves.tacs[region]
        used = self._weights[region] > 0
        predicted = None if self._fit.predicted is None else self._fit.predicted[region]
        residual = self._residuals[region]
        self._measured.set_data(*_bars(frames, np.where(used, tac, np.nan)))
        self._excluded.set_data(*_bars(frames, np.where(used, np.nan, tac)))
        self._fitted.set_data(*_line(frames, np.full(len(frames), np.nan) if predicted is None else predicted))
        self._left_over.set_data(*_bars(frames, residual))
        self._stems.set_data(*_stems(frames, residual))
        self._top.set_ylim(*_range(tac, predicted))
        _residual_axis(self._low, _largest(residual))
        self._note.set_text(_why_empty(self._fit, tac, region))


def heat_figure(curves: RegionCurves, fit: FitResult) -> Figure:
    """Standardised residuals, one row a region, one column a frame."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    residuals = standardised_residuals(curves, fit)
    rows, columns = residuals.shape
    height = 1.1 + max(0.16 * rows, 0.8)
    figure = new_figure(9.0, height)
    ax = figure.add_axes((0.25, 0.6 / height, 0.64, (height - 0.75) / height))
    colouring = ScalarMappable(Normalize(-_RESIDUAL_LIMIT, _RESIDUAL_LIMIT, clip=True), "RdBu_r")
    rgba = np.asarray(colouring.to_rgba(np.nan_to_num(residuals, posinf=99, neginf=-99)))
    rgba[np.isnan(residuals)] = (0.8, 0.8, 0.8, 1.0)
    ax.imshow(rgba, aspect="auto", interpolation="none")
    ax.set_yticks(range(rows), [f"{r + 1}  {drawable(name)}" for r, name in enumerate(curves.names)], fontsize=7)
    for label in ax.get_yticklabels():
        label.set_parse_math(False)
    ticks = np.unique(np.linspace(0, columns - 1, min(columns, 12)).round().astype(int))
    ax.set_xticks(ticks, [f"{k + 1}\n{number(float(curves.frames.mid[k]), 2)}" for k in ticks])
    ax.set_xlabel("frame number, and its middle (min)")
    ax.tick_params(length=0)
    tall = min(height - 0.75, 1.8)
    cax = figure.add_axes((0.91, (height - 0.15 - tall) / height, 0.014, tall / height))
    bar = figure.colorbar(colouring, cax=cax, extend="both", extendfrac=0.05)
    bar.set_label("residual (SD)")
    if bar.solids is not None:
        bar.solids.set_rasterized(True)
    return figure


def heat_picture(curves: RegionCurves, fit: FitResult) -> Picture | None:
    """The heat map with its numbers in words; None where nothing was predicted."""
    residuals = standardised_residuals(curves, fit)
    if not np.isfinite(residuals).any():
        return None
    r, k = np.unravel_index(np.nanargmax(np.abs(residuals)), residuals.shape)
    worst = f"{number(float(residuals[r, k]), 2)}, in {curves.names[r]}, frame {k + 1}"
    beyond = float(np.mean(np.abs(residuals[np.isfinite(residuals)]) > 2))
    alt = (
        f"Standardised residuals of {len(curves)} regions in {len(curves.frames)} frames: {percent(100 * beyond)} lie "
        f"beyond 2 SD (5 % expected); the largest, {worst}."
    )
    return picture(heat_figure(curves, fit), alt=alt, caption=alt)


def spreads_early(frames: FrameSchedule) -> bool:
    """Whether half of the frames crowd into the first quarter of the scan."""
    return bool(np.median(frames.mid) < 0.25 * frames.end[-1]) and frames.end[-1] > 0


def _time_axis(ax: Axes, frames: FrameSchedule) -> None:
    end = float(frames.end[-1])
    if spreads_early(frames):
        square_root_time(ax, end)
    ax.set_xlim(min(0.0, float(frames.start[0])), end)
    for k in np.flatnonzero(frames.gaps > 0):
        ax.axvspan(float(frames.end[k]), float(frames.start[k + 1]), color=FAINT, alpha=0.6, linewidth=0)


def _residual_axis(ax: Axes, largest: float) -> None:
    from matplotlib.ticker import FixedLocator, MaxNLocator

    limit = max(3.2, 1.12 * largest)
    ax.yaxis.set_major_locator(FixedLocator([-2, 0, 2]) if limit < 6 else MaxNLocator(3, symmetric=True))
    ax.set_ylim(-limit, limit)


def _time_label(frames: FrameSchedule) -> str:
    return "time (min), square-root scale" if spreads_early(frames) else "time (min)"


def _bars(frames: FrameSchedule, values: NDArray) -> tuple[NDArray, NDArray]:
    """Horizontal bars over their frames as one broken line."""
    nan = np.full(len(frames), np.nan)
    return np.stack([frames.start, frames.end, nan], 1).ravel(), np.stack([values, values, nan], 1).ravel()


def _stems(frames: FrameSchedule, values: NDArray) -> tuple[NDArray, NDArray]:
    nan = np.full(len(frames), np.nan)
    return np.stack([frames.mid, frames.mid, nan], 1).ravel(), np.stack([0 * values, values, nan], 1).ravel()


def _line(frames: FrameSchedule, values: NDArray) -> tuple[NDArray, NDArray]:
    """Frame averages joined at mid-frame, broken at interruptions of the scan."""
    breaks = np.flatnonzero(frames.gaps > frames.duration[:-1]) + 1
    return np.insert(frames.mid, breaks, np.nan), np.insert(np.asarray(values, np.float64), breaks, np.nan)


def _range(tac: NDArray, predicted: NDArray | None) -> tuple[float, float]:
    values = np.concatenate([tac, tac if predicted is None else predicted])
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    low = min(low, 0.0)
    margin = 0.06 * (high - low) or 1.0
    return low - (margin if low < 0 else 0.0), high + margin


def _largest(values: NDArray) -> float:
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if finite.size else 0.0


def _why_empty(fit: FitResult, tac: NDArray, region: int) -> str:
    if not np.isfinite(tac).any():
        return "no data"
    if fit.predicted is None or not np.isfinite(fit.predicted[region]).any():
        return (
            f"no fit: {status_short(Status(int(fit.status[region])))}" if fit.status[region] else "no fitted curve kept"
        )
    return ""


def _caption(curves: RegionCurves, fit: FitResult, region: int) -> str:
    status = Status(int(fit.status[region]))
    parts = [] if status == Status.OK else [status_short(status)]
    parts.append(f"χ² {number(float(fit.chi2[region]))}")
    if fit.predicted is not None:
        rms = percent_rms(curves.tacs[region], fit.predicted[region])
        parts.append(f"misfit {percent(rms)} of peak (rms)")
        runs = sign_runs(curves, fit, region)
        if runs.systematic:
            parts.append(f"systematic: {runs.found} runs of one sign, {runs.expected:.0f} expected")
    return ", ".join(parts)


def _describe(curves: RegionCurves, residuals: NDArray, region: int) -> str:
    tac, frames = curves.tacs[region], curves.frames
    text = f"{curves.names[region]}: {len(frames)} frames"
    if np.isfinite(tac).any():
        k = int(np.nanargmax(tac))
        text += f", peak {number(float(tac[k]))} kBq/mL at {number(float(frames.mid[k]))} min"
    if np.isfinite(residuals[region]).any():
        worst = int(np.nanargmax(np.abs(residuals[region])))
        text += f"; largest residual {number(float(residuals[region][worst]), 2)} SD in frame {worst + 1}"
    return text + "."
