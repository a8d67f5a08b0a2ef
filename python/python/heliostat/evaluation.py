"""Scores on held-out rooms: the same rooms, users and oracle as `heliostat-lab eval`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ._checks import states_of
from ._core import INSTANTS, oracle_samples
from .envs import HeliostatEnv

Act: TypeAlias = Callable[[Any], NDArray[np.float32]]
"""From an observation to an action."""


@dataclass(frozen=True)
class Score:
    """Means over held-out states."""

    ratio_to_oracle: float
    """Sum rate over that of the oracle with minimum rates, state by state."""
    sum_rate_mbps: float
    oracle_mbps: float
    qos_met: float
    """Share of users whose minimum rate is met."""
    states: int


def evaluate(act: Act, env: HeliostatEnv | Any, states: int = 100, seeds: int = 1) -> Score:
    """The score of `act`, from an observation to an action.

    The states are those of `heliostat-lab eval --states STATES --seeds SEEDS` for the scenario of `env`: in a static room
    one by one, without a step between; in a closed loop those of `heliostat-lab eval --closed-loop`, at sampling times
    between which `act` decides for each position report. Any wrappers of Gymnasium that change observations or
    actions apply. Settings of `env` other than scenario, dynamics, action and observation do not matter.
    """
    inner = getattr(env, "unwrapped", env)
    if not isinstance(inner, HeliostatEnv):
        raise TypeError(f"expected an environment of heliostat, found {type(inner).__name__}")
    states, seeds = states_of(states, seeds)
    with inner.with_other_rooms(oracle=inner.is_static):
        samples = _static if inner.is_static else _closed_loop
        rate, met, oracle = samples(act, env, inner, states, seeds).T
    served = oracle > 0.0
    return Score(
        ratio_to_oracle=float((rate[served] / oracle[served]).mean()),
        sum_rate_mbps=float(rate.mean()),
        oracle_mbps=float(oracle.mean()),
        qos_met=float(np.nanmean(met)),
        states=len(rate),
    )


def _static(act: Act, env: Any, inner: HeliostatEnv, states: int, seeds: int) -> NDArray[np.float64]:
    """Sum rate, share of minimum rates met and the oracle's sum rate of each state, (n, 3)."""
    rows = []
    for seed in range(seeds):
        for index in range(states):
            observation, _ = env.reset(options={"held_out": index, "held_out_set": inner.scenario.seed + seed})
            info = env.step(act(observation))[4]
            rows.append((info["sum_rate_mbps"], info["qos_met"], info["oracle_mbps"]))
    return np.array(rows)


def _closed_loop(act: Act, env: Any, inner: HeliostatEnv, states: int, seeds: int) -> NDArray[np.float64]:
    """The same at the sampling times of each episode."""
    samples = []
    for index in range(seeds * -(-states // INSTANTS)):
        observation, info = env.reset(options={"episode": (index, states, seeds)})
        while "samples" not in info:
            observation, _, _, _, info = env.step(act(observation))
        samples.append(info["samples"])
    oracle = oracle_samples(inner.scenario, states, seeds)
    return np.column_stack([np.concatenate(samples), oracle[:, 0]])
