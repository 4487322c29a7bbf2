"""The learning tables end to end, tiny: trained, kept, not done again, printed beside the published."""

from __future__ import annotations

import pandas as pd
import pytest
import torch
from matplotlib.image import imread
from typer.testing import CliRunner

from petkin.errors import InputError
from petkin.hybrid import save_tensors
from petkin_bench.cli import app
from petkin_bench.decoding import DECODERS
from petkin_bench.learning_tables import PUBLISHED, compare, short
from petkin_bench.pictures import write_pictures
from petkin_bench.protocol import PRESETS, build, find_preset, jobs
from petkin_bench.systems import DYNAMICS, SYSTEMS


def test_a_table_is_run_once_and_compared(tmp_path):
    options = ["--system", "pendulum", "--preset", "tiny", "--work", str(tmp_path), "--results", str(tmp_path)]
    arguments = ["run", "--table", "hybrid", "--dynamics", "purely_physics", *options]
    first = CliRunner().invoke(app, arguments)
    assert first.exit_code == 0, first.output
    rows = pd.read_csv(tmp_path / "learning.csv")
    assert list(rows["split"]) == ["ID", "ID", "OOD", "OOD"]
    assert list(rows["test"]) == ["prediction", "refined"] * 2
    assert {"mse_x", "mse_z", "vpt_x", "vpt_z", "mse_cp", "seed", "preset", "commit", "cpu"} <= set(rows)
    again = CliRunner().invoke(app, arguments)
    assert "1 runs, 1 of them done." in again.output
    assert len(pd.read_csv(tmp_path / "learning.csv")) == 4
    found = compare(tmp_path, "tiny").query("variant == 'physics_decoder'").set_index(["split", "metric"])
    assert found.loc[("ID", "mse_z"), "published"] == pytest.approx(0.1309)
    assert found.loc[("ID", "mse_z"), "ratio"] == pytest.approx(rows["mse_z"][0] / 0.1309)
    printed = CliRunner(env={"COLUMNS": "80"}).invoke(app, ["tables", "--preset", "tiny", "--results", str(tmp_path)])
    lines = printed.output.splitlines()
    assert "hybrid: pendulum, MSE of states z" in lines
    assert max(len(line) for line in lines) <= 80
    at = next(i for i, line in enumerate(lines) if line.startswith(" purely physics"))
    ours, refined = lines[at].split(), lines[at + 1].split()
    assert ours[3:5] == [short(rows["mse_z"][0]), "0.13"]
    assert refined[0] == "refined"
    assert refined[2:4] == [short(rows["mse_z"][1]), "0.13"]


def test_a_run_is_drawn_from_its_checkpoint(tmp_path):
    model = build(SYSTEMS[0], "meta_hylad", find_preset("tiny"), 0)
    path = tmp_path / "tiny_hybrid_pendulum_meta_hylad_meta_kall_seed0.safetensors"
    save_tensors(path, {f"model.{name}": value for name, value in model.state_dict().items()}, {})
    (drawn,) = write_pictures(tmp_path, tmp_path / "pictures", find_preset("tiny"))
    assert drawn.name == path.with_suffix(".png").name
    assert imread(drawn).std() > 0.05
    with pytest.raises(InputError, match="no checkpoints of preset 'cpu'"):
        write_pictures(tmp_path, tmp_path, find_preset("cpu"))


def test_strategies_are_tested_on_both_tasks(tmp_path):
    options = ["--preset", "tiny", "--work", str(tmp_path), "--results", str(tmp_path)]
    done = CliRunner().invoke(app, ["run", "--table", "strategy", *options])
    assert done.exit_code == 0, done.output
    found = compare(tmp_path, "tiny")
    published = found[found["published"].notna()]
    assert set(published["method"]) == {"recon_hylad", "meta_hylad", "mixed_hylad"}
    assert set(published["split"]) == {"prediction", "reconstruction"}
    assert {"mse_cp", "mse_f"} <= set(published["metric"])


def test_a_learned_decoder_stands_beside_the_published_one(tmp_path):
    options = ["--system", "pendulum", "--preset", "tiny", "--work", str(tmp_path), "--results", str(tmp_path)]
    done = CliRunner().invoke(app, ["run", "--decoder", "neural_prior", *options])
    assert done.exit_code == 0, done.output
    found = compare(tmp_path, "tiny").set_index(["table", "split", "metric"])
    assert found.loc[("baselines", "ID", "mse_x"), "variant"] == "neural_prior"
    assert found.loc[("baselines", "ID", "mse_x"), "published"] == pytest.approx(0.00029)
    refused = CliRunner().invoke(app, ["run", "--decoder", "magic", *options])
    assert "choose one of physics, neural_prior, neural, adaptive" in str(refused.exception)


@pytest.mark.parametrize("name", DECODERS[1:])
def test_a_decoder_draws_every_system(name):
    for system in SYSTEMS:
        model = build(system, "meta_hylad", find_preset("tiny"), 0, name)
        pictures = system.emission.observe(torch.full((1, 1, len(system.times), len(system.states)), 0.5))
        found = model.encode(pictures)
        drawn = model.observe(found, found.initial[..., None, :])
        assert drawn.shape == pictures[:, :, :1].shape


def test_every_table_has_its_runs_and_every_model_can_be_built():
    assert len(jobs("hybrid", None, 3)) == 3 * len(SYSTEMS) * len(DYNAMICS)
    assert len({job.label for job in jobs("strategy", None, 2)}) == 10
    for preset in PRESETS:
        for system in SYSTEMS:
            assert build(system, "meta_hylad", preset, 0).hyper is not None
    paper = build(SYSTEMS[0], "meta_hylad", find_preset("paper"), 0)
    assert paper.hyper is not None
    assert paper.hyper.layers[-1].out_features == 241


def test_published_figures_are_the_papers():
    table = pd.read_csv(PUBLISHED)
    assert len(table) == 752
    chosen = table[(table["table"] == "pet") & (table["method"] == "meta_hylad") & (table["metric"] == "psnr_x")]
    assert chosen["mean"].tolist() == pytest.approx([56.4], abs=0.05)


def test_a_figure_takes_two_digits_and_seven_letters():
    told = [short(x) for x in (0.0, 0.0103, 0.00256, -3.2e-11, 57.66, 812.3, 9.9e5, float("nan"))]
    assert told == ["0", "0.01", "2.6e-3", "-3.2e-11", "58", "812", "9.9e5", ""]


def test_bad_names_are_one_line(tmp_path):
    with pytest.raises(InputError, match="choose hybrid or strategy"):
        jobs("magic", None, 1)
    with pytest.raises(InputError, match="choose one of tiny, cpu, paper"):
        find_preset("huge")
    with pytest.raises(InputError, match="there are no results yet"):
        compare(tmp_path, "cpu")
