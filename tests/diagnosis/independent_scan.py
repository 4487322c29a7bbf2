"""Scans with a withheld effect, made without petkin: inputs, Runge-Kutta steps, frames, decay and noise of its own.

Forms are written from the words of the effects' table, not from the product's code, and some differ on purpose:
metabolites by a Hill curve of another exponent, release as a triangle, dispersion by steps of its own equation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

REGIONS = ("frontal", "temporal", "striatum", "thalamus", "cerebellum")
DURATIONS_S = [10] * 6 + [20] * 6 + [60] * 6 + [180] * 4 + [300] * 14
EDGES = np.concatenate([[0.0], np.cumsum(DURATIONS_S)]) / 60.0
MID = 0.5 * (EDGES[1:] + EDGES[:-1])
LAMBDA = math.log(2.0) / 20.364
STEP = 1.0 / 60.0


@dataclass(frozen=True)
class Truth:
    """One scan: time grid (min), plasma with its metabolites, parent fraction, blood, kinetics a region."""

    t: Array
    total: Array
    parent: Array
    blood: Array
    rates: Array
    vB: Array
    delay: float
    effects: dict[str, dict[str, float]] = field(default_factory=dict)


def draw(rng: np.random.Generator) -> Truth:
    """Kinetics, input and delay of one subject."""
    t = np.arange(0.0, EDGES[-1] + 2.0, STEP)
    onset, rise = rng.uniform(0.3, 0.8), rng.uniform(0.3, 0.6)
    peak, mix = rng.uniform(40.0, 90.0), rng.uniform(0.05, 0.12)
    fast, middle, slow = rng.uniform(2.5, 5.0), rng.uniform(0.15, 0.3), rng.uniform(0.004, 0.012)
    s = np.maximum(t - onset - rise, 0.0)
    wash = (1 - 2 * mix) * np.exp(-fast * s) + mix * np.exp(-middle * s) + mix * np.exp(-slow * s)
    total = peak * np.where(t < onset, 0.0, np.where(t < onset + rise, (t - onset) / rise, wash))
    parent = 1.0 / (1.0 + (t / rng.uniform(15.0, 40.0)) ** rng.uniform(1.2, 1.8))
    count = len(REGIONS)
    ranges = ((0.06, 0.35), (0.06, 0.25), (0.02, 0.1), (0.01, 0.05))
    rates = np.stack([rng.uniform(low, high, count) for low, high in ranges], axis=1)
    return Truth(
        t, total, parent, total * rng.uniform(0.6, 0.8), rates, rng.uniform(0.03, 0.07, count), rng.uniform(-0.1, 0.3)
    )


def _late(t: Array, curve: Array, by: float) -> Array:
    return np.interp(t - by, t, curve, left=0.0)


def _smear(t: Array, curve: Array, tau: float) -> Array:
    out, keep = np.zeros_like(curve), math.exp(-STEP / tau)
    for i in range(1, t.size):
        out[i] = out[i - 1] * keep + (1 - keep) * 0.5 * (curve[i] + curve[i - 1])
    return out


def curves(truth: Truth) -> Array:
    """Frame values (regions, frames) as the scanner's files would hold them without noise."""
    t, effects = truth.t, truth.effects
    parent, total, blood = truth.parent, truth.total, truth.blood
    if e := effects.get("parent_fraction"):
        parent = parent * (1.0 - e["size"] * t**1.6 / (t**1.6 + 12.0**1.6))
    if e := effects.get("interrupted_record"):
        total = total + e["size"] * total.max() * ((t > e["onset"]) & (t < e["onset"] + 8.0))
    plasma = total * parent
    extra = effects.get("arterial_delay", {}).get("size", 0.0) / 60.0
    plasma, blood, total = (_late(t, c, truth.delay + extra) for c in (plasma, blood, total))
    if e := effects.get("dispersion"):
        plasma, blood = (_smear(t, c, e["size"] / 60.0) for c in (plasma, blood))
    if e := effects.get("tissue_metabolite"):
        into = e["size"] * truth.rates[:, :1]
        leaked = into * _first_order(t, total - plasma, np.full(len(REGIONS), 0.08))
    else:
        leaked = 0.0
    rates = truth.rates
    if e := effects.get("tissue_heterogeneity"):
        up, down = rates.copy(), rates.copy()
        up[:, :2] *= 1 + e["size"]
        down[:, :2] *= 1 - e["size"]
        tissue = 0.5 * (_tissue(t, plasma, up, {}) + _tissue(t, plasma, down, {}))
    else:
        tissue = _tissue(t, plasma, rates, effects)
    vB = truth.vB[:, None]
    whole = (1 - vB) * (tissue + leaked) + vB * blood
    if e := effects.get("vascular_trapping"):
        whole = whole + vB * e["size"] * np.concatenate([[0.0], np.cumsum(0.5 * (blood[1:] + blood[:-1]) * STEP)])
    return _scanner(_framed(t, whole, effects), effects)


@njit
def _first_order(t: Array, u: Array, k: Array) -> Array:
    out = np.zeros((k.size, t.size))
    for i in range(1, t.size):
        out[:, i] = (out[:, i - 1] * (1 - 0.5 * STEP * k) + 0.5 * STEP * (u[i] + u[i - 1])) / (1 + 0.5 * STEP * k)
    return out


def _tissue(t: Array, u: Array, rates: Array, effects: dict[str, dict[str, float]]) -> Array:
    """Both compartments by Runge-Kutta steps of 1 s."""
    flow, release, full = (effects.get(n) for n in ("flow_change", "time_varying_kinetics", "saturable_binding"))
    course = np.array([0.0, 1e9, 0.0, 1e9])
    if flow is not None:
        course[:2] = flow["size"], flow["onset"]
    where = np.zeros(len(rates))
    if release is not None:
        course[2:] = release["size"], release["onset"]
        where[int(release["region"]) - 1] = 1.0
    filling = np.zeros(len(rates))
    if full is not None:
        filling = full["size"] / np.maximum(_both(t, u, rates, course, where, filling)[1].max(axis=1), 1e-9)
    one, two = _both(t, u, rates, course, where, filling)
    return one + two


@njit
def _slope(when, a, b, drive, rate, course, here, filling):
    m = 1.0 + course[0] if when >= course[1] else 1.0
    x = (when - course[3]) / 12.0
    out = rate[1] * m
    if x > 0:
        out *= 1.0 + here * course[2] * max(0.0, min(x, 2.0 - 0.5 * x))
    bind = rate[2] * max(1.0 - filling * b, 0.0)
    return rate[0] * m * drive - (out + bind) * a + rate[3] * b, bind * a - rate[3] * b


@njit
def _both(t, u, rates, course, where, filling):
    one, two = np.zeros((len(rates), t.size)), np.zeros((len(rates), t.size))
    for r in range(len(rates)):
        a = b = 0.0
        for i in range(t.size - 1):
            mid, h = 0.5 * (u[i] + u[i + 1]), STEP
            p = _slope(t[i], a, b, u[i], rates[r], course, where[r], filling[r])
            q = _slope(t[i] + h / 2, a + h / 2 * p[0], b + h / 2 * p[1], mid, rates[r], course, where[r], filling[r])
            v = _slope(t[i] + h / 2, a + h / 2 * q[0], b + h / 2 * q[1], mid, rates[r], course, where[r], filling[r])
            w = _slope(t[i] + h, a + h * v[0], b + h * v[1], u[i + 1], rates[r], course, where[r], filling[r])
            a += h / 6 * (p[0] + 2 * q[0] + 2 * v[0] + w[0])
            b += h / 6 * (p[1] + 2 * q[1] + 2 * v[1] + w[1])
            one[r, i + 1], two[r, i + 1] = a, b
    return one, two


def _framed(t: Array, whole: Array, effects: dict[str, dict[str, float]]) -> Array:
    shift = effects.get("frame_offset", {}).get("size", 0.0) / 60.0
    if "slipped_edge" in effects:  # one frame ends late by a share of its length, the next begins then
        last = int(effects["slipped_edge"]["frame"])
        shift = effects["slipped_edge"]["size"] * np.diff(EDGES)[last] * (np.arange(EDGES.size) == last + 1)
    if "mid_frame_sampling" in effects:
        return np.stack([np.interp(MID, t, row) for row in whole])
    rate = LAMBDA * (1.0 - _excess(effects))
    weighted = whole * np.exp(-rate * t)
    area = np.concatenate(
        [np.zeros((len(whole), 1)), np.cumsum(0.5 * (weighted[:, 1:] + weighted[:, :-1]) * STEP, 1)], 1
    )
    at = np.stack([np.interp(EDGES + shift, t, row) for row in area])
    counted = (np.exp(-LAMBDA * EDGES[:-1]) - np.exp(-LAMBDA * EDGES[1:])) / LAMBDA
    return np.diff(at, axis=1) / counted


def _excess(effects: dict[str, dict[str, float]]) -> float:
    flags = {"mean_life_swap": 1 / math.log(2.0) - 1.0, "decay_applied_twice": 1.0, "decay_not_applied": -1.0}
    return sum(v for n, v in flags.items() if n in effects) + effects.get("half_life_error", {}).get("size", 0.0)


def _scanner(x: Array, effects: dict[str, dict[str, float]]) -> Array:
    for name, e in effects.items():
        size, onset = e.get("size", 1.0), e.get("onset", 0.0)
        later = np.clip((EDGES[1:] - onset) / np.diff(EDGES), 0.0, 1.0)
        chosen = (np.arange(len(x)) == int(e.get("region", 1)) - 1)[:, None]
        others = (x.sum(axis=0) - x) / (len(x) - 1)
        if name == "motion_step":
            x = x + size * later * (others - x) * (chosen if "region" in e else 1.0)
        elif name == "motion_between":  # every region enters the next, as when a head turns
            share = size * np.array([[1.0], [0.2], [0.7], [0.4], [0.9]])
            x = x + share * later * (np.roll(x, 1, axis=0) - x)
        elif name == "attenuation_mismatch":
            x = x * (1 + size * later * chosen)
        elif name == "gain_step":
            x = x * (1 + size * later)
        elif name == "alternating_gain":
            x = x * (1 + size * (-1.0) ** np.arange(MID.size))
        elif name == "gain_drift":
            x = x * (1 + size * MID / EDGES[-1])
        elif name == "randoms_offset":
            x = x + size * x.mean(axis=0).max() * np.exp(LAMBDA * (MID - EDGES[-1]))
        elif name == "dead_time":
            rate = x.mean(axis=0) * np.exp(-LAMBDA * MID)
            x = x * (1 - size * rate / rate.max())
        elif name == "scatter_background":
            x = x + size * x.mean(axis=0)
        elif name == "frame_duration":
            x = x.copy()
            x[:, int(e["frame"])] *= 1 + size
        elif name == "partial_volume":
            x = x + size * (others - x) * (chosen if "region" in e else 1.0)
        elif name == "chirp":  # in no catalogue
            x = x * (1 + size * np.sin(np.sqrt(np.maximum(MID, 0.0)) * 2.2 + 0.4))
        elif name == "bump":  # in no catalogue
            x = x * (1 + size * chosen * np.exp(-0.5 * ((MID - 22.0) / 7.0) ** 2))
    return x


def spread(x: Array) -> Array:
    """sd of counts, relative."""
    counted = (np.exp(-LAMBDA * EDGES[:-1]) - np.exp(-LAMBDA * EDGES[1:])) / LAMBDA
    return np.sqrt(np.maximum(x, 0.02 * x.max(axis=1, keepdims=True)) / counted)


def noise_size(x: Array, percent: float) -> Array:
    """s a region, for a median sd of so many percent after 20 min."""
    late = MID > 20.0
    return percent / 100.0 / np.median(spread(x)[:, late] / x[:, late], axis=1)


def noisy(
    x: Array, rng: np.random.Generator, *, percent: float = 2.0, share: float = 0.0, heavy: bool = False
) -> Array:
    """With noise of counts, a share of it common to a frame, with tails of Student's t of 4 degrees if asked for."""

    def unit(shape) -> Array:
        return rng.standard_t(4, shape) / math.sqrt(2.0) if heavy else rng.standard_normal(shape)

    e = math.sqrt(1 - share) * unit(x.shape) + math.sqrt(share) * unit(x.shape[1])
    return x + noise_size(x, percent)[:, None] * spread(x) * e
