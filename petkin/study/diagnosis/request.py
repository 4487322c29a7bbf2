"""What a user asks of `petkin diagnose`, checked at the border."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from petkin.effects import EFFECTS, Effect, effect_named
from petkin.errors import InputError
from petkin.kinetics import MODELS, ONE_TISSUE, CompartmentModel

#: Effects that can be included or taken out.
NAMES = tuple(effect.name for effect in EFFECTS)
#: Fewer trainings than these say little of how trainings differ.
FEWEST_MEMBERS = 5
#: How blood is read: as its record stands, or as a fit reads it, with errors as its samples scatter.
RECORDED, FITTED = "recorded", "fitted"
#: What a simulator of this name has in it already.
_IMPLIED = {"2TCM": "second_tissue", "2TCM3k": "second_tissue"}


@dataclass(frozen=True)
class DiagnoseRequest:
    """One call of `petkin diagnose`.

    Args:
        target: a PET-BIDS study.
        model: tissue model of the simulator, in any case.
        include: effects that the simulator has.
        without: effects taken out of the candidates.
        subjects, sessions: labels; empty for all.
        seg: which segmentation or table of curves.
        out: folder for the results; None: `derivatives/petkin` of the study.
        blood: "recorded" (straight lines between samples, exact at those) or "fitted" (the curves that a fit reads,
            allowed to err as the samples scatter about them).
        checkpoints: of `petkin train`, an ensemble that maps what the law of the tissue lacks; none for no such map.
        seed: of the draws of noise.
        command_line: what was typed.
    """

    target: Path
    model: str = "2TCM"
    include: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    subjects: tuple[str, ...] = ()
    sessions: tuple[str, ...] = ()
    seg: str | None = None
    out: Path | None = None
    blood: str = RECORDED
    checkpoints: tuple[Path, ...] = ()
    seed: int = 0
    command_line: str = ""

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise InputError(f"--seed {self.seed}: give 0 or more.")
        if self.blood not in (RECORDED, FITTED):
            raise InputError(f"--read-blood {self.blood!r}: choose {RECORDED} or {FITTED}.")
        for option, names in (("--include", self.include), ("--without", self.without)):
            for name in names:
                if name not in NAMES:
                    raise InputError(f"{option} {name!r}: there is no such effect; choose one of {', '.join(NAMES)}.")
        both = sorted(set(self.include) & set(self.without))
        if both:
            raise InputError(f"{both[0]} is given to --include and to --without; it is in the simulator or it is not.")
        implied = _IMPLIED.get(self.compartments.label)
        if implied in self.include:
            raise InputError(f"--include {implied}: model {self.compartments.label} has it already; use --model 1tcm.")

        if self.checkpoints:
            self._check_ensemble()

    def _check_ensemble(self) -> None:
        """Raises:
        InputError: a simulator that hybrids do not extend, or too few of them.
        """
        if self.compartments is not ONE_TISSUE:
            raise InputError(
                f"--checkpoint: hybrids are one tissue compartment and what it lacks, the simulator is "
                f"{self.compartments.label}; use --model 1tcm."
            )
        tissue = [effect.name for effect in self.included if effect.stage == "tissue"]
        if tissue:
            raise InputError(
                f"--include {tissue[0]}: beside --checkpoint, whose hybrids find what one tissue compartment lacks, "
                "tissue has nothing else; leave it out."
            )
        if len(self.checkpoints) < FEWEST_MEMBERS:
            raise InputError(
                f"--checkpoint: {len(self.checkpoints)} of at least {FEWEST_MEMBERS}; bands of fewer would hold the "
                "noise of the scan but hardly how trainings differ: give petkin train other values of --seed."
            )

    @property
    def compartments(self) -> CompartmentModel:
        """The tissue model; what vessel walls trap is an effect to include, not a model.

        Raises:
            InputError: no such model.
        """
        plain = [model for model in MODELS if not model.wall]
        for model in plain:
            if model.label.lower() == self.model.lower():
                return model
        labels = ", ".join(m.label for m in plain)
        raise InputError(f"--model {self.model!r}: a simulator needs a compartment model: {labels}.")

    @property
    def included(self) -> tuple[Effect, ...]:
        return tuple(effect_named(name) for name in dict.fromkeys(self.include))
