"""Scores on held-out rooms: the same rooms, users and oracle as `heliostat-lab eval`."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from numpy.typing import ArrayLike

from ._checks import function_of_observation, integer, states_of
from ._core import INSTANTS, half_width, score
from .envs import HeliostatEnv

_EPISODES_FEW = 10
_EPISODES_MAX = 50_000
_STATES = 100

Act: TypeAlias = Callable[[Any], ArrayLike]
"""From an observation to an action: an array of any real type, or a list."""


@dataclass(frozen=True)
class Score:
    """Means over held-out states, with the statistics of `heliostat-lab eval`.

    `NAME_ci95` is half the width of the 95 % interval of a mean by Student's t over independent episodes; NaN for a
    single one.
    """

    ratio_to_oracle: float
    """Sum rate over that of the oracle with minimum rates, state by state."""
    ratio_to_oracle_ci95: float
    sum_rate_mbps: float
    sum_rate_mbps_ci95: float
    oracle_mbps: float
    oracle_mbps_ci95: float
    qos_met: float
    """Share of users whose minimum rate is met."""
    qos_met_ci95: float
    jain: float | None
    """Jain's fairness index of the rates, over the states in which a user has one; `None` where there is none."""
    jain_ci95: float | None
    """`None` also for a single episode with such a state."""
    ber: float
    """Mean bit error rate of the users with on-off keying."""
    ber_ci95: float
    blocked_rate_mbps: float | None
    """Mean rate of a user without a direct path, over the states with such a user; `None` where there is none."""
    blocked_rate_mbps_ci95: float | None
    """`None` also for a single episode with such a user."""
    outage_time: float | None
    """Closed loop: share of the users' time below the minimum rate, at the sampling times. `None` in a static room."""
    outage_time_ci95: float | None
    states: int
    """Number of states of all seeds."""
    episodes: int
    """Independent episodes; in a static room each state is one. Below 10, the intervals say little."""
    crossing: tuple[str, ...]
    """The figures whose interval reaches beyond what they can be, such as an outage time below 0: use more episodes."""
    conditions: tuple[str, ...]
    """The conditions of the scenario, as `heliostat-lab eval` states them; those of policies excepted."""
    each: Mapping[str, tuple[float | None, ...]] = field(repr=False, hash=False)
    """By the name of a figure its mean in each episode, `None` where it is missing there, and as `states` their numbers
    of states. Episode i of two scores with the same scenario, dynamics, states and seeds has the same room."""

    def minus(self, other: Score, figure: str = "ratio_to_oracle") -> tuple[float, float]:
        """The mean difference of a figure to another score, and half the width of its 95 % interval; NaN for one episode.

        The difference is paired by episode, so it does not contain how much the rooms differ. Episodes count by their
        states, and those in which a score misses the figure are left out.

        Raises `ValueError` for a figure that a score does not have, and for scores of different rooms.
        """
        for one in (self, other):
            if figure == "states" or figure not in one.each:
                names = ", ".join(sorted(set(one.each) - {"states"}))
                raise ValueError(f"figure = {figure!r}: expected one of {names}")
        if any(self.each[name] != other.each[name] for name in ("states", "oracle_mbps")):
            raise ValueError("the scores have different rooms: expected the same scenario, dynamics, states and seeds")
        triples = zip(self.each[figure], other.each[figure], self.each["states"], strict=True)
        pairs = [(own - of, states or 0.0) for own, of, states in triples if own is not None and of is not None]
        if not pairs:
            return math.nan, math.nan
        mean = sum(value * states for value, states in pairs) / sum(states for _, states in pairs)
        return mean, half_width([value for value, _ in pairs])


def evaluate(
    act: Act, env: HeliostatEnv | Any, states: int | None = None, seeds: int = 1, *, episodes: int | None = None
) -> Score:
    """The score of `act`, from an observation to an action.

    `states` is their number for each seed, 100 where neither it nor `episodes` is given. `episodes` is the number of
    episodes for each seed in place of it, as for `heliostat-lab eval --episodes`. The states are those of
    `heliostat-lab eval --states STATES --seeds SEEDS` for the scenario of `env`: in a static room one by one, without a
    step between; in a closed loop those of `heliostat-lab eval --closed-loop`, at sampling times between which `act`
    decides for each position report. Any wrappers of Gymnasium that change observations or actions apply. Settings of
    `env` other than scenario, dynamics, action and observation do not matter.

    A function `act.reset` without arguments is called where an episode begins, which is each state of a static room. A
    name `act.action`, as for `heliostat-lab eval --policies FILE.py:FUNCTION`, must be the form of the actions of `env`.
    """
    function_of_observation("act", act)
    inner = getattr(env, "unwrapped", env)
    if not isinstance(inner, HeliostatEnv):
        raise TypeError(f"expected an environment of heliostat, found {type(inner).__name__}")
    form = getattr(act, "action", inner.action_form)
    if isinstance(form, str) and form != inner.action_form:
        raise ValueError(
            f'act.action = "{form}", and the actions of the environment are {inner.action_form}: '
            f'expected an environment with action="{form}"'
        )
    if episodes is not None:
        if states is not None:
            raise ValueError(f"states = {states!r} and episodes = {episodes!r}: expected one of them")
        states = integer("episodes", episodes, 1, _EPISODES_MAX) * (1 if inner.is_static else INSTANTS)
    states, seeds = states_of(_STATES if states is None else states, seeds)
    with inner.with_other_rooms():
        groups = _samples(act, env, inner, states, seeds)
        found = score(inner.scenario, not inner.is_static, states, seeds, groups)
    figures: dict[str, Any] = {"outage_time": None, "outage_time_ci95": None}
    crossing: list[str] = []
    each: dict[str, tuple[float | None, ...]] = {"states": tuple(len(group) for group in groups)}
    for name, (mean, ci95, crosses), of_episodes in found:
        figures |= {name: mean, f"{name}_ci95": ci95}
        each[name] = tuple(None if math.isnan(value) else value for value in of_episodes)
        if crosses:
            crossing.append(name)
    for name in ("blocked_rate_mbps", "jain"):
        for part in (name, f"{name}_ci95"):
            figures[part] = None if math.isnan(figures[part]) else figures[part]
    if len(groups) < _EPISODES_FEW:
        count = "1 episode" if len(groups) == 1 else f"{len(groups)} episodes"
        warnings.warn(
            f"the intervals come from {count}; use at least {_EPISODES_FEW}: episodes, states or seeds larger",
            stacklevel=2,
        )
    return Score(
        **figures,
        states=sum(len(group) for group in groups),
        episodes=len(groups),
        crossing=tuple(crossing),
        conditions=inner.conditions,
        each=each,
    )


def _begin_episode(act: Act) -> None:
    """Lets a function with a state forget what it has seen."""
    reset = getattr(act, "reset", None)
    if callable(reset):
        reset()


def _samples(act: Act, env: Any, inner: HeliostatEnv, states: int, seeds: int) -> list[Any]:
    """The samples of each episode, as `info["samples"]`; in a static room an episode is one state."""
    of_seed = states if inner.is_static else -(-states // INSTANTS)
    samples = []
    for index in range(seeds * of_seed):
        _begin_episode(act)
        observation, info = env.reset(options={"episode": (index, states, seeds)})
        while "samples" not in info:
            observation, _, _, _, info = env.step(act(observation))
        samples.append(info["samples"])
    return samples
