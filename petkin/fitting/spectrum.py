"""Spectral analysis: as many exponentials as the curve asks for, their rates on a grid, their amplitudes not negative.

    C = (1 - vB) sum_j alpha_j e^{-a_j t} * C_P + vB C_B,   alpha_j >= 0
    K1 = sum_j alpha_j,   VT = sum_j alpha_j / a_j,   Ki = alpha at the slowest rate

No number of compartments is assumed. What the scan is too short to tell from trapping gathers at the slowest rate of
the grid, and VT then says more of the grid than of the tissue.

Errors come from a parametric bootstrap: a linear error with the rates that were found taken for known is several times
too small. Noise is not drawn about the fitted curve itself: amplitudes of noise alone, which lie on their bound or a
little off it, would scatter about where they happened to be, and errors come out too large (Andrews 2000). It is drawn
about a spectrum that leaves out what lies within the noise, the least of |z - C x|^2 + 2 lambda sum_j x_j with x >= 0
and columns C of length one. Most draws lie close together and a few, in which a slow exponential turns up, far away: no
normal distribution. An error is therefore what makes its 90 % interval hold 90 % of the draws, not that of 68 %.

References: Cunningham VJ, Jones T. J Cereb Blood Flow Metab 1993;13:15-23, doi:10.1038/jcbfm.1993.5; Veronese M et al.
Comput Math Methods Med 2016;2016:7187541, doi:10.1155/2016/7187541 (review); Andrews DWK. Econometrica
2000;68:399-405, doi:10.1111/1468-0262.00114 (bootstrap on a bound).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petkin.errors import InputError
from petkin.fitting.curves import check_shapes, finite_curves
from petkin.fitting.non_negative import solve_non_negative
from petkin.fitting.parts import in_parts
from petkin.fitting.results import Column, Estimate, FitResult, Plot, Status
from petkin.fitting.table import Compression, build_table, compress, project_rows
from petkin.imaging import FrameObservation
from petkin.inputs.input_function import InputFunction

Array = NDArray[np.float64]

#: Rates of the grid.
RATES = 100
#: Seed of all noise draws.
_SEED = 20260101
#: lambda over the noise of a curve.
_WITHIN_NOISE = 0.5
#: Square of the amplitudes' sum that comes with their penalty, beside the curve's own sum of squares.
_SLIGHT = 1e-6
#: Share of the draws that lies within so many standard errors, as in a normal distribution.
_HELD, _ERRORS = 0.9, 1.6449

_QUANTITIES = (
    ("VT", "mL cm^-3", "total distribution volume, the sum of all amplitudes over their rates"),
    ("K1", "mL cm^-3 min^-1", "rate of transfer from plasma to tissue, the sum of all amplitudes"),
    (
        "Ki",
        "mL cm^-3 min^-1",
        "net influx rate: the amplitude of the slowest rate, which the scan cannot tell from none",
    ),
    ("vB", "1", "fraction of the volume that is blood"),
)


@dataclass(frozen=True)
class SpectrumSettings:
    """How a spectrum is taken.

    Args:
        rate_bounds: slowest and fastest rate of the grid, 1/min.
        draws: noise draws of the bootstrap; n of them tell a standard error to 70 / sqrt(n) percent of it.
        size: compressed directions; None keeps all that carry signal.
        keep_predicted: return fitted curves and the spectra as a plot.
    """

    rate_bounds: tuple[float, float]
    draws: int = 200
    size: int | None = None
    keep_predicted: bool = True


def fit_spectrum(
    curves: NDArray[np.floating],
    arterial: InputFunction,
    observation: FrameObservation,
    weights: Array,
    settings: SpectrumSettings,
) -> FitResult:
    """Spectra of all curves (N, K) and what follows from them.

    Args:
        curves: kBq/mL.
        arterial: input function with its delay.
        observation: what frames report.
        weights: (K,), shared by all curves.
        settings: grid and errors.

    Returns:
        VT, K1, Ki, vB with percent standard errors, the number of components, status.

    Raises:
        InputError: shapes do not match, weights are not shared, or the slowest rate is 0.
    """
    curves, weights = np.asarray(curves), np.asarray(weights, np.float64)
    check_shapes(curves, weights, len(observation.frames))
    if weights.ndim != 1:
        raise InputError("Spectral analysis takes one weight a frame, shared by all curves; give one row of weights.")
    if settings.rate_bounds[0] <= 0.0:
        raise InputError("Spectral analysis needs a slowest rate above 0, or VT has no end; give e.g. --rates 0.001:5.")
    table = build_table(arterial, observation, rate_bounds=settings.rate_bounds, nodes=RATES)
    grid = _Grid.of(compress(table, weights, tolerance=1e-9, size=settings.size))
    finite, usable = finite_curves(curves)
    z = project_rows(grid.packed.project, usable)
    sizes = (weights * usable**2).sum(axis=1)
    spectra = grid.solve(z)
    fit = grid.columns.T @ spectra
    frames = int(np.count_nonzero(weights))
    active = np.count_nonzero(spectra, axis=0)
    wrss = np.maximum(sizes - (z * z).sum(axis=0), 0.0) + ((z - fit) ** 2).sum(axis=0)
    with np.errstate(all="ignore"):
        chi2 = wrss / np.where(frames > active, frames - active, np.nan)
        values = grid.values(spectra)
        percent = 100.0 * _bootstrap(grid, z, chi2, settings.draws) / np.abs(values)
        p = active + 1
        aicc = (
            frames * np.log(wrss / frames) + 2 * p + 2 * p * (p + 1) / np.where(frames > p + 1, frames - p - 1, np.nan)
        )
    status = _status(finite, usable, spectra, percent)
    blank = np.where((status == Status.NO_SIGNAL) | (status == Status.NOT_FINITE), np.nan, 1.0)
    return FitResult(
        model="SpectralAnalysis",
        estimates=tuple(
            Estimate(symbol, unit, value * blank, se * blank, meaning)
            for (symbol, unit, meaning), value, se in zip(_QUANTITIES, values, percent)
        ),
        chi2=chi2 * blank,
        aicc=aicc * blank,
        status=status,
        weights=weights,
        predicted=_predicted(grid, fit, weights) * blank[:, None] if settings.keep_predicted else None,
        settings={"rate_bounds": list(settings.rate_bounds), "rates": RATES},
        plots=(_plot(grid, spectra[:, np.isfinite(blank)]),) if settings.keep_predicted and len(curves) else (),
        columns=(
            Column("components", _components(spectra), "exponentials found; neighbours on the grid count as one"),
        ),
    )


@dataclass(frozen=True)
class _Grid:
    """Blood and exponentials as unit columns, and how amplitudes make quantities."""

    packed: Compression
    columns: Array
    lengths: Array
    sums: Array

    @classmethod
    def of(cls, packed: Compression) -> _Grid:
        blood = np.zeros((1, packed.size))
        blood[0, 0] = packed.blood
        columns = np.concatenate([blood, packed.basis])
        lengths = np.maximum(np.linalg.norm(columns, axis=1), 1e-300)
        rates = packed.rates
        sums = np.zeros((len(_QUANTITIES), len(columns)))
        sums[:3, 1:] = 1.0 / rates, np.ones_like(rates), np.eye(len(rates))[0]
        sums[3, 0] = 1.0
        return cls(packed, columns / lengths[:, None], lengths, sums / lengths)

    def solve(self, z: Array) -> Array:
        """Amplitudes of the unit columns (M, N)."""
        x = np.empty((len(self.columns), z.shape[1]))

        def part(rows: slice) -> None:
            here = np.empty((len(x), rows.stop - rows.start))
            solve_non_negative(self.columns, np.ascontiguousarray(z[:, rows]), here)
            x[:, rows] = here

        in_parts(part, z.shape[1])
        return x

    def sparse(self, z: Array, penalty: Array) -> Array:
        """The same with 2 penalty sum_j x_j added to the squares: as one more coordinate that all columns share."""
        share = _SLIGHT**0.5
        columns = np.hstack([self.columns, np.full((len(self.columns), 1), share)])
        return replace(self, columns=columns).solve(np.vstack([z, -penalty / share]))

    def values(self, x: Array) -> Array:
        """VT, K1, Ki and vB (Q, N)."""
        found = np.stack([(row[:, None] * x).sum(axis=0) for row in self.sums])
        return np.concatenate([found[:3] / (1.0 - found[3]), found[3:]])


def _bootstrap(grid: _Grid, z: Array, chi2: Array, draws: int) -> Array:
    """Standard errors (Q, N), from how far refits to curves of sparse spectra with new noise lie from those spectra."""
    noise = np.random.default_rng(_SEED).standard_normal((draws, len(z), 1))
    spread = np.sqrt(np.nan_to_num(chi2))
    sparse = grid.sparse(z, _WITHIN_NOISE * spread)
    curves, values = grid.columns.T @ sparse, grid.values(sparse)
    away = np.stack([np.abs(grid.values(grid.solve(curves + spread * one)) - values) for one in noise])
    return np.quantile(away, _HELD, axis=0, method="weibull") / _ERRORS


def _status(finite: NDArray[np.bool_], usable: Array, spectra: Array, percent: Array) -> NDArray[np.uint8]:
    status = np.full(len(usable), Status.OK, np.uint8)
    status[(spectra[1] > 0) | (spectra[-1] > 0)] = Status.AT_BOUND
    status[~(percent[0] <= 100.0)] = Status.NOT_IDENTIFIABLE
    status[(usable.sum(axis=1) <= 0) | ~(spectra > 0).any(axis=0)] = Status.NO_SIGNAL
    status[~finite] = Status.NOT_FINITE
    return status


def _predicted(grid: _Grid, fit: Array, weights: Array) -> Array:
    """Fitted frame values (N, K); NaN in frames without weight."""
    with np.errstate(all="ignore"):
        back = np.where(weights > 0, grid.packed.project / weights, np.nan)
    return project_rows(np.ascontiguousarray(back.T), np.ascontiguousarray(fit.T)).T


def _components(spectra: Array) -> NDArray[np.int64]:
    """Runs of neighbouring rates with an amplitude, a curve."""
    there = (spectra[1:] > 0).astype(np.int64)
    return there[0] + (np.diff(there, axis=0) == 1).sum(axis=0)


def _plot(grid: _Grid, spectra: Array) -> Plot:
    place, curve = np.nonzero(spectra[1:])
    amplitudes = spectra[1:][place, curve] / grid.lengths[1:][place]
    return Plot(
        title="Spectrum",
        x_label="log10 of the rate (1/min)",
        y_label="amplitude (mL cm^-3 min^-1)",
        points=(("all regions", np.log10(grid.packed.rates[place]), amplitudes),),
        text="Every exponential of every region; neighbours on the grid stand for one rate between them.",
    )
