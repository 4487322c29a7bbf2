"""JSON beside the simulated data: what the scanner and the injection were."""

from __future__ import annotations

from typing import Any

import numpy as np

from petkin.imaging import in_seconds
from petkin.study.simulation.planning import Plan
from petkin.study.simulation.scene import Scene

#: Activity per mass of tracer, MBq/ug; of no consequence for tracer kinetics.
_SPECIFIC_ACTIVITY = 1000.0


def pet_sidecar(plan: Plan, scene: Scene) -> dict[str, Any]:
    """`_pet.json`: every field that PET-BIDS requires, and what decay the image holds."""
    start, duration = in_seconds(plan.frames)
    return {
        "Manufacturer": "petkin simulator",
        "ManufacturersModelName": f"phantom {plan.phantom.name}",
        "BodyPart": "brain",
        "Units": plan.settings.units,
        "TracerName": plan.population.tracer,
        "TracerRadionuclide": plan.radionuclide,
        "RadionuclideHalfLife": round(plan.half_life_s, 6),
        "InjectedRadioactivity": scene.given.dose,
        "InjectedRadioactivityUnits": "MBq",
        "InjectedMass": round(scene.given.dose / _SPECIFIC_ACTIVITY, 6),
        "InjectedMassUnits": "ug",
        "SpecificRadioactivity": _SPECIFIC_ACTIVITY,
        "SpecificRadioactivityUnits": "MBq/ug",
        "ModeOfAdministration": "bolus",
        "TimeZero": "10:00:00",
        "ScanStart": 0,
        "InjectionStart": 0,
        "InjectionEnd": 0,
        "FrameTimesStart": start,
        "FrameDuration": duration,
        "AcquisitionMode": "list mode",
        "ImageDecayCorrected": plan.observation.corrected,
        "ImageDecayCorrectionTime": 0,
        "DecayCorrectionFactor": _decay_factors(plan),
        "ReconMethodName": "simulated, no reconstruction",
        "ReconMethodParameterLabels": ["none"],
        "ReconMethodParameterUnits": ["none"],
        "ReconMethodParameterValues": [0],
        "ReconFilterType": "none",
        "ReconFilterSize": 0,
        "AttenuationCorrection": "none, simulated without attenuation",
    }


def _decay_factors(plan: Plan) -> list[float]:
    """lambda d / (1 - e^{-lambda d}) e^{lambda start} of every frame, or 1 where values are not corrected."""
    if not plan.observation.corrected:
        return [1.0] * len(plan.frames)
    factors = plan.frames.duration / plan.observation.mean_decay_times_duration
    return np.round(factors, 9).tolist()
