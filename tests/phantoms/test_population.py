"""Populations: the paper's ranges, sensible distribution volumes, spread, and draws that do not depend on order."""

from pathlib import Path

import numpy as np
import pytest

from petkin.errors import InputError
from petkin.phantoms import (
    SYMBOLS,
    draw_kinetics,
    draw_voxels,
    population_names,
    random_stream,
    read_phantom,
    read_population,
)

#: arXiv 2403.08194, appendix on dynamic PET.
PAPER_RANGES = {"K1": (0.1, 0.3), "k2": (0.01, 0.3), "k3": (0.01, 0.1), "k4": (0.01, 0.05), "vB": (0.0, 0.0)}


def many(name: str, phantom: str = "brain2d", count: int = 300, seed: int = 1) -> np.ndarray:
    population, regions = read_population(name), read_phantom(phantom).regions
    return np.stack([draw_kinetics(population, regions, seed=seed, subject=n, session=1) for n in range(1, count + 1)])


def test_paper_population_fills_the_papers_ranges_evenly() -> None:
    drawn = many("paper")
    for i, symbol in enumerate(SYMBOLS):
        low, high = PAPER_RANGES[symbol]
        values = drawn[..., i].ravel()
        assert low <= values.min() <= values.max() <= high
        assert values.mean() == pytest.approx((low + high) / 2, abs=0.03 * (high - low) + 1e-12)
        assert values.std() == pytest.approx((high - low) / np.sqrt(12), rel=0.05, abs=1e-12)


def test_paper_regions_draw_independently() -> None:
    drawn = many("paper")[..., 0]
    assert np.abs(np.corrcoef(drawn.T)[np.triu_indices(5, 1)]).max() < 0.25


@pytest.mark.parametrize("phantom", ["brain2d", "brain3d"])
def test_reversible_ligand_has_volumes_of_one_to_ten(phantom: str) -> None:
    K1, k2, k3, k4, vB = np.moveaxis(many("reversible", phantom, 60), -1, 0)
    VT = K1 / k2 * (1 + k3 / k4)
    tissue = np.array([r.tissue != "csf" for r in read_phantom(phantom).regions])
    medians = np.median(VT, axis=0)[tissue]
    assert (medians > 1).all()
    assert (medians < 10).all()
    assert 0.01 < np.median(vB) < 0.08
    assert 0.1 < np.log(VT).std(axis=0).mean() < 0.35


def test_fdg_is_irreversible_and_keeps_the_measured_order() -> None:
    K1, k2, k3, k4, _ = np.moveaxis(many("fdg"), -1, 0)
    assert not k4.any()
    Ki = np.median(K1 * k3 / (k2 + k3), axis=0)
    grey, white, striatum = Ki[:3]
    assert grey == pytest.approx(0.102 * 0.062 / 0.192, rel=0.05)
    assert white < 0.6 * grey < grey < striatum


def test_log_spread_between_subjects_and_sessions() -> None:
    population, regions = read_population("reversible"), read_phantom("brain2d").regions
    first = np.log(many("reversible")[..., 0])
    assert first.std(axis=0).mean() == pytest.approx(np.hypot(0.12, 0.05), rel=0.08)
    pair = np.array(
        [
            [draw_kinetics(population, regions, seed=1, subject=n, session=j)[:, 0] for j in (1, 2)]
            for n in range(1, 301)
        ]
    )
    retest = np.log(pair[:, 0] / pair[:, 1])
    assert retest.std() == pytest.approx(np.sqrt(2) * 0.05, rel=0.08)


def test_regions_of_a_subject_share_their_share() -> None:
    logs = np.log(many("reversible", count=600)[..., 0])
    expected = 0.6 * 0.12**2 / (0.12**2 + 0.05**2)
    assert np.corrcoef(logs.T)[np.triu_indices(5, 1)].mean() == pytest.approx(expected, abs=0.06)


def test_draws_depend_on_seed_subject_and_session_alone() -> None:
    population, regions = read_population("fdg"), read_phantom("brain3d").regions

    def draw(seed: int, subject: int, session: int) -> np.ndarray:
        return draw_kinetics(population, regions, seed=seed, subject=subject, session=session)

    alone = draw(3, 7, 2)
    for n in range(1, 4):
        draw(3, n, 1)
    np.testing.assert_array_equal(draw(3, 7, 2), alone)
    for other in (draw(4, 7, 2), draw(3, 8, 2), draw(3, 7, 1)):
        assert not np.allclose(other, alone)


def test_streams_of_different_purposes_are_independent() -> None:
    noise, blood = (random_stream(0, word, 1, 1).standard_normal(4000) for word in ("noise", "blood"))
    assert abs(np.corrcoef(noise, blood)[0, 1]) < 0.06
    np.testing.assert_array_equal(noise, random_stream(0, "noise", 1, 1).standard_normal(4000))


def test_voxels_spread_about_their_region() -> None:
    population = read_population("reversible")
    region = np.tile([0.1, 0.1, 0.05, 0.03, 0.05], (20000, 1))
    logs = np.log(draw_voxels(population, region, np.random.default_rng(0)) / region)
    np.testing.assert_allclose(logs.std(axis=0), population.spread.of(population.spread.voxel), rtol=0.03)
    np.testing.assert_allclose(logs.mean(axis=0), 0.0, atol=0.004)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("k4 = [0.01, 0.05]", ""), "lacks k4"),
        (("K1 = [0.1, 0.3]", "K1 = [0.3, 0.1]"), "runs from 0.3 down to 0.1"),
        (("vB = 0.0", "vB = -0.1"), "greater than or equal to 0"),
        (("[kinetics.any]", "[kinetics.any]\nk9 = 1.0"), "k9"),
    ],
)
def test_a_wrong_population_says_what_is_wrong(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    from petkin.phantoms import catalogue_folder

    text = (catalogue_folder() / "populations" / "paper.toml").read_text()
    assert change[0] in text
    path = tmp_path / "own.toml"
    path.write_text(text.replace(*change))
    with pytest.raises(InputError, match=message):
        read_population(path)


def test_a_tissue_that_a_population_lacks_is_named() -> None:
    population = read_population("fdg")
    odd = read_phantom("brain2d").regions[0].model_copy(update={"tissue": "bone"})
    with pytest.raises(InputError, match="neither tissue 'bone' nor 'any'"):
        draw_kinetics(population, [odd], seed=0, subject=1, session=1)


def test_shipped_populations() -> None:
    assert set(population_names()) >= {"fdg", "paper", "reversible"}
