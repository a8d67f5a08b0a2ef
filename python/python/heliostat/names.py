"""The names that parameters of the package accept, as types for a type checker.

Checks at run time take them from here. `heliostat._core` has its own list of the names of an environment's settings, and a
test compares the two.
"""

from __future__ import annotations

from typing import Literal, TypeAlias

Dynamics: TypeAlias = Literal["static", "closed-loop"]
"""The dynamics of an environment."""

ActionForm: TypeAlias = Literal["angles", "weights"]
"""The form of an action."""

ObservationForm: TypeAlias = Literal["flat", "dict", "belief", "paper"]
"""The form of an observation."""

RewardForm: TypeAlias = Literal["shortfall", "printed"]
"""The form of a reward."""

RenderMode: TypeAlias = Literal["rgb_array", "human"]
"""How an environment is drawn."""

Agents: TypeAlias = Literal["users", "arrays"]
"""What the agents of `heliostat.multiagent` are."""

ArrayTable: TypeAlias = Literal["commands", "telemetry", "decisions"]
"""The tables of a recording that belong to an array."""

Table: TypeAlias = Literal["reports", "channels", "truth", "belief", ArrayTable]
"""The tables of a recording."""

Library: TypeAlias = Literal["pandas", "polars"]
"""The libraries of data frames."""

Quantity: TypeAlias = Literal["los_gain", "irs_gain", "sinr", "rate_mbps", "ber", "blocked"]
"""The quantities of a map, which are those of `heliostat.tables.LinkResult`."""
