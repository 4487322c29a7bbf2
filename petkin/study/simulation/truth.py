"""What a fit should find: labels, parameter maps and tables, and the effects that were put in."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Any

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from numpy.typing import NDArray

from petkin import __version__
from petkin.effects import ForwardModel
from petkin.imaging import in_seconds
from petkin.io import AtomicFolder, json_text, write_map, write_table, write_text
from petkin.io.descriptions import BIDS_VERSION, file_unit, measure_name
from petkin.io.names import dseg_path, kinpar_path, map_path, report_path, sidecar_path, tacs_path
from petkin.kinetics import compartment_model
from petkin.study.simulation.planning import Plan
from petkin.study.simulation.scene import Scene
from petkin.study.truth import NOISE_FREE, SEGMENTATION, TRUTH, TRUTH_FOLDER


def truth_description(study: str) -> dict[str, Any]:
    """dataset_description.json of the truth."""
    return {
        "Name": f"truth behind {study}",
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "derivative",
        "GeneratedBy": [{"Name": "petkin simulate", "Version": __version__}],
        "SourceDatasets": [{"URL": "../.."}],
    }


def quantities(model: ForwardModel) -> dict[str, Float[NDArray, " curves"]]:
    """Parameters and macro-parameters of a forward model by symbol."""
    compartments, parameters = compartment_model(model.tissue.model), model.parameters
    found = dict(zip(compartments.parameters.symbols, parameters.unbind(-1)))
    return {s: torch.as_tensor(v).numpy() for s, v in (found | compartments.macro(parameters)).items()}


def write_truth(folder: AtomicFolder, scan: dict[str, str], plan: Plan, scene: Scene) -> None:
    """Write labels, maps, tables and the record of what was simulated."""
    model = scene.truth.tissue.model
    regional = quantities(scene.truth)
    write_map(
        _place(folder, dseg_path(scan, seg=SEGMENTATION)),
        plan.painted.labels,
        plan.painted.affine,
        {"Description": f"Regions of phantom {plan.phantom.name}: {plan.phantom.title}", "Manual": False},
    )
    names = pd.DataFrame({"index": [r.index for r in plan.painted.regions], "name": list(scene.truth.regions)})
    write_table(_place(folder, dseg_path(scan, seg=SEGMENTATION).with_suffix("").with_suffix(".tsv")), names)
    for symbol, values in (quantities(scene.voxels) if scene.voxels else regional).items():
        measure = measure_name(symbol)
        fields = {"Description": f"True {measure}", "Units": _units(model)[measure], "ModelName": model}
        path = _place(folder, map_path(scan, model, measure, desc=TRUTH))
        write_map(path, _map(plan, values).astype(np.float32), plan.painted.affine, fields)
    _write_kinpar(folder, scan, names, regional, model)
    write_text(_place(folder, report_path(scan, desc=TRUTH, extension=".json")), json_text(_record(plan, scene)))
    if plan.settings.truth_tacs:
        _write_curves(folder, scan, plan, scene)


def _units(model: str) -> dict[str, str]:
    """Units of a model's quantities as files spell both."""
    return {measure_name(q.symbol): file_unit(q.unit) for q in compartment_model(model).quantities}


def _map(plan: Plan, values: Float[NDArray, " curves"]) -> Float[NDArray, "x y z"]:
    if len(values) == len(plan.painted.regions):
        return plan.painted.map_of(values)
    volume = np.zeros(plan.painted.labels.shape)
    volume[plan.painted.mask] = values
    return volume


def _write_kinpar(
    folder: AtomicFolder, scan: dict[str, str], names: pd.DataFrame, values: dict[str, NDArray], model: str
) -> None:
    path = kinpar_path(scan, model, seg=SEGMENTATION, desc=TRUTH)
    columns = {measure_name(symbol): column for symbol, column in values.items()}
    write_table(_place(folder, path), names.assign(**columns))
    units = {measure: {"Units": _units(model)[measure]} for measure in columns}
    text = json_text({"Description": "True kinetic parameters by region", "ModelName": model, **units})
    write_text(_place(folder, sidecar_path(path)), text)


def _write_curves(folder: AtomicFolder, scan: dict[str, str], plan: Plan, scene: Scene) -> None:
    path = tacs_path(scan, seg=SEGMENTATION, desc=NOISE_FREE)
    start, duration = in_seconds(plan.frames)
    curves = dict(zip(scene.truth.regions, scene.truth.frame_values().numpy()))
    frames = {"frame_start": start, "frame_end": np.add(start, duration).tolist()}
    write_table(_place(folder, path), pd.DataFrame({**frames, **curves}))
    fields = {
        "Description": "Regional curves without noise and point spread",
        "Units": "kBq/mL",
        "ImageDecayCorrected": plan.observation.corrected,
        "ImageDecayCorrectionTime": 0,
    }
    write_text(_place(folder, sidecar_path(path)), json_text(fields))


def _record(plan: Plan, scene: Scene) -> dict[str, Any]:
    settings, noise = plan.settings, scene.truth.noise
    return {
        "Description": "What was simulated",
        "Preset": settings.preset,
        "Seed": settings.seed,
        "Subject": scene.subject,
        "Session": scene.session,
        "Phantom": plan.phantom.name,
        "Population": {"Name": plan.population.name, "Source": plan.population.source},
        "ModelName": scene.truth.tissue.model,
        "BodyWeight": scene.given.weight,
        "BodyWeightUnits": "kg",
        "Plasma": {"Name": plan.population.blood.plasma, "A1": scene.given.rise, "A1Units": "source units min-1"},
        "DecayConstant": plan.observation.decay,
        "DecayConstantUnits": "min-1",
        "PointSpread": scene.truth.imaging.point_spread,
        "PointSpreadUnits": "mm",
        "Noise": {
            "Percent": noise.percent,
            "Reference": noise.reference if noise.percent > 0 else None,
            "ReferenceUnits": "kBq/mL",
            "FrameCommonShare": noise.common_share,
            "CorrelationFWHM": noise.correlation,
        },
        "BloodNoisePercent": settings.blood_noise,
        "KineticsVaryByVoxel": settings.voxel_spread,
        "Effects": [
            {
                "Name": injection.effect.name,
                "Stage": injection.effect.stage,
                "Values": {
                    p.symbol: {"Value": injection.values[p.symbol], "Units": p.unit}
                    for p in injection.effect.parameters
                },
            }
            for injection in plan.effects
        ],
    }


def _place(folder: AtomicFolder, path: PurePosixPath) -> Any:
    return folder.path(TRUTH_FOLDER / path)
