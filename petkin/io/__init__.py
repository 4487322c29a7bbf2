"""Files: PET-BIDS studies, images, blood, curves and results; traps are named, outputs appear whole or not at all."""

from petkin.io.atomic import AtomicFolder, atomic_file, require_writable, write_bytes, write_text
from petkin.io.bids import Scan, Study, read_study
from petkin.io.blood import BloodRecord, join_recordings, read_blood
from petkin.io.blood_checks import against_tissue, require_cover
from petkin.io.blood_table import BloodTable, read_blood_table
from petkin.io.checks import OddVoxels, check_sidecar, implied_references
from petkin.io.input_table import read_input_table, write_input_table
from petkin.io.jsonfile import json_text, read_json
from petkin.io.labels import Dseg, Regions, find_dseg, read_regions
from petkin.io.nifti import Series, open_series, read_label_volume, read_volume, require_same_grid
from petkin.io.nifti_write import write_map, write_series
from petkin.io.regions import RegionalCurves, read_tacs, read_volumes, write_tacs
from petkin.io.remarks import Remark, Severity
from petkin.io.schedule import read_schedule
from petkin.io.scratch import Rows, Scratch
from petkin.io.sidecar import PetSidecar, read_sidecar
from petkin.io.tables import read_table, write_table

__all__ = [
    "AtomicFolder",
    "BloodRecord",
    "BloodTable",
    "Dseg",
    "OddVoxels",
    "PetSidecar",
    "RegionalCurves",
    "Regions",
    "Remark",
    "Rows",
    "Scan",
    "Scratch",
    "Series",
    "Severity",
    "Study",
    "against_tissue",
    "atomic_file",
    "check_sidecar",
    "find_dseg",
    "implied_references",
    "join_recordings",
    "json_text",
    "open_series",
    "read_blood",
    "read_blood_table",
    "read_input_table",
    "read_json",
    "read_label_volume",
    "read_regions",
    "read_schedule",
    "read_sidecar",
    "read_study",
    "read_table",
    "read_tacs",
    "read_volume",
    "read_volumes",
    "require_cover",
    "require_same_grid",
    "require_writable",
    "write_bytes",
    "write_input_table",
    "write_map",
    "write_series",
    "write_table",
    "write_tacs",
    "write_text",
]
