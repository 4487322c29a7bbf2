"""Where a state map goes: a table with its JSON, and the report."""

from __future__ import annotations

from petkin.io import AtomicFolder, json_text, write_table, write_text
from petkin.io.names import sidecar_path, states_path
from petkin.reporting import LackingTerm
from petkin.study.diagnosis.request import DiagnoseRequest
from petkin.study.diagnosis.state import StatesRead
from petkin.study.diagnosis.state_table import state_sidecar, state_table, told
from petkin.study.sources import Source


def write_states(folder: AtomicFolder, source: Source, states: StatesRead, request: DiagnoseRequest) -> None:
    """`<scan>_desc-state_gap.tsv` and `.json` into the staging folder."""
    path = states_path(source.entities)
    sidecar = state_sidecar(states, sources=source.files, command=request.command_line, seed=request.seed)
    write_table(folder.path(path), state_table(states))
    write_text(folder.path(sidecar_path(path)), json_text(sidecar))


def drawn_states(states: StatesRead | None) -> LackingTerm | None:
    """As a report draws it."""
    if states is None:
        return None
    found = states.found
    parts = (states.state, found.term, found.low, found.high, found.claimed)
    return LackingTerm(states.regions, states.frames, *parts, told(states))
