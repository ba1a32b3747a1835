"""A line of JSON that is read back and validated."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict

Number = Annotated[
    float, BeforeValidator(lambda value: math.nan if value is None else value)
]
"""A float whose NaN is JSON's null."""


class Row(BaseModel):
    """Frozen, without unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="null")
