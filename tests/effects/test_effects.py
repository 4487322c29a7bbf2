"""Effects: each changes its stage and nothing else, has the stated sign, and says no to what cannot be."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
import torch
from scipy.integrate import quad, solve_ivp

from petkin.dynamics import PiecewiseLinear
from petkin.effects import (
    EFFECTS,
    STAGES,
    Camera,
    Effect,
    ForwardModel,
    Tabulated,
    Tissue,
    Vessels,
    effect_named,
    read_injection,
)
from petkin.errors import InputError
from petkin.imaging import CountingNoise, Exchange, FrameObservation, FrameSchedule, frame_schedule
from petkin.inputs import InputFunction, analytic_input, feng_plasma, paper_plasma

#: Names by stage as the gap report has them.
CONTRACT = {
    "input": "arterial_delay dispersion parent_fraction input_scale input_partial_volume",
    "vascular": "blood_volume vascular_trapping",
    "tissue": "second_tissue tissue_metabolite tissue_heterogeneity time_varying_kinetics flow_change "
    "saturable_binding",
    "imaging": "partial_volume motion_step motion_drift attenuation_mismatch scatter_background randoms_offset "
    "dead_time gain_drift gain_step",
    "clock": "frame_offset frame_duration mid_frame_sampling half_life_error mean_life_swap decay_applied_twice "
    "decay_not_applied",
    "noise": "noise_variance nonnegativity_bias",
}
#: Names that are ours.
BEYOND = {"vascular": "vascular_release"}
#: Parameters that are zero unless they are given: everywhere, for ever.
IDLE = ("region", "beside", "kr", "course", "edge")
LAMBDA = math.log(2) / 109.77


def column(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


@pytest.fixture
def one_tissue() -> ForwardModel:
    plasma = feng_plasma(onset=0.5)
    return ForwardModel(
        regions=("grey", "white"),
        input=analytic_input(plasma),
        vascular=Vessels(column(0.0, 0.0)),
        tissue=Tissue("1TCM", {"K1": column(0.12, 0.05), "k2": column(0.1, 0.08)}),
        imaging=Camera(),
        clock=FrameObservation(frame_schedule("12x10,6x20,6x30,3x60", length=0), LAMBDA),
        noise=CountingNoise(0.0),
    )


def frame_means(model: ForwardModel, curve) -> np.ndarray:
    """Decay-weighted means of a curve by quadrature."""
    frames = model.clock.frames
    out = []
    for start, end in zip(frames.start, frames.end):
        top = quad(lambda t: curve(t) * math.exp(-LAMBDA * t), start, end, epsabs=1e-12, limit=200, points=[0.5])[0]
        out.append(top / quad(lambda t: math.exp(-LAMBDA * t), start, end)[0])
    return np.array(out)


def test_names_and_stages_are_the_contracted_ones_and_ours() -> None:
    assert {stage: {e.name for e in EFFECTS if e.stage == stage} for stage in STAGES} == {
        stage: {*names.split(), *BEYOND.get(stage, "").split()} for stage, names in CONTRACT.items()
    }


def able(effect: Effect, model: ForwardModel) -> ForwardModel:
    """The model with what the effect needs: vessels, metabolites, walls that trap, binding sites."""
    fraction = PiecewiseLinear(column(0.0, 3.0, 12.0), column(1.0, 0.6, 0.2))
    vessels, arterial = Vessels(column(0.05, 0.04)), dataclasses.replace(model.input, parent_fraction=fraction)
    model = dataclasses.replace(
        model, vascular=vessels, input=dataclasses.replace(arterial, total_plasma=_twice(model))
    )
    ready = (model, *(effect_named(needed).inject(model) for needed in ("vascular_trapping", "second_tissue")))
    return next(each for each in ready if effect.suits(each))


def _twice(model: ForwardModel):
    return dataclasses.replace(model.input.plasma, coefficients=2 * model.input.plasma.coefficients)


def within(effect: Effect) -> dict[str, float]:
    """Times that lie within the short scan."""
    return {symbol: 4.0 for symbol in ("onset", "width", "half_time") if symbol in effect.parameters.symbols}


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_an_effect_changes_its_stage_and_nothing_else(effect: Effect, one_tissue: ForwardModel) -> None:
    base = able(effect, one_tissue)
    assert effect.suits(base)
    changed = effect.inject(base, within(effect))
    for stage in STAGES:
        same = getattr(changed, stage) is getattr(base, stage)
        assert same == (stage != effect.stage), stage
    before, after = base.frame_values(), changed.frame_values()
    assert after.shape == before.shape
    assert torch.allclose(before, after, rtol=1e-3) == (effect.name == "noise_variance")


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_an_effect_is_fully_described(effect: Effect) -> None:
    assert effect.meaning
    assert effect.source
    for parameter in effect.parameters:
        assert parameter.meaning
        assert parameter.lower <= parameter.start <= parameter.upper
        assert math.isfinite(parameter.lower)
        assert math.isfinite(parameter.upper)
        assert parameter.start != 0 or parameter.symbol in IDLE


@pytest.mark.parametrize(
    "effect",
    [e for e in EFFECTS if not e.flag and e.name not in ("blood_volume", "second_tissue")],
    ids=lambda e: e.name,
)
def test_an_amplitude_of_zero_changes_no_value(effect: Effect, one_tissue: ForwardModel) -> None:
    base = able(effect, one_tissue)
    same = effect.inject(base, {effect.amplitude.symbol: 0.0, **within(effect)}).frame_values()
    loose = 3e-5 if effect.stage == "input" else 1e-12  # a formula read as straight pieces
    torch.testing.assert_close(same, base.frame_values(), rtol=loose, atol=10 * loose)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_a_table_of_responses_reads_as_the_exact_ones(effect: Effect, one_tissue: ForwardModel) -> None:
    base, nodes = straightened(effect, one_tissue)
    changed = effect.inject(base, within(effect))
    values = scaled(changed, 1.0).values(Tabulated(changed.input, changed.clock, nodes))
    expected = changed.frame_values().numpy()
    np.testing.assert_allclose(values, expected, rtol=2e-4, atol=2e-5 * expected.max())


@pytest.mark.parametrize("end", [40.0, 240.0])
def test_any_rate_is_read_to_three_millionths_of_the_curve(end: float) -> None:
    times = np.concatenate([np.arange(0.0, 3.0, 1 / 120), np.arange(3.0, end + 1.0, 0.1)])
    since = np.maximum(times - 0.3, 0.0)
    bolus = 4000.0 * since * np.exp(-4.0 * since) + 40.0 * (1.0 - np.exp(-5.0 * since)) * np.exp(-0.05 * since)
    edges = np.concatenate([np.arange(0.0, 2.0, 1 / 6), np.arange(2.0, end + 1.0, 2.0)])
    arterial = InputFunction(*(PiecewiseLinear(times, bolus) for _ in range(2)))
    clock = FrameObservation(FrameSchedule(edges[:-1], edges[1:]), math.log(2.0) / 109.77)
    rates = np.concatenate([[0.0], np.random.default_rng(0).uniform(-9.0, 2.7, 200)])
    rates[1:] = np.exp(rates[1:])
    found, expected = Tabulated(arterial, clock, times).plasma(rates), clock.of_response(arterial.plasma, rates)
    assert (np.abs(found - expected).max(axis=1) < 3e-6 * expected.max(axis=1)).all()


@pytest.mark.parametrize("effect", [e for e in EFFECTS if e.stage == "input"], ids=lambda e: e.name)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_effect_on_an_input_of_arrays_is_that_on_tensors(
    effect: Effect, sign: float, one_tissue: ForwardModel
) -> None:
    base, _ = straightened(effect, one_tissue)
    curves = {f: getattr(base.input, f) for f in ("plasma", "whole_blood", "total_plasma")}
    arrays = {f: PiecewiseLinear(c.times.numpy(), c.values.numpy()) for f, c in curves.items()}
    other = dataclasses.replace(base, input=dataclasses.replace(base.input, **arrays))
    values = within(effect) | {effect.amplitude.symbol: sign * 0.05 * effect.amplitude.upper}
    expected, found = (effect.inject(model, values).frame_values() for model in (base, other))
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_members_of_a_batch_do_not_know_of_each_other(effect: Effect, one_tissue: ForwardModel) -> None:
    """Slopes are taken from batches: what one member changes in another is a wrong slope."""
    base, nodes = straightened(effect, one_tissue)
    changed = effect.inject(base, within(effect))
    seen = Tabulated(changed.input, changed.clock, nodes)
    alone = np.stack([scaled(changed, by).values(seen) for by in (1.0, 1.2)])
    np.testing.assert_allclose(scaled(changed, np.array([[1.0], [1.2]])).values(seen), alone, rtol=1e-12)


def straightened(effect: Effect, one_tissue: ForwardModel) -> tuple[ForwardModel, np.ndarray]:
    """A model that suits the effect, its input in straight pieces between nodes."""
    base = able(effect, one_tissue)
    end = 12.0
    nodes = np.unique(np.concatenate([np.arange(0.0, end, 1 / 120), [0.5, end]]))
    curves = {f: piecewise(getattr(base.input, f), nodes) for f in ("plasma", "whole_blood", "total_plasma")}
    return dataclasses.replace(base, input=dataclasses.replace(base.input, **curves)), nodes


def scaled(model: ForwardModel, by: float | np.ndarray) -> ForwardModel:
    """With arrays for tensors, and other K1."""
    rates = {symbol: np.asarray(rate) * (by if symbol == "K1" else 1.0) for symbol, rate in model.tissue.rates.items()}
    return dataclasses.replace(
        model,
        tissue=dataclasses.replace(model.tissue, rates={s: r + 0.0 * rates["K1"] for s, r in rates.items()}),
        vascular=dataclasses.replace(model.vascular, volume=np.asarray(model.vascular.volume) + 0.0 * rates["K1"]),
    )


def piecewise(curve, nodes: np.ndarray) -> PiecewiseLinear:
    return PiecewiseLinear(torch.from_numpy(nodes), curve(torch.from_numpy(nodes)))


def test_delay_makes_the_tissue_late(one_tissue: ForwardModel) -> None:
    late = effect_named("arterial_delay").inject(one_tissue, {"delay": 12.0})
    expected = dataclasses.replace(one_tissue, input=analytic_input(feng_plasma(onset=0.5 + 0.2)))
    torch.testing.assert_close(late.frame_values(), expected.frame_values(), rtol=1e-10, atol=1e-10)


def test_dispersion_is_one_exponential_by_quadrature(one_tissue: ForwardModel) -> None:
    smeared = effect_named("dispersion").inject(one_tissue, {"tau": 6.0}).input
    plasma, tau = feng_plasma(onset=0.5), 0.1
    for t in (0.7, 1.0, 3.0, 9.0):
        expected = quad(
            lambda s, t=t: math.exp(-(t - s) / tau) / tau * float(plasma(column(s))), 0.5, t, epsabs=1e-10, limit=400
        )[0]
        assert float(smeared.plasma(column(t))) == pytest.approx(expected, rel=1e-8)
        assert float(smeared.whole_blood(column(t))) == pytest.approx(expected, rel=1e-8)


def test_dispersion_of_samples_and_of_late_curves_follows_the_formula(one_tissue: ForwardModel) -> None:
    """A curve as straight pieces, a shifted one, and one with a rate at 1/tau all take the way of the formula."""
    knots = torch.cat([torch.tensor([0.0, 0.5]), torch.linspace(0.5001, 25.0, 20000)]).double()
    formula = feng_plasma(onset=0.5)
    sampled = dataclasses.replace(one_tissue, input=analytic_input(PiecewiseLinear(knots, formula(knots))))
    effect, expected = effect_named("dispersion"), None
    for model in (one_tissue, sampled, effect_named("arterial_delay").inject(one_tissue, {"delay": 0.0})):
        values = effect.inject(model, {"tau": 6.0}).frame_values()
        expected = values if expected is None else expected
        torch.testing.assert_close(values, expected, rtol=2e-4, atol=1e-4)
    shifted = dataclasses.replace(one_tissue, input=one_tissue.input.delayed(0.1))
    direct = dataclasses.replace(one_tissue, input=analytic_input(feng_plasma(onset=0.6)))
    torch.testing.assert_close(
        effect.inject(shifted, {"tau": 6.0}).frame_values(), effect.inject(direct, {"tau": 6.0}).frame_values()
    )
    at_pole, beside = (effect.inject(one_tissue, {"tau": 60 / r}).frame_values() for r in (4.133859, 4.15))
    torch.testing.assert_close(at_pole, beside, rtol=3e-3, atol=1e-3)


def test_dispersion_keeps_the_area() -> None:
    clock = FrameObservation(frame_schedule("40", length=40.0))
    base = ForwardModel(
        ("r",), analytic_input(paper_plasma()), Vessels(column(0.0)),
        Tissue("1TCM", {"K1": column(0.1), "k2": column(0.1)}), Camera(), clock, CountingNoise(0.0),
    )  # fmt: skip
    smeared = effect_named("dispersion").inject(base, {"tau": 5.0})
    lost = 5 / 60 * float(base.input.plasma(column(40.0)))  # still in the delay line at the end
    assert smeared.input.area(40.0) == pytest.approx(base.input.area(40.0) - lost, rel=1e-3)


@pytest.mark.parametrize("washout", [0.02, 0.1])
def test_a_record_loses_its_share_of_the_tissue_around_the_vessel(washout: float, one_tissue: ForwardModel) -> None:
    """T' = 0.1 C - k T by quadrature; as long as no rate is given it lets go of 0.1 a minute."""
    effect, plasma = effect_named("input_partial_volume"), feng_plasma(onset=0.5)
    cleared = effect.inject(one_tissue, {"share": 0.3, "washout": washout}).input
    for t in (1.0, 3.0, 9.0):
        around = quad(
            lambda s, t=t: 0.1 * math.exp(-washout * (t - s)) * float(plasma(column(s))),
            0.5,
            t,
            epsabs=1e-10,
            limit=400,
        )[0]
        expected = float(plasma(column(t))) - 0.3 * around
        assert float(cleared.plasma(column(t))) == pytest.approx(expected, rel=1e-4)
    assert effect.values({"share": 0.3})["washout"] == 0.1


def test_blood_volume_is_the_share_of_blood(one_tissue: ForwardModel) -> None:
    filled = effect_named("blood_volume").inject(one_tissue, {"vB": 0.08})
    blood = frame_means(one_tissue, lambda t: float(feng_plasma(onset=0.5)(column(t))))
    expected = 0.92 * one_tissue.frame_values().numpy() + 0.08 * blood
    np.testing.assert_allclose(filled.frame_values().numpy(), expected, rtol=1e-6, atol=1e-8)


def test_walls_trap_and_let_go_as_their_equation_says(one_tissue: ForwardModel) -> None:
    """dC_W/dt = vB Kb C_B - kr C_W; what is never let go is vB Kb times the area under the blood."""
    base = dataclasses.replace(one_tissue, vascular=Vessels(column(0.05, 0.04)))
    plasma, end = feng_plasma(onset=0.5), float(base.clock.frames.end[-1])
    trapping = effect_named("vascular_trapping").inject(base, {"Kb": 0.3})
    for kr in (0.0, 0.04):
        solution = solve_ivp(
            lambda t, c, kr=kr: [0.05 * 0.3 * float(plasma(column(t))) - kr * c[0]],
            (0.5, end), [0.0], rtol=1e-9, atol=1e-9, dense_output=True, max_step=0.25,
        )  # fmt: skip
        wall = frame_means(base, lambda t, solution=solution: float(solution.sol(t)[0]) if t > 0.5 else 0.0)
        for walled in (
            effect_named("vascular_trapping").inject(base, {"Kb": 0.3, "kr": kr}),
            effect_named("vascular_release").inject(trapping, {"kr": kr}),
        ):
            added = (walled.frame_values() - base.frame_values())[0].numpy()
            np.testing.assert_allclose(added, wall, rtol=1e-5, atol=1e-7)


def test_walls_let_go_only_what_they_trap(one_tissue: ForwardModel) -> None:
    with pytest.raises(InputError, match="no vessel wall traps anything here; vascular_trapping must come before it"):
        effect_named("vascular_release").inject(one_tissue)
    trapping = effect_named("vascular_trapping").inject(one_tissue)
    for name in ("vascular_trapping", "vascular_release"):
        with pytest.raises(InputError, match=r"kr=-0\.01: a rate constant is never negative"):
            effect_named(name).inject(trapping, {"kr": -0.01})


def test_second_tissue_is_the_two_tissue_model(one_tissue: ForwardModel) -> None:
    plasma = feng_plasma(onset=0.5)
    bound = effect_named("second_tissue").inject(one_tissue, {"k3": 0.06, "k4": 0.02})

    def field(t: float, c: np.ndarray) -> list[float]:
        return [0.12 * float(plasma(column(t))) - 0.16 * c[0] + 0.02 * c[1], 0.06 * c[0] - 0.02 * c[1]]

    end = float(one_tissue.clock.frames.end[-1])
    solution = solve_ivp(field, (0.5, end), [0.0, 0.0], rtol=1e-9, atol=1e-9, dense_output=True, max_step=0.25)
    expected = frame_means(one_tissue, lambda t: float(solution.sol(t).sum()) if t > 0.5 else 0.0)
    np.testing.assert_allclose(bound.frame_values()[0].numpy(), expected, rtol=1e-5, atol=1e-6)


def test_effects_join(one_tissue: ForwardModel) -> None:
    """Effects of different stages commute."""
    delay, blood = read_injection("arterial_delay=8"), read_injection("blood_volume=0.04")
    torch.testing.assert_close(
        delay.into(blood.into(one_tissue)).frame_values(), blood.into(delay.into(one_tissue)).frame_values()
    )


def test_no_effect_is_lost_beside_another(one_tissue: ForwardModel) -> None:
    """Of any two, in either order, each still changes the values at least half as much as alone."""
    two = effect_named("second_tissue").inject(able(effect_named("parent_fraction"), one_tissue))
    base = dataclasses.replace(two, vascular=Vessels(column(0.04, 0.04)), noise=CountingNoise(3.0))
    plain = base.frame_values()
    usable = [e for e in EFFECTS if e.suits(base) and e.name != "noise_variance"]
    alone = {e.name: e.inject(base, weak(e)).frame_values() - plain for e in usable}
    lost = []
    for first, second in itertools.permutations(usable, 2):
        both = second.inject(first.inject(base, weak(first)), weak(second)).frame_values() - plain
        for kept, other in ((first, second), (second, first)):
            if (both - alone[other.name]).norm() < 0.5 * alone[kept.name].norm():
                lost.append((first.name, second.name, kept.name))
    assert not lost


def weak(effect: Effect) -> dict[str, float]:
    """A tenth of the range, or all of a flag; `blood_volume` says how much there is, not how much more."""
    if effect.flag:
        return within(effect)
    strength = 0.06 if effect.name == "blood_volume" else 0.1 * effect.amplitude.upper
    return {effect.amplitude.symbol: strength, **within(effect)}


def test_gradients_pass_through_an_effect(one_tissue: ForwardModel) -> None:
    K1 = column(0.12, 0.05).requires_grad_()
    model = dataclasses.replace(one_tissue, tissue=Tissue("1TCM", {**one_tissue.tissue.rates, "K1": K1}))
    effect_named("arterial_delay").inject(model).frame_values().sum().backward()
    assert K1.grad is not None
    assert bool((K1.grad > 0).all())


def test_options_name_effects() -> None:
    assert dict(read_injection("second_tissue=0.07, k4=0.02").values) == {"k3": 0.07, "k4": 0.02}
    assert dict(read_injection("second_tissue").values) == {"k3": 0.05, "k4": 0.03}
    assert dict(read_injection("dispersion=7").values) == {"tau": 7.0}


def test_a_value_beyond_its_plausible_range_is_remarked_on() -> None:
    assert read_injection("motion_step=0.2,onset=40").remarks == ()
    assert read_injection("motion_step=3,onset=40", imaged=True).remarks == ()
    (remark,) = read_injection("motion_step=3").remarks
    assert "share=3" in remark
    assert "0 to 0.3 (share of the value that comes from what lies beside)" in remark
    (remark,) = read_injection("motion_drift=30", imaged=True).remarks
    assert "moved=30" in remark
    assert "-10 to 10 mm" in remark
    release, width = read_injection("time_varying_kinetics=5,width=1").remarks
    assert "release=5" in release
    assert "2 to 40 min" in width


def test_a_picture_is_moved_and_regions_by_what_it_tells(one_tissue: ForwardModel) -> None:
    """Regions gain D x, from the onset on or more and more; without D a picture moves, and regions stay."""
    values, count = one_tissue.frame_values(), len(one_tissue.regions)
    step = read_injection("motion_step=2,axis=4,onset=30", imaged=True).into(one_tissue)
    assert torch.equal(step.frame_values(), values)
    (motion,) = (motion(one_tissue.clock) for motion in step.imaging.motions)
    assert motion.way == 4
    assert set(motion.far) == {2.0}
    frames = one_tissue.clock.frames
    assert not motion.share[frames.end <= 30.0].any()
    assert (motion.share[frames.start >= 30.0] == 1.0).all()
    by_mm = np.random.default_rng(2).normal(0.0, 0.01, (6, count, count))
    far = np.array([-5.0, 0.0, 5.0])
    told = dataclasses.replace(one_tissue, imaging=Camera(moves=Exchange(far, far[:, None, None] * by_mm[:, None])))
    brought = torch.from_numpy(by_mm[4]) @ values
    seen = read_injection("motion_step=2,axis=4,onset=30", imaged=True).into(told).frame_values()
    torch.testing.assert_close(seen, values + 2.0 * brought * torch.from_numpy(motion.share))
    drift = read_injection("motion_drift=3,axis=4", imaged=True).into(told).frame_values()
    passed = torch.from_numpy(one_tissue.clock.frames.mid / one_tissue.clock.frames.end[-1])
    torch.testing.assert_close(drift, values + 3.0 * brought * passed)


@pytest.mark.parametrize("kind", [np.asarray, torch.as_tensor])
def test_regions_take_their_share_from_what_lies_beside(kind, one_tissue: ForwardModel) -> None:
    """Of one region, and that one of the others; as by hand."""
    frames = one_tissue.clock.frames
    x = np.array([[1.0], [4.0], [16.0]]) * np.ones(len(frames))
    share = np.array([0.1, 0.2, 0.5])
    beside = np.array([4.0, 8.5, 4.0])
    for name, course in (("partial_volume", 1.0), ("motion_step", frames.start >= 2.0)):
        given = {"share": share, "beside": 2.0, **({"onset": 2.0} if name == "motion_step" else {})}
        camera = effect_named(name).inject(one_tissue, given).imaging
        seen = np.asarray(camera.distortions[-1](kind(x), one_tissue.clock))
        assert frames.start[frames.start >= 2.0][0] == 2.0
        np.testing.assert_allclose(seen, x + (share * (beside - x[:, 0]))[:, None] * course, rtol=1e-12)


def test_blur_of_a_picture_adds_to_its_point_spread(one_tissue: ForwardModel) -> None:
    sharp = dataclasses.replace(one_tissue, imaging=Camera(3.0))
    assert read_injection("partial_volume=4", imaged=True).into(sharp).imaging.point_spread == pytest.approx(5.0)


@pytest.mark.parametrize("axis", ["6", "-1", "0.5", "nan"])
def test_a_way_of_moving_that_there_is_not_is_refused(axis: str, one_tissue: ForwardModel) -> None:
    with pytest.raises(InputError):
        read_injection(f"motion_step=2,axis={axis}", imaged=True).into(one_tissue)


def test_an_effect_has_one_form_by_the_symbol_of_its_amplitude() -> None:
    motion, gain = effect_named("motion_step"), effect_named("gain_step")
    assert motion.form("share") is motion
    assert motion.form("moved") is motion.imaged
    assert gain.form("gain") is gain


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("delay=3", "There is no effect 'delay'; choose one of arterial_delay"),
        ("arterial_delay=soon", r"'soon' is not a number; write arterial_delay=VALUE \(s\)"),
        ("second_tissue=0.05,k9=1", "no parameter 'k9'"),
        ("second_tissue=0.05,0.02", "no parameter ''"),
        ("blood_volume=nan", "give a finite number"),
    ],
)
def test_options_that_name_nothing_are_refused(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_injection(text)


@pytest.mark.parametrize(
    "text",
    [
        "blood_volume=5",
        "second_tissue=-0.1",
        "parent_fraction=2",
        "parent_fraction=0.3,course=5",
        "parent_fraction=0.3,course=2",
        "gain_step=0.1,onset=nan",
        "attenuation_mismatch=0.1,region=3",
        "motion_step=0.1,beside=3",
        "motion_step=0.1,beside=0.5",
    ],
)
def test_impossible_strengths_are_refused(text: str, one_tissue: ForwardModel) -> None:
    with pytest.raises(InputError):
        read_injection(text).into(one_tissue)


@pytest.mark.parametrize("late", [0.0, 0.5])
@pytest.mark.parametrize("course", [1.0, 2.0])
def test_metabolites_that_come_sooner_or_are_more(course: float, late: float, one_tissue: ForwardModel) -> None:
    """Of more metabolites by s the fraction is P - s (1 - P), with s = a P / (1 - P) where the scan ends; where they
    come sooner their odds grow by a factor. Before late blood arrives there is no fraction, and no metabolite."""
    effect = effect_named("parent_fraction")
    base = able(effect, one_tissue)
    base = dataclasses.replace(base, input=base.input.delayed(late)) if late else base
    changed = effect.inject(base, {"loss": 0.6, "course": course})
    assert base.input.parent_fraction is not None
    assert changed.input.parent_fraction is not None
    t = torch.tensor([3.0, base.clock.frames.end[-1]], dtype=torch.float64)
    recorded, last = base.input.parent_fraction(t), float(base.input.parent_fraction(t)[-1])
    share = 0.6 * last / (1.0 - last)
    more = recorded - share * (1.0 - recorded)
    sooner = 1.0 / (1.0 + (1.0 / recorded - 1.0) * (1.0 + 0.6 / 0.4 / (1.0 - last)))
    expected = more if course == 2.0 else sooner
    assert changed.input.parent_fraction(t).tolist() == pytest.approx(expected.tolist(), rel=2e-3)
    ratio = changed.input.plasma(t) / base.input.plasma(t)
    assert ratio.tolist() == pytest.approx((expected / recorded).tolist(), rel=2e-3)


def with_fraction(model: ForwardModel, recorded: PiecewiseLinear, late: float) -> ForwardModel:
    """With such a recorded parent fraction, all blood late by so many minutes."""
    base = able(effect_named("parent_fraction"), model)
    return dataclasses.replace(base, input=dataclasses.replace(base.input, parent_fraction=recorded).delayed(late))


@pytest.mark.parametrize("late", [0.0, 0.5])
@pytest.mark.parametrize("loss", [0.4, -0.4])
def test_metabolites_of_a_steeper_course(loss: float, late: float, one_tissue: ForwardModel) -> None:
    """Of a fraction 1 / (1 + (t / tau)^b) another b gives the odds another power; half of it is left at tau as before.
    To first order in the loss the fraction loses it, where it changes most."""
    effect = effect_named("parent_fraction")
    t = np.linspace(0.0, 100.0, 4001)
    recorded = 1.0 / (1.0 + (t / 4.0) ** 1.5)
    base = with_fraction(one_tissue, PiecewiseLinear(t, recorded), late)
    changed = effect.inject(base, {"loss": loss, "course": 3.0})
    assert changed.input.parent_fraction is not None
    at = torch.tensor([2.0, 4.0, base.clock.frames.end[-1] - late], dtype=torch.float64)
    most = float(((1.0 - recorded) * 1.5 * np.log(np.maximum(t, 1e-9) / 4.0))[t <= float(at[-1])].max())
    steeper = 1.0 / (1.0 + (at.numpy() / 4.0) ** (1.5 * (1.0 + loss / most)))
    assert changed.input.parent_fraction(at + late).tolist() == pytest.approx(steeper.tolist(), rel=2e-3)
    little = effect.inject(base, {"loss": 1e-3, "course": 3.0}).input.parent_fraction
    assert little is not None
    fell = 1.0 - little(at + late) / base.input.parent_fraction(at + late)
    assert float(fell.max()) == pytest.approx(1e-3, rel=0.02)


@pytest.mark.parametrize("late", [0.0, 0.5])
@pytest.mark.parametrize("loss", [0.4, -0.4])
def test_metabolites_that_are_made_at_a_higher_rate(loss: float, late: float, one_tissue: ForwardModel) -> None:
    """k times the rate -dP/dt / P gives P^k; the loss is that where the scan ends."""
    effect = effect_named("parent_fraction")
    t = np.linspace(0.0, 100.0, 4001)
    recorded = np.exp(-0.08 * t / (1.0 + 0.05 * t))
    base = with_fraction(one_tissue, PiecewiseLinear(t, recorded), late)
    changed = effect.inject(base, {"loss": loss, "course": 4.0})
    assert changed.input.parent_fraction is not None
    at = torch.tensor([2.0, 9.0, base.clock.frames.end[-1] - late], dtype=torch.float64)
    was = np.interp(at.numpy(), t, recorded)
    times = 1.0 + np.log(1.0 - loss) / np.log(was[-1])
    assert changed.input.parent_fraction(at + late).tolist() == pytest.approx((was**times).tolist(), rel=2e-3)
    ratio = changed.input.plasma(at + late) / base.input.plasma(at + late)
    assert ratio.tolist() == pytest.approx((was ** (times - 1.0)).tolist(), rel=2e-3)


@pytest.mark.parametrize("corrected", [True, False])
def test_a_frame_whose_end_slipped_has_what_the_next_one_lacks(corrected: bool, one_tissue: ForwardModel) -> None:
    """Counts of one value are the same in all; beyond the last frame nothing can lack any."""
    clock = dataclasses.replace(one_tissue.clock, corrected=corrected)
    model, effect = dataclasses.replace(one_tissue, clock=clock), effect_named("frame_duration")
    last = len(clock.frames) - 1
    for frame in (11, last):  # 10 s before 20 s
        changed = effect.inject(model, {"gain": 0.1, "frame": float(frame), "edge": 1.0}).clock.gain_or_one
        assert changed[frame] == pytest.approx(1.1)
        assert (np.flatnonzero(changed != 1.0) == range(frame, min(frame + 2, last + 1))).all()
    slipped = effect.inject(model, {"gain": 0.1, "frame": 11.0, "edge": 1.0}).clock.gain_or_one
    assert clock.divisor @ slipped == pytest.approx(clock.divisor.sum())
    assert slipped[12] == pytest.approx(0.95, abs=2e-4 if corrected else 1e-12)


def test_a_second_tissue_beside_a_second_tissue_is_refused(one_tissue: ForwardModel) -> None:
    twice = effect_named("second_tissue").inject(one_tissue)
    with pytest.raises(InputError, match="has a second compartment already"):
        effect_named("second_tissue").inject(twice)


def test_an_effect_of_no_stage_cannot_be_made() -> None:
    with pytest.raises(InputError, match="the stages are input"):
        dataclasses.replace(EFFECTS[0], stage="weather")


def test_missing_rates_are_named(one_tissue: ForwardModel) -> None:
    with pytest.raises(InputError, match="Model 2TCM needs k3, k4"):
        dataclasses.replace(one_tissue, tissue=Tissue("2TCM", one_tissue.tissue.rates)).frame_values()
