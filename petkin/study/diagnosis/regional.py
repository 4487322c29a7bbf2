"""Regional curves as the engine of diagnosis sees them: channels are regions, samples are frames."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petkin.diagnosis import Coordinates, Estimate, Hypothesis, Profiles, Term
from petkin.dynamics import PiecewiseLinear
from petkin.effects import Camera, Effect, ForwardModel, Tabulated, Tissue, Vessels, effect_named
from petkin.imaging import CountingNoise, Exchange, FrameObservation
from petkin.inputs import InputFunction
from petkin.kinetics import compartment_model
from petkin.study.diagnosis.noise_law import COUNTS, NoiseLaw, contrasts

Array = NDArray[np.float64]

#: Median and standard deviation of the logarithm of kinetics before any data: wide enough for any tracer of the brain,
#: and declared in every report, since it makes some gaps visible that would else hide behind impossible rates.
PRIOR = {"K1": (0.2, 0.6), "k2": (0.12, 0.8), "k3": (0.04, 0.9), "k4": (0.03, 0.8), "vB": (0.05, 0.5), "Kb": (0.2, 0.7)}
#: Two starts of k2, 1/min.
_STARTS = (0.06, 0.2)
_LOG_STEP = 1e-4
#: Amplitudes of included effects: step in widths of their plausible range.
_SIZE_STEP = 1e-3
#: Departure of C_P by which its effect on regions is taken, which is linear.
_DEPARTURE = 1e-3
#: Rates of the dictionary for the noise floor, 1/min.
_LADDER = np.concatenate([[0.0], np.geomspace(1e-3, 6.0, 27)])
#: Effects that a region has for itself, as logarithms, where the simulator includes them.
_OWN = {"blood_volume": "vB", "vascular_trapping": "Kb"}
#: Effects without a first order about no effect: their refit begins at their usual size, the mean of its prior.
_CURVED = frozenset({"tissue_heterogeneity"})
#: Relative error of predictions: of the table of responses, and of blood read as straight lines between samples.
_ACCURACY = 5e-4
#: Stages that change what the regions hold into what is shown; how much of what was predicted is kept for another time.
SCANNER, _KEPT = ("imaging", "noise"), 128
#: Stages before what the regions hold.
ARRIVAL = ("input", "clock")


@dataclass(frozen=True)
class RegionalSimulator:
    """The tissue model with the effects that it includes.

    Args:
        channels: regions.
        label: tissue model.
        input: blood record.
        clock: frames.
        includes: effects that are refitted with the kinetics.
        nodes: times at which the input is read, min.
        measured: effects whose part of the record was measured with care.
        law: how values scatter.
        law_errors: standard deviations of its exponents, one after another (m, 3).
        grain: the noise by region and frame, relative to that law, where voxels show it (R, K).
        errors: standard deviations of C_P relative to itself, at the nodes, one after another (m, T).
        moves: what motion adds to regions, where an image tells; see `Camera`.
        misplaced: where they have evidently moved far, standard deviations of what that adds to each (R, K).
        settings: of included effects by name, parameters beside the amplitude, which are not refitted, each a number or
            one a region; starts of the catalogue for the rest.
        begun: of included effects by name, the amplitude at which a fit begins: motion either way lowers what a small
            region holds, so that a fit from none of it may end on the wrong side.
        seen: of included effects by name, how large an image shows them to be.
    """

    channels: tuple[str, ...]
    label: str
    input: InputFunction
    clock: FrameObservation
    includes: tuple[Effect, ...]
    nodes: Array
    measured: frozenset[str] = frozenset()
    law: NoiseLaw = COUNTS
    law_errors: Array = field(default_factory=lambda: np.zeros((0, len(COUNTS))))
    grain: Array | None = None
    errors: Array = field(default_factory=lambda: np.zeros((0, 1)))
    moves: Exchange | None = None
    misplaced: Array | None = None
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    begun: Mapping[str, float] = field(default_factory=dict)
    seen: Mapping[str, Estimate] = field(default_factory=dict)
    _kept: dict[Any, Any] = field(default_factory=dict, init=False, repr=False, compare=False)
    _departed: dict[bytes, tuple[RegionalSimulator, ...]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def times(self) -> Array:
        return np.maximum(self.clock.frames.mid, 0.0)

    @property
    def accuracy(self) -> float:
        return _ACCURACY

    @property
    def common_factor(self) -> bool:
        """Where voxels say how large each region's own noise is, and so what part of it frames have in common."""
        return self.grain is not None

    @property
    def own(self) -> Coordinates:
        """Logarithms of kinetics, then amplitudes that differ between regions, as those of `shared`."""
        return self._own

    @cached_property
    def _own(self) -> Coordinates:
        mean, sd = (np.array([PRIOR[s][i] for s in self._logarithms]) for i in (0, 1))
        sizes, steps = _sizes(self._regional), np.full(len(mean), _LOG_STEP)
        return Coordinates(
            (*self._logarithms, *sizes.symbols),
            np.concatenate([np.log(mean), sizes.mean]),
            np.concatenate([sd, sizes.sd]),
            np.concatenate([steps, sizes.step]),
        )

    @cached_property
    def _logarithms(self) -> tuple[str, ...]:
        """Symbols of what a region has for itself on a log scale."""
        return (*kinetics(self.label), *(_OWN[e.name] for e in self.includes if e.name in _OWN))

    @cached_property
    def sized(self) -> tuple[Effect, ...]:
        """Included effects whose amplitude is refitted in widths of its plausible range."""
        return tuple(e for e in self.includes if e.name not in _OWN and not e.flag)

    @cached_property
    def _regional(self) -> tuple[Effect, ...]:
        return tuple(e for e in self.sized if e.regional)

    @property
    def logarithmic(self) -> Collection[str]:
        """Names of effects that a region has for itself on a log scale."""
        return _OWN.keys()

    @cached_property
    def limits(self) -> dict[str, tuple[float, float]]:
        """Where amplitudes of included effects may lie, by name."""
        return {e.name: unset(e).limits for e in self.sized}

    @property
    def shared(self) -> Coordinates:
        """Amplitudes of included effects in widths of their plausible range, which is their prior."""
        return self._shared

    @cached_property
    def _shared(self) -> Coordinates:
        effects = tuple(e for e in self.sized if not e.regional)
        sizes, widths = _sizes(effects), map(width, effects)
        each = zip(effects, sizes.mean, widths, strict=True)
        begun = [self.begun[e.name] / wide if e.name in self.begun else mean for e, mean, wide in each]
        return replace(sizes, begun=np.array(begun))

    @property
    def starts(self) -> tuple[Array, ...]:
        own = np.tile(self.own.mean, (len(self.channels), 1))
        found = []
        for k2 in _STARTS:
            start = own.copy()
            start[:, 1] = np.log(k2)
            found.append(start)
        return tuple(found)

    def predict(self, own: Array, shared: Array, terms: tuple[Term, ...] = ()) -> Array:
        model = self.model(own, shared, terms)
        before = (*_place(own, shared), _key(t for t in terms if t.hypothesis.stage not in SCANNER))
        return model.shown(self._once(before, lambda: model.uptake(self._responses(model, shared, terms))))

    def model(self, own: Array, shared: Array, terms: tuple[Term, ...] = ()) -> ForwardModel:
        """The forward model at a point."""
        model = self._once(_place(own, shared), lambda: self._including(own, shared))
        for term in terms:
            effect = effect_named(term.hypothesis.name).form(term.hypothesis.symbol)
            model = effect.inject(model, {effect.amplitude.symbol: term.amplitude, **term.setting})
        return model

    def _including(self, own: Array, shared: Array) -> ForwardModel:
        """The forward model with the effects that it includes."""
        count = len(self._logarithms)
        amounts = np.exp(own[..., :count].clip(-12.0, 4.0))
        values = {symbol: amounts[..., i] for i, symbol in enumerate(self._logarithms)}
        nothing = np.zeros(own.shape[:-1])
        model = replace(
            self._once(shared.tobytes(), lambda: self._arriving(shared)),
            vascular=Vessels(np.minimum(values.get("vB", nothing), 0.9), values.get("Kb", 0.0)),
            tissue=Tissue(self.label, {symbol: values[symbol] for symbol in kinetics(self.label)}),
        )
        regional = {effect.name: own[..., count + i] for i, effect in enumerate(self._regional)}
        return self._with(model, self._upon_regions, dict(zip(self.shared.symbols, shared)) | regional)

    def _arriving(self, shared: Array) -> ForwardModel:
        """The forward model of nothing, with what included effects make of its input and clock."""
        model = ForwardModel(
            regions=self.channels,
            input=self.input,
            vascular=Vessels(0.0),
            tissue=Tissue(self.label, {}),
            imaging=Camera(moves=self.moves),
            clock=self.clock,
            noise=CountingNoise(0.0),
        )
        arriving = [e for e in self.includes if e.name not in _OWN and e not in self._upon_regions]
        return self._with(model, arriving, dict(zip(self.shared.symbols, shared)))

    @cached_property
    def _upon_regions(self) -> tuple[Effect, ...]:
        """Included effects on what the regions hold, or on what is shown of that."""
        return tuple(e for e in self.includes if e.name not in _OWN and (e.stage not in ARRIVAL or e.regional))

    def _with(self, model: ForwardModel, effects: Sequence[Effect], sizes: Mapping[str, Any]) -> ForwardModel:
        """A forward model with some of the included effects, those that have no size first, others in widths of their
        plausible range."""
        for effect in sorted(effects, key=lambda e: not e.flag):
            if effect.flag:
                model = effect.inject(model)
                continue
            amplitude = np.clip(sizes[effect.name] * width(effect), *self.limits[effect.name])
            setting = self.settings.get(effect.name, {})
            model = effect.inject(model, {effect.amplitude.symbol: amplitude, **setting})
        return model

    def _responses(self, model: ForwardModel, shared: Array, terms: tuple[Term, ...]) -> Tabulated:
        """A table of the model's input and clock."""
        moving = _key(t for t in terms if t.hypothesis.stage in ARRIVAL)
        return self._once((shared.tobytes(), moving), lambda: Tabulated(model.input, model.clock, self.nodes))

    def _once(self, key: Any, make: Callable[[], Any]) -> Any:
        """What was made before under this key; the oldest is forgotten."""
        if key not in self._kept:
            if len(self._kept) >= _KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = make()
        return self._kept[key]

    def driven(self, own: Array, shared: Array, courses: Callable[[Array], Array]) -> Array:
        """C_P departs by courses times the geometric mean of itself and its mean over the scan."""
        plasma = np.asarray(self.input.plasma(self.nodes))
        mean = np.trapezoid(plasma, self.nodes) / self.nodes[-1]
        return self._departing(own, shared, courses(self.nodes) * np.sqrt(np.maximum(plasma * mean, 0.0)))

    def departing(self, values: Array) -> tuple[Profiles, ...]:
        return (Profiles.of_values(values),)

    def unsure(self, own: Array, shared: Array) -> Array:
        """C_P errs as its record does; what motion adds, in every region for itself."""
        found = self._departing(own, shared, self.errors * np.asarray(self.input.plasma(self.nodes)))
        if self.misplaced is None:
            return found
        return np.concatenate([found, np.eye(len(self.misplaced))[:, :, None] * self.misplaced])

    def _departing(self, own: Array, shared: Array, departures: Array) -> Array:
        """What regions gain where C_P departs so (n, nodes)."""
        key = departures.tobytes()
        if key not in self._departed:
            self._departed[key] = tuple(self._under(departure) for departure in departures)
        here = self.predict(own, shared)
        found = [(other.predict(own, shared) - here) / _DEPARTURE for other in self._departed[key]]
        return np.array(found).reshape(-1, *here.shape)

    def _under(self, departure: Array) -> RegionalSimulator:
        """The same with a small part of a departure of C_P."""
        plasma = np.asarray(self.input.plasma(self.nodes))
        other = PiecewiseLinear(self.nodes, plasma + _DEPARTURE * departure)
        return replace(self, input=replace(self.input, plasma=other))

    def spread(self, values: Array) -> Array:
        """sd by the law (R, K); grainy as said."""
        spread = self.law.spread(values, self.clock)
        return spread if self.grain is None else spread * self.grain

    def uneven(self, values: Array) -> Array:
        """Its exponents err."""
        return np.einsum("mt,trk->mrk", self.law_errors, contrasts(values, self.clock))

    def flexible(self, shared: Array) -> Array:
        """Responses to a ladder of rates, blood, and what blood leaves behind."""
        own = np.tile(self.own.mean, (len(self.channels), 1))
        seen = self._responses(self.model(own, shared), shared, ())
        return np.concatenate([seen.plasma(_LADDER), seen.blood[None], seen.trapped(0.0)[None]])


def _sizes(effects: Sequence[Effect]) -> Coordinates:
    """Their amplitudes in widths of the plausible range."""
    count = len(effects)
    mean = np.array([e.amplitude.start / width(e) if e.name in _CURVED else 0.0 for e in effects])
    return Coordinates(tuple(e.name for e in effects), mean, np.ones(count), np.full(count, _SIZE_STEP))


def _place(own: Array, shared: Array) -> tuple[Any, ...]:
    """Identifies a point."""
    return own.shape, own.tobytes(), shared.tobytes()


def _key(terms: Iterable[Term]) -> tuple[Any, ...]:
    """Identifies terms with their values."""
    return tuple(
        (t.hypothesis.name, _bytes(t.amplitude), *((symbol, _bytes(value)) for symbol, value in t.setting.items()))
        for t in terms
    )


def _bytes(value: Any) -> bytes:
    return np.asarray(value, np.float64).tobytes()


def kinetics(label: str) -> tuple[str, ...]:
    """Symbols of a tissue model's rate constants."""
    model = compartment_model(label)
    return model.parameters.symbols[: model.rates]


def width(effect: Effect) -> float:
    """The larger end of an effect's plausible range."""
    return max(abs(effect.amplitude.lower), abs(effect.amplitude.upper))


def unset(effect: Effect) -> Hypothesis:
    """An effect as a hypothesis of no settings."""
    amplitude = effect.amplitude
    return Hypothesis(
        name=effect.name,
        stage=effect.stage,
        symbol=amplitude.symbol,
        unit={"min^-1": "1/min"}.get(amplitude.unit, amplitude.unit),
        lower=amplitude.lower,
        upper=amplitude.upper,
        by_channel=bool(effect.regional),
        alike=effect.alike,
        flag=effect.flag,
        folded=effect.folded,
        split_by=effect.split_by,
        least=effect.least,
    )
