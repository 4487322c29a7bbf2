"""Episodes, strategies, training: resumed to the same losses, dead runs noticed, f_NN found."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from petkin.errors import InputError, NumericalError
from petkin.hybrid import (
    Encoded,
    Settings,
    episodes,
    find_strategy,
    learning_rate,
    load_tensors,
    measure,
    of_others,
    signal_to_noise,
    train,
    valid_share,
)
from petkin.hybrid.gradients import loss_of
from petkin.hybrid.validation import Validation

from .oscillator import data, make

_SHORT = Settings(steps=12, dynamics=4, series=4, save_every=5)


def test_contexts_never_hold_their_own_query():
    marks = torch.eye(5).expand(2, 5, 5)
    for k in range(1, 5):
        mean = of_others(marks, k)
        assert bool((mean.diagonal(dim1=1, dim2=2) == 0).all())
        torch.testing.assert_close(mean.sum(-1), torch.ones(2, 5))
        assert bool(((mean > 0).sum(-1) == k).all())
    with pytest.raises(InputError, match="5 series cannot have 5 others"):
        of_others(marks, 5)


def test_strategies_take_from_where_they_say():
    values = torch.arange(6.0).reshape(1, 3, 2)
    said = Encoded(values, values, values)
    assert find_strategy("reconstruct")(said, 2) is said
    meta, mixed = find_strategy("meta")(said, 2), find_strategy("mixed")(said, 2)
    torch.testing.assert_close(meta.physics, of_others(values, 2))
    torch.testing.assert_close(mixed.physics, values)
    for found in (meta, mixed):
        torch.testing.assert_close(found.code, of_others(values, 2))
        torch.testing.assert_close(found.initial, values)
    with pytest.raises(InputError, match="choose one of reconstruct, meta, mixed"):
        find_strategy("guess")


def test_episodes_repeat_with_their_seed_and_hold_no_series_twice():
    first, again = (
        next(episodes(data(), dynamics=4, series=5, generator=torch.Generator().manual_seed(3))) for _ in range(2)
    )
    assert torch.equal(first.states, again.states)
    assert len(torch.unique(first.states[0, :, 0, 0])) == 5
    with pytest.raises(InputError, match="cannot be drawn from 12 x 6"):
        next(episodes(data(), dynamics=13, series=5, generator=torch.Generator()))


def test_a_resumed_run_goes_on_to_the_same_losses(tmp_path):
    whole = train(make, data(), _SHORT)
    path = tmp_path / "run.safetensors"

    def stop(step, loss):
        if step == 8:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(make, data(), _SHORT, checkpoint=path, progress=stop)
    assert load_tensors(path)[1]["step"] == 5
    resumed = train(make, data(), _SHORT, checkpoint=path)
    assert resumed.losses == whole.losses
    assert whole.earlier_s == 0.0 < resumed.earlier_s
    for a, b in zip(whole.model.parameters(), resumed.model.parameters()):
        assert torch.equal(a, b)
    with pytest.raises(InputError, match="a checkpoint of another run"):
        train(make, data(), replace(_SHORT, rate=1e-2), checkpoint=path)


def test_what_is_no_checkpoint_is_refused(tmp_path):
    (tmp_path / "x").write_bytes(b"pickle?")
    with pytest.raises(InputError, match="not a checkpoint of petkin"):
        load_tensors(tmp_path / "x")
    with pytest.raises(InputError, match="no such checkpoint"):
        load_tensors(tmp_path / "y")


def test_a_run_that_leaves_the_numbers_begins_again_and_says_so():
    seeds = []

    def poisoned(seed):
        seeds.append(seed)
        model = make(seed)
        if len(seeds) == 1:
            with torch.no_grad():
                model.to_physics.bias.fill_(float("nan"))
        return model

    run = train(poisoned, data(), replace(_SHORT, steps=30))
    assert seeds == [0, 1000]
    assert "not finite" in run.remarks[0]
    assert "Begun again" in run.remarks[0]
    assert run.step == 30


def test_a_blank_prediction_is_noticed():
    def out_of_sight(seed):
        model = make(seed, residual=None)
        model.task.reach.zero_()
        model.task.centre.fill_(0.0)
        return model

    with pytest.raises(NumericalError, match=r"Training died 1 times.*blank"):
        train(out_of_sight, data(), replace(_SHORT, steps=500, restarts=0))


def test_the_rate_rises_and_falls_once():
    settings = Settings(steps=100, rate=2e-3, warm_up=0.2, final=0.01)
    rates = [learning_rate(s, settings) for s in range(100)]
    assert max(rates) == pytest.approx(2e-3)
    assert rates.index(max(rates)) == 19
    assert rates[0] == pytest.approx(1e-4)
    assert rates[-1] == pytest.approx(2e-5, rel=0.1)


def test_learning_to_identify_finds_the_damping_that_physics_alone_cannot():
    settings = Settings(steps=350, dynamics=8, series=6, rate=1e-2)
    seen, unseen = data(60, 8, seed=1), data(20, 8, seed=2)
    hybrid = train(make, seen, settings).model
    physics = train(lambda seed: make(seed, residual=None), seen, settings).model
    meta = find_strategy("meta")
    ours, theirs = (measure(model, unseen, meta, 5, physics=(0,)) for model in (hybrid, physics))
    assert ours["mse_z"] < 0.4 * theirs["mse_z"]
    damping = unseen.truth[:, 1].square().mean() * unseen.states[..., 1].square().mean()
    assert ours["mse_f"] < 0.3 * float(damping)


def test_measures_by_hand():
    exceeded = torch.tensor([[False, False, True, False], [False] * 4, [True] * 4])
    torch.testing.assert_close(valid_share(exceeded), torch.tensor([0.5, 1.0, 0.0]))
    assert float(signal_to_noise(torch.tensor(0.01), torch.tensor(10.0))) == pytest.approx(40.0)


def test_penalties_keep_f_nn_small():
    plain, small = (
        train(make, data(30, 6), replace(_SHORT, steps=150, rate=1e-2, norm=norm)).model for norm in (0.0, 10.0)
    )
    states, codes = data(5, 6, seed=9).states, torch.zeros(5, 6, 3)
    sizes = [
        float(m.residual(codes, states, torch.full((5, 6, 1), 2.0)).detach().square().mean()) for m in (plain, small)
    ]
    assert sizes[1] < 0.2 * sizes[0]


def test_validation_keeps_the_best_of_the_end_and_a_plateau_ends_a_run(tmp_path):
    settings = replace(_SHORT, steps=40, check_every=2, patience=2, rate=1e-12)
    path, log = tmp_path / "run.safetensors", tmp_path / "run.csv"
    run = train(make, data(), settings, checkpoint=path, validation=data(seed=3), log=log)
    assert run.step == 34  # checks count after step 28; those at 32 and 34 are no better than that at 30
    rows = [line.split(",") for line in log.read_text().splitlines()]
    assert rows[0] == ["step", "loss", "validation"]
    assert [float(row[1]) for row in rows[1:]] == run.losses
    assert [(int(row[0]), float(row[2])) for row in rows[1:] if row[2]] == run.checks
    again = train(make, data(), settings, checkpoint=path, validation=data(seed=3))
    assert (again.step, again.checks) == (run.step, run.checks)


def test_the_weights_of_the_best_late_check_are_returned():
    keeper, model = Validation(100, 0), torch.nn.Linear(1, 1)
    for step, error in ((50, 0.1), (80, 0.5), (90, 0.2), (100, 0.3)):
        torch.nn.init.constant_(model.weight, step)
        keeper.see(step, error, model)
    assert float(keeper.best["weight"]) == 90.0


def test_episodes_of_a_step_are_averaged_and_k_varies():
    settings = replace(_SHORT, steps=1, save_every=1)
    drawn = episodes(data(), dynamics=4, series=4, generator=torch.Generator().manual_seed(0))
    errors = [float(loss_of(make(0).train(), next(drawn), 3, settings, 0)[1].detach()) for _ in range(2)]
    assert train(make, data(), replace(settings, episodes=2)).losses == pytest.approx([sum(errors) / 2], rel=1e-6)
    varied = train(make, data(), replace(settings, steps=12, vary=True)).losses
    assert varied != train(make, data(), replace(settings, steps=12)).losses
