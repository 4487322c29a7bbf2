"""What a study holds, and what is odd about it."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path

from petkin.errors import InputError
from petkin.io.bids import Scan, read_study
from petkin.io.checks import OddVoxels
from petkin.io.labels import read_regions
from petkin.io.remarks import Remark, Severity, severe

_ORDER = (Severity.SEVERE, Severity.WARNING, Severity.NOTE)


@dataclass(frozen=True)
class ScanOverview:
    """One line of the table of scans.

    Args:
        scan: start of its file names.
        subject: label.
        session: label, "" for none.
        tracer: name as the sidecar gives it.
        nuclide: e.g. "C11".
        frames: how many.
        minutes: end of the last frame, min.
        image: x, y, z, frames; empty where there is no image.
        manual_samples: rows of manual blood.
        automatic_samples: rows of autosampler blood.
        regions: number of regions by segmentation label.
    """

    scan: str
    subject: str
    session: str
    tracer: str
    nuclide: str
    frames: int
    minutes: float
    image: tuple[int, ...]
    manual_samples: int
    automatic_samples: int
    regions: dict[str, int]


@dataclass(frozen=True)
class Finding:
    """Remarks of one kind, over all scans.

    Args:
        severity: how much it matters.
        code: name of the trap.
        count: how many remarks there are.
        sentence: the first of them, with its file.
        all: every one of them.
    """

    severity: Severity
    code: str
    count: int
    sentence: str
    all: tuple[str, ...]


@dataclass(frozen=True)
class StudyOverview:
    """What `petkin info` shows.

    Args:
        name: name of the study.
        scans: one entry a scan that could be read.
        findings: what is odd, the worst first.
        refused: scans that cannot be used, one line each.
    """

    name: str
    scans: tuple[ScanOverview, ...]
    findings: tuple[Finding, ...]
    refused: tuple[str, ...]


def inspect_study(root: Path, *, subjects: Collection[str] | None = None, voxels: bool = False) -> StudyOverview:
    """Read all of a study but its voxels, and list what is odd.

    Args:
        root: the study.
        subjects: labels to look at; None for all.
        voxels: also read the images, to count NaN, infinite and negative values.

    Raises:
        InputError: there is no study.
    """
    study = read_study(root, subjects=subjects, refuse=False)
    rows, remarks = [], list(study.remarks)
    for scan in study.scans:
        row, found = _look_at(scan, voxels=voxels)
        rows.append(row)
        remarks += [*scan.remarks, *found]
    return StudyOverview(study.name, tuple(rows), group(remarks), study.refused)


def group(remarks: Iterable[Remark]) -> tuple[Finding, ...]:
    """Remarks of one kind as one finding; the worst kinds first, then in order of appearance."""
    kinds: dict[tuple[Severity, str], list[Remark]] = {}
    for remark in remarks:
        kinds.setdefault((remark.severity, remark.code), []).append(remark)
    findings = [
        Finding(severity, code, len(found), str(found[0]), tuple(map(str, found)))
        for (severity, code), found in kinds.items()
    ]
    return tuple(sorted(findings, key=lambda finding: _ORDER.index(finding.severity)))


def _look_at(scan: Scan, *, voxels: bool) -> tuple[ScanOverview, list[Remark]]:
    remarks: list[Remark] = []
    regions = {curves.seg or "(none)": len(curves.names) for curves in scan.curves}
    image: tuple[int, ...] = ()
    if scan.image is not None:
        try:
            series = scan.open_image()
            image = (*series.shape, series.count)
            regions |= {dseg.seg or "(none)": len(read_regions(dseg, series).names) for dseg in scan.dseg}
            if voxels:
                remarks += sum(map(OddVoxels.of, series.frames()), OddVoxels()).remarks(scan.image.name)
        except InputError as error:
            remarks.append(severe("image-unusable", scan.prefix, str(error)))
    manual, automatic = (scan.blood.manual, scan.blood.automatic) if scan.blood else (None, None)
    row = ScanOverview(
        scan=scan.prefix,
        subject=scan.subject,
        session=scan.session,
        tracer=scan.sidecar.tracer_name,
        nuclide=scan.nuclide,
        frames=len(scan.frames),
        minutes=float(scan.frames.end[-1]),
        image=image,
        manual_samples=0 if manual is None else len(manual),
        automatic_samples=0 if automatic is None else len(automatic),
        regions=regions,
    )
    return row, remarks
