"""Formulas on tape: what a model's arithmetic says, and derivatives by central differences."""

from __future__ import annotations

import numpy as np
import pytest

from petkin.fitting.tape import WIDTH, Tape, record, record_partials, run
from petkin.kinetics import MODELS


def played(tape: Tape, arguments: np.ndarray) -> np.ndarray:
    memory = tape.memory()
    memory[: tape.inputs] = arguments
    run(tape.steps, memory)
    return memory[tape.outputs]


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.label)
def test_models_play_as_they_are_written(model):
    rates = np.random.default_rng(1).uniform(0.02, 0.3, (model.rates, WIDTH))

    def formulas(*k):
        return (*(number for pair in model.impulse(*k) for number in pair), *(m.formula(*k) for m in model.macros))

    tape = record_partials(formulas, len(rates))
    values = np.stack(np.broadcast_arrays(*formulas(*rates)))
    answer = played(tape, rates)
    np.testing.assert_allclose(answer[: len(values)], values, rtol=1e-13)
    slopes = answer[len(values) :].reshape(len(values), len(rates), WIDTH)
    for p in range(len(rates)):
        step = np.zeros_like(rates)
        step[p] = 1e-6
        ahead, behind = (np.stack(np.broadcast_arrays(*formulas(*(rates + s)))) for s in (step, -step))
        np.testing.assert_allclose(slopes[:, p], (ahead - behind) / 2e-6, rtol=1e-5, atol=1e-6)


def test_what_is_done_twice_is_written_down_once():
    tape = record(lambda a, b: ((a + b) * (a + b), (a + b) / 2.0), 2)
    assert len(tape.steps) == 3
    assert played(tape, np.array([[1.0] * WIDTH, [3.0] * WIDTH]))[:, 0].tolist() == [16.0, 2.0]


def test_every_operation_and_its_derivative():
    tape = record_partials(lambda a, b: (-a + 2.0 - b * 3.0, 1.0 / a - b / a, (a * b) ** 0.5, b**3, 5.0), 2)
    a, b = 0.7, 1.9
    values = [-a + 2 - 3 * b, (1 - b) / a, np.sqrt(a * b), b**3, 5.0]
    slopes = [-1, -3, (b - 1) / a**2, -1 / a, 0.5 * np.sqrt(b / a), 0.5 * np.sqrt(a / b), 0, 3 * b**2, 0, 0]
    answer = played(tape, np.array([[a] * WIDTH, [b] * WIDTH]))
    np.testing.assert_allclose(answer[:, 0], [*values, *slopes], rtol=1e-14)


def test_registers_are_used_again_but_never_while_they_are_read():
    tape = record(lambda a: (sum((a + float(i)) * (a + float(i)) for i in range(50)),), 1)
    assert tape.registers < 1 + len(tape.constants) + 8
    assert (tape.steps[:, 1:2] != tape.steps[:, 2:]).all()
    assert played(tape, np.full((1, WIDTH), 2.0))[0, 0] == sum((2.0 + i) ** 2 for i in range(50))
