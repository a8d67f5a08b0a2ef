"""The environments for several learners: a parallel environment of PettingZoo. It needs the extra `pettingzoo`.

    from heliostat.multiagent import parallel_env

    env = parallel_env("users", scenario="hall", dynamics="closed-loop")
    observations, infos = env.reset(seed=1)
    actions = {agent: env.action_space(agent).sample() for agent in env.agents}
    observations, rewards, terminations, truncations, infos = env.step(actions)

The agents are cooperative: each gets the reward of the room. It is the environment of `HeliostatEnv`, whose action the
agents choose in parts:

| agents | an agent | its action | its observation |
| --- | --- | --- | --- |
| `users` | a slot that a user can have | the weight of this user | its row of `heliostat.BELIEF_COLUMNS`, then those of the others |
| `arrays` | a mirror array | roll, then yaw of its mirrors | the users, and steering and angles of its mirrors |
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from ._checks import integer, one_of
from ._core import BELIEF_COLUMNS
from .envs import BOUND, RESET_OPTIONS, HeliostatEnv
from .names import ActionForm, Agents, ObservationForm

try:
    from pettingzoo import ParallelEnv
except ImportError as problem:
    raise ImportError('the package pettingzoo is missing: pip install "heliostat[pettingzoo]"') from problem

_Array = NDArray[np.float32]
_STEPS_MAX = 2**63 - 1
_OF_USERS = ("mask", "positions", "los_amplitude", "min_rate", "summary")


def parallel_env(agents: Agents = "users", max_steps: int = 600, **settings: Any) -> HeliostatParallelEnv:
    """An environment whose agents are "users" or "arrays", and whose episodes end after `max_steps` steps.

    `settings` are those of `HeliostatEnv` but `action` and `observation`. Raises `ValueError` for other agents.
    """
    return HeliostatParallelEnv(agents, max_steps, **settings)


class HeliostatParallelEnv(ParallelEnv):  # type: ignore[misc]
    """A room as a parallel environment; `parallel_env` has its arguments.

    All agents act in each step, and all are truncated together. The observation of an empty slot is 0 in its own row,
    and its action has no effect. `info` of each agent has the figures of `HeliostatEnv`. `state` is for critics that
    read all users and mirrors during the training.
    """

    metadata: dict[str, Any] = {"name": "heliostat_v0", "render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, agents: Agents = "users", max_steps: int = 600, **settings: Any) -> None:
        taken = {"action", "observation"} & settings.keys()
        if taken:
            raise ValueError(f"{', '.join(sorted(taken))}: the agents choose them, expected other settings")
        one_of("agents", agents, Agents)
        self._max_steps = integer("max_steps", max_steps, 1, _STEPS_MAX)
        forms: dict[Agents, tuple[ActionForm, ObservationForm]] = {
            "users": ("weights", "belief"),
            "arrays": ("angles", "flat"),
        }
        action, observation = forms[agents]
        self.env = HeliostatEnv(action=action, observation=observation, **settings)
        self.render_mode = self.env.render_mode
        self._parts = _Users(self.env) if agents == "users" else _Arrays(self.env)
        self.possible_agents = list(self._parts.names)
        self.agents: list[str] = []
        self.state_space = self.env.observation_space
        self._state: _Array | None = None
        self._steps = 0

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """The space of the observations of an agent."""
        return self._parts.observations[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """The space of the actions of an agent."""
        return self._parts.actions[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, _Array], dict[str, dict[str, Any]]]:
        """Starts an episode, as `HeliostatEnv.reset` does. PettingZoo requires that unknown options are ignored."""
        known = {name: value for name, value in (options or {}).items() if name in RESET_OPTIONS}
        seen, info = self.env.reset(seed=seed, options=known)
        self._state = seen
        self.agents, self._steps = list(self.possible_agents), 0
        return self._parts.seen(seen), {agent: dict(info) for agent in self.agents}

    def step(
        self, actions: dict[str, _Array]
    ) -> tuple[dict[str, _Array], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Performs the actions of all agents; raises `ValueError` where one is missing or has another shape."""
        if not self.agents:
            raise ValueError("the episode has ended: expected reset before the next step")
        missing = [agent for agent in self.agents if agent not in actions]
        if missing:
            raise ValueError(f"no action of {', '.join(missing)}: expected one of each agent")
        for agent in self.agents:
            shape = self._parts.actions[agent].shape
            if np.shape(actions[agent]) != shape:
                raise ValueError(f"an action of {agent} of shape {np.shape(actions[agent])}, expected {shape}")
        seen, reward, _, is_over, info = self.env.step(self._parts.joined(actions))
        self._state = seen
        self._steps += 1
        is_over = is_over or self._steps >= self._max_steps
        agents = self.agents
        if is_over:
            self.agents = []
        return (
            self._parts.seen(seen),
            dict.fromkeys(agents, float(reward)),
            dict.fromkeys(agents, False),
            dict.fromkeys(agents, is_over),
            {agent: dict(info) for agent in agents},
        )

    def state(self) -> _Array:
        """What all agents observe, in `state_space`: the observation of `HeliostatEnv`.

        Raises `gymnasium.error.ResetNeeded` before the first reset.
        """
        if self._state is None:
            raise ResetNeeded("call reset before the first state")
        return self._state.copy()

    def render(self) -> Any:
        """The floor from above, as `HeliostatEnv.render` draws it."""
        return self.env.render()

    def close(self) -> None:
        """Frees the room."""
        self.env.close()


class _Users:
    """The weights and the belief rows of the slots that a user can have; users have the first slots."""

    def __init__(self, env: HeliostatEnv) -> None:
        count, columns = min(env.slots, env.users_max), len(BELIEF_COLUMNS)
        self.names = [f"user_{slot}" for slot in range(count)]
        self.observations = {name: spaces.Box(-BOUND, BOUND, (count * columns,), np.float32) for name in self.names}
        self.actions = {name: spaces.Box(-1.0, 1.0, (1,), np.float32) for name in self.names}
        self._orders = [[slot, *(other for other in range(count) if other != slot)] for slot in range(count)]
        self._slots, self._columns = env.slots, columns

    def seen(self, observation: _Array) -> dict[str, _Array]:
        """The observation of each agent: its own row first."""
        rows = np.reshape(observation, (self._slots, self._columns))
        return {name: rows[order].reshape(-1) for name, order in zip(self.names, self._orders, strict=True)}

    def joined(self, actions: dict[str, _Array]) -> _Array:
        """The action of the room."""
        weights = np.zeros(self._slots, np.float32)
        weights[: len(self.names)] = [float(actions[name][0]) for name in self.names]
        return weights


class _Arrays:
    """The angles and the steering amplitudes of the mirrors of each array."""

    def __init__(self, env: HeliostatEnv) -> None:
        counts = [table["rows"] * table["columns"] for table in _mirror_tables(env)]
        ends = np.cumsum(counts)
        self._mirrors = [slice(int(end) - count, int(end)) for end, count in zip(ends, counts, strict=True)]
        self.names = [f"array_{index}" for index in range(len(counts))]
        self._parts = env.parts
        empty = np.zeros(sum(int(np.prod(shape)) for _, shape in env.parts.values()), np.float32)
        self.observations = {
            name: spaces.Box(-BOUND, BOUND, seen.shape, np.float32) for name, seen in self.seen(empty).items()
        }
        self.actions = {
            name: spaces.Box(-1.0, 1.0, (2 * count,), np.float32) for name, count in zip(self.names, counts, strict=True)
        }

    def _part(self, observation: _Array, name: str) -> _Array:
        indices, shape = self._parts[name]
        part: _Array = observation[indices].reshape(shape)
        return part

    def seen(self, observation: _Array) -> dict[str, _Array]:
        """The observation of each agent: the users, and its own mirrors."""
        users = [self._part(observation, name).reshape(-1) for name in _OF_USERS]
        steering, angles = self._part(observation, "steering_amplitude"), self._part(observation, "angles")
        return {
            name: np.concatenate([*users, steering[:, own].reshape(-1), angles.reshape(2, -1)[:, own].reshape(-1)])
            for name, own in zip(self.names, self._mirrors, strict=True)
        }

    def joined(self, actions: dict[str, _Array]) -> _Array:
        """The action of the room: roll of all mirrors, then yaw of all."""
        halves = [np.reshape(np.asarray(actions[name], np.float32), (2, -1)) for name in self.names]
        return np.concatenate(halves, axis=1).reshape(-1)


def _mirror_tables(env: HeliostatEnv) -> list[dict[str, Any]]:
    """The arrays of a scenario, in their order."""
    mirrors = env.scenario.tables()["mirrors"]
    return list(mirrors) if isinstance(mirrors, list) else [mirrors]
