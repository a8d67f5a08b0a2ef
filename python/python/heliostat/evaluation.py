"""Scores on held-out states: the same rooms, users and oracle as `heliostat eval`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .envs import HeliostatEnv


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


def evaluate(
    act: Callable[[Any], NDArray[np.float32]], env: HeliostatEnv | Any, states: int = 100, seeds: int = 1
) -> Score:
    """The score of `act`, from an observation to an action, in a static room without a step between.

    The states are those of `heliostat eval --states STATES --seeds SEEDS` for the scenario of `env`; any wrappers of
    Gymnasium that change observations or actions apply. Needs a static room; its settings other than scenario,
    action and observation do not matter.
    """
    inner = env.unwrapped
    if not isinstance(inner, HeliostatEnv):
        raise TypeError(f"expected an environment of heliostat, found {type(inner).__name__}")
    if not inner.is_static:
        raise ValueError('evaluate needs dynamics="static"; run `heliostat eval --closed-loop` for a closed loop')
    if states < 1 or seeds < 1:
        raise ValueError("evaluate needs at least one state and one seed")
    rows = []
    with inner.with_oracle():
        for seed in range(seeds):
            for index in range(states):
                observation, _ = env.reset(options={"held_out": index, "held_out_set": inner.scenario.seed + seed})
                _, _, _, _, info = env.step(act(observation))
                rows.append((info["sum_rate_mbps"], info["oracle_mbps"], info["qos_met"]))
    rate, oracle, met = np.array(rows).T
    served = oracle > 0.0
    return Score(
        ratio_to_oracle=float((rate[served] / oracle[served]).mean()),
        sum_rate_mbps=float(rate.mean()),
        oracle_mbps=float(oracle.mean()),
        qos_met=float(met.mean()),
        states=len(rows),
    )
