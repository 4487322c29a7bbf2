"""Two-tissue compartment model with trapping in vessel walls (2TCM1k).

    C = (1 - vB) (C_1 + C_2) + vB (C_B + C_W),   dC_W/dt = Kb C_P

The tissue is that of the 2TCM. Tracers of the translocator protein bind to endothelium too, for good within a scan;
left out, that uptake passes for slow binding in tissue and raises VT, which here is the tissue's alone.
"""

from __future__ import annotations

from dataclasses import replace

from petkin.dynamics import Parameter, ParameterSet
from petkin.kinetics.two_tissue import TWO_TISSUE

_TISSUE, _BLOOD = TWO_TISSUE.parameters.members[:-1], TWO_TISSUE.parameters.members[-1]
_KB = Parameter("Kb", "mL cm^-3 min^-1", 0.25, 0.0, 5.0, meaning="rate of trapping in vessel walls, a volume of blood")

VASCULAR_TRAPPING = replace(
    TWO_TISSUE,
    label="2TCM1k",
    name="two-tissue compartment model with vascular trapping",
    equation=TWO_TISSUE.equation + ";  dC_W/dt = Kb C_P;  C = (1 - vB) C_T + vB (C_B + C_W)",
    reference="Rizzo G et al. J Cereb Blood Flow Metab 2014;34:1060-1069, doi:10.1038/jcbfm.2014.55",
    parameters=ParameterSet((*_TISSUE, _KB, _BLOOD)),
    wall=True,
)
