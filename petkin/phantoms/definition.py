"""What a phantom file holds: regions as ellipses or ellipsoids, painted one over the other."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Vector = Annotated[tuple[float, ...], Field(min_length=1, max_length=3)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Folds(_Strict):
    """Ripples of a surface, as gyri: its radius is 1 + depth cos(around phi) cos(along theta) of the ellipsoid's."""

    depth: Annotated[float, Field(ge=0, lt=0.5)]
    around: Annotated[int, Field(ge=1)]
    along: Annotated[int, Field(ge=0)] = 0


class HalfSpace(_Strict):
    """Keeps the points with normal . x > above (same coordinates as the shape's centre)."""

    normal: Vector
    above: float


class Shape(_Strict):
    """An ellipse or ellipsoid, perhaps turned, folded and cut.

    `angles` are degrees: one in 2-D, three in 3-D, about x, then y, then z.
    """

    centre: Vector
    radii: Annotated[tuple[Annotated[float, Field(gt=0)], ...], Field(min_length=1, max_length=3)]
    angles: tuple[float, ...] = ()
    folds: Folds | None = None
    keep: tuple[HalfSpace, ...] = ()


class Region(_Strict):
    """A labelled region. Index 0 takes away what was painted before; `tissue` names its kinetics in a population."""

    index: Annotated[int, Field(ge=0, le=32767)]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    tissue: str = ""
    shapes: Annotated[tuple[Shape, ...], Field(min_length=1)]


class Phantom(_Strict):
    """A phantom, independent of any grid.

    Attributes:
        coordinates: "mm" about the centre of the field of view, or "canvas": -1 to 1 across it.
        field_of_view: mm; two values make a single slice.
        voxel_size: mm, where none is asked for.
        region: in painting order.
    """

    name: str
    title: str
    coordinates: Literal["canvas", "mm"]
    field_of_view: Annotated[tuple[Annotated[float, Field(gt=0)], ...], Field(min_length=2, max_length=3)]
    voxel_size: Annotated[float, Field(gt=0)]
    region: Annotated[tuple[Region, ...], Field(min_length=1)]

    @property
    def dimensions(self) -> int:
        return len(self.field_of_view)

    @property
    def regions(self) -> tuple[Region, ...]:
        """Regions that hold tissue, by index."""
        return tuple(sorted((r for r in self.region if r.index > 0), key=lambda r: r.index))

    @model_validator(mode="after")
    def _agree(self) -> Phantom:
        for labels in ([str(r.index) for r in self.regions], [r.name for r in self.region]):
            twice = sorted({label for label in labels if labels.count(label) > 1})
            if twice:
                raise ValueError(f"{twice[0]} stands for two regions")
        if not self.regions:
            raise ValueError("no region has an index above 0")
        for region in self.region:
            if region.index and not region.tissue:
                raise ValueError(f"region {region.name!r} names no tissue")
            for shape in region.shapes:
                self._check_shape(region.name, shape)
        return self

    def _check_shape(self, name: str, shape: Shape) -> None:
        vectors = (shape.centre, shape.radii, *(half.normal for half in shape.keep))
        if any(len(v) != self.dimensions for v in vectors):
            raise ValueError(f"region {name!r}: a shape needs {self.dimensions} numbers for centre, radii and normals")
        due = 1 if self.dimensions == 2 else 3
        if len(shape.angles) not in (0, due):
            raise ValueError(f"region {name!r}: {due} angle(s) are due here, {len(shape.angles)} given")
