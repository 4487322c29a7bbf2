"""Contents of the JSON files that petkin writes beside its results, always with the same fields in the same order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from petkin.io.names import PIPELINE

BIDS_VERSION = "1.10.0"


@dataclass(frozen=True)
class Measure:
    """A quantity that a table or a map holds: symbol and unit as petkin knows them, and what it is in words."""

    symbol: str
    unit: str
    meaning: str = ""

    @property
    def name(self) -> str:
        """Its name in files."""
        return measure_name(self.symbol)

    @property
    def fields(self) -> dict[str, str]:
        """Description and unit for a sidecar."""
        text = f"{self.name}: {self.meaning}" if self.meaning else self.name
        return {"Description": text, "Units": file_unit(self.unit)}


def measure_name(symbol: str) -> str:
    """A symbol as files write it: vB is VB, the others stay."""
    return "VB" if symbol == "vB" else symbol


def file_unit(unit: str) -> str:
    """A unit as BEP023 spells it: "mL cm^-3 min^-1" is "mL cm-3 min-1", no unit is "unitless"."""
    return "unitless" if unit in ("", "1") else unit.replace("^", "")


def dataset_description(version: str, *, name: str, sources: Sequence[str] = ()) -> dict[str, Any]:
    """dataset_description.json of derivatives/petkin.

    Args:
        version: petkin's version.
        name: name of the study that was fitted.
        sources: where it lies, relative to the derivatives where possible.
    """
    return {
        "Name": f"petkin results of {name}",
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "derivative",
        "GeneratedBy": [{"Name": PIPELINE, "Version": version}],
        "SourceDatasets": [{"URL": source} for source in sources],
        # what "bids:raw:..." in Sources stands for
        **({"DatasetLinks": {"raw": sources[0]}} if sources else {}),
    }


def raw_description(name: str, version: str) -> dict[str, Any]:
    """dataset_description.json of a simulated study."""
    return {
        "Name": name,
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "raw",
        "License": "CC0",
        "GeneratedBy": [{"Name": PIPELINE, "Version": version}],
    }


def provenance(
    model: str, *, sources: Sequence[str], version: str, command: str, extra: Mapping[str, Any]
) -> dict[str, Any]:
    """Fields that maps and tables of a fit share: model (if any), sources, what was chosen, software, command line."""
    return {
        **({"ModelName": model} if model else {}),
        "Sources": list(sources),
        **extra,
        "SoftwareName": PIPELINE,
        "SoftwareVersion": version,
        "CommandLine": command,
    }


def map_sidecar(measure: Measure, shared: Mapping[str, Any], *, percent_se: bool = False) -> dict[str, Any]:
    """JSON of a parametric map, or of the map of its standard error in percent."""
    error = {"Description": f"Standard error of {measure.name} in percent of its value", "Units": "percent"}
    return {**(error if percent_se else measure.fields), **shared}


def status_sidecar(meanings: Mapping[int, str], shared: Mapping[str, Any]) -> dict[str, Any]:
    """JSON of a status map: what each code means."""
    return {
        "Description": "Why a voxel has no value, or a doubtful one",
        "Units": "unitless",
        "Levels": {str(code): meaning for code, meaning in meanings.items()},
        **shared,
    }


def column_fields(meaning: str, unit: str, levels: Mapping[int, str] | None = None) -> dict[str, Any]:
    """JSON of one further column, or of a map: what it is, and what its codes mean."""
    coded = {} if levels is None else {"Levels": {str(code): text for code, text in levels.items()}}
    return {"Description": meaning, "Units": file_unit(unit), **coded}


def kinpar_sidecar(
    measures: Sequence[Measure], meanings: Mapping[int, str], shared: Mapping[str, Any]
) -> dict[str, Any]:
    """JSON of a regional parameter table: one entry a column, then what the fit was.

    Args:
        measures: parameters of the table, e.g. K1, k2, vB, VT.
        meanings: status codes and what they mean.
        shared: fields of `provenance`.
    """
    columns: dict[str, Any] = {
        "index": {"Description": "label of the region in its segmentation, or its place in the table of curves"},
        "name": {"Description": "name of the region"},
    }
    for measure in measures:
        columns[measure.name] = measure.fields
        columns[f"{measure.name}-se"] = {"Description": f"standard error of {measure.name}", "Units": "percent"}
    columns["chi2"] = {"Description": "weighted residual sum of squares over its degrees of freedom"}
    columns["aicc"] = {"Description": "Akaike criterion for small samples"}
    levels = {str(code): meaning for code, meaning in meanings.items()}
    columns["status"] = {"Description": "why a value is missing or doubtful", "Levels": levels}
    return {"Description": "Kinetic parameters by region", **shared, **columns}


def tacs_sidecar(shared: Mapping[str, Any]) -> dict[str, Any]:
    """JSON of regional curves: kBq/mL, frame means decay-corrected to time zero."""
    return {
        "Description": "Regional time-activity curves: mean over the region and frame, decay-corrected to time zero",
        "Units": "kBq/mL",
        "ImageDecayCorrected": True,
        "ImageDecayCorrectionTime": 0,
        "frame_start": {"Description": "start of the frame from time zero", "Units": "s"},
        "frame_end": {"Description": "end of the frame from time zero", "Units": "s"},
        **shared,
    }


def states_sidecar(shared: Mapping[str, Any]) -> dict[str, Any]:
    """JSON of what a law of tissue lacks, by region and frame."""
    flux = {"Units": "kBq mL-1 min-1"}
    return {
        "Description": "What dC_T/dt has beside K1 C_P - k2 C_T, both refitted, as learned residuals say",
        "region": {"Description": "name of the region"},
        "frame_start": {"Description": "start of the frame from time zero", "Units": "s"},
        "frame_end": {"Description": "end of the frame from time zero", "Units": "s"},
        "C_T": {"Description": "state: mean over the frame of activity in tissue", "Units": "kBq/mL"},
        "flux": {"Description": "what is missing of its derivative, mean over the frame and the members", **flux},
        "low": {
            "Description": "lower end of a band that holds 95 % of what members say, in all cells at once",
            **flux,
        },
        "high": {"Description": "upper end of that band", **flux},
        "claimed": {
            "Description": "whether something is missing here; without a gap 5 % of scans have a claim or more",
            "Levels": {"0": "no claim", "1": "band excludes nought, and the curves ask for it"},
        },
        **shared,
    }


def inputfunction_sidecar(shared: Mapping[str, Any]) -> dict[str, Any]:
    """JSON of an input function."""
    activity = {"Units": "kBq/mL"}
    return {
        "Description": "Arterial input function, decay-corrected to time zero",
        "time": {"Description": "time from time zero", "Units": "s"},
        "whole_blood_radioactivity": {"Description": "activity in whole blood", **activity},
        "plasma_radioactivity": {"Description": "total activity in plasma", **activity},
        "metabolite_parent_fraction": {
            "Description": "fraction of the plasma activity that is unchanged tracer",
            "Units": "unitless",
        },
        "AIF": {"Description": "plasma activity of unchanged tracer: plasma times parent fraction", **activity},
        **shared,
    }
