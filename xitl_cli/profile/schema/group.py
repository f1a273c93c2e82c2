"""What every group of a profile shares: unknown keys refused, frozen, no silent conversions, finite numbers."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field


class Group(BaseModel):
    """A group of keys. Key names are those of the constructors the values go to."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Direction = Annotated[float, Field(ge=-360, le=360)]
RateHz = Annotated[float, Field(gt=0, le=100_000)]
Vector = tuple[float, float, float]
"""Three numbers along the axes the key's name says (ned or frd)."""
