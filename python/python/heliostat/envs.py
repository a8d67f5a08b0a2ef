"""The environments of Gymnasium.

| id | state | mirrors | reward |
| --- | --- | --- | --- |
| `heliostat/Static-v0` | true | turn at once | shortfall of minimum rates |
| `heliostat/Hall-v0` | late and noisy reports, hidden obstacles | MEMS dynamics | shortfall of minimum rates |
| `heliostat/Office-v0` | as Hall, in the realistic room | MEMS dynamics | shortfall of minimum rates |
| `heliostat/Paper-v0` | the paper's equations and states | turn at once | as printed in the paper |

Each takes the keywords of `HeliostatEnv`. The reward of a step is sum_k [R_k - penalty_k] over the bandwidth, in
bit/s/Hz. An episode never terminates; Gymnasium truncates it after `max_episode_steps`.
"""

from __future__ import annotations

import copy
import difflib
import inspect
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence, Set
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeAlias, get_args

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from ._checks import integer, one_of, outer_level, real, seed_of, states_of
from ._core import BELIEF_COLUMNS, Batch, Settings, check_exact, closed_loop_conditions, held_out_seed
from .names import ActionForm, Dynamics, ObservationForm, RenderMode, RewardForm
from .rendering import Window, draw
from .scenario import Scenario, Value, load_scenario, override_texts

Observation: TypeAlias = "NDArray[np.float32] | dict[str, NDArray[np.float32] | NDArray[np.int8]]"
"""A flat array, or the parts of it by name."""

SETTLE_S = 20.0
"""Seconds that users walk before the first observation, as in held-out states."""

BOUND = 1e6
"""Bound of the components of an observation, beyond any value of a room: learners expect finite bounds."""

RESET_OPTIONS = frozenset({"held_out", "held_out_set", "episode"})
"""The options of a reset."""

_UNLIMITED = 2**63


def make_settings(
    scenario: Scenario,
    *,
    dynamics: Dynamics = "static",
    action: ActionForm = "angles",
    observation: ObservationForm = "flat",
    reward: RewardForm = "shortfall",
    penalty: float = 1.0,
    margin: float = 1.0,
    step_s: float = 1.0,
    settle_s: float = SETTLE_S,
    oracle: bool = False,
) -> Settings:
    """The settings of an environment; `HeliostatEnv` has their meaning."""
    return Settings(
        scenario,
        dynamics=dynamics,
        action=action,
        observation=observation,
        reward=reward,
        penalty=penalty,
        margin=margin,
        step_s=step_s,
        settle_s=settle_s,
        oracle=oracle,
    )


DEFAULTS: dict[str, Any] = {
    name: parameter.default
    for name, parameter in inspect.signature(make_settings).parameters.items()
    if parameter.default is not parameter.empty
}
"""The keywords of `make_settings` with their defaults."""

SETTINGS = frozenset(DEFAULTS)
"""The keywords of `make_settings`."""

KEYWORDS = SETTINGS | {"scenario", "overrides", "render_mode"}
"""The keywords of `HeliostatEnv`."""


def make_scenario(
    source: str | os.PathLike[str] | Scenario,
    overrides: Mapping[str, Value] | None,
    dynamics: Dynamics,
    settings: Mapping[str, Any],
    accepted: Set[str] = KEYWORDS,
) -> Scenario:
    """The scenario of an environment with these dynamics and further keywords; `accepted` has all of its constructor.

    Raises `TypeError` for an unknown keyword, and `ValueError` for an override that has no effect on a static room, or
    for `step_s`, which has none in a closed loop.
    Warns of the conditions of the scenario, as `heliostat-lab eval` states them. In a static room these are late, noisy or
    lost reports and slow or faulty mirrors, which it does not have, and places out of the range of the mirrors. In a closed
    loop they are the methods of the belief that do not apply, and a mismatch.
    """
    for name in settings:
        if name not in SETTINGS:
            close = difflib.get_close_matches(name, accepted, 1)
            hint = f"; a similar name exists: {close[0]}" if close else ""
            raise TypeError(f'unknown keyword "{name}": expected {", ".join(sorted(accepted))}{hint}')
    if "step_s" in settings and dynamics == "closed-loop":
        raise ValueError(
            f"step_s = {settings['step_s']!r}: no effect in a closed loop, whose step is the time between two position "
            'reports; remove it, and override streams.positions.rate_hz, or choose dynamics="static"'
        )
    scenario = load_scenario(source, overrides)
    for condition in _conditions(dynamics, scenario, overrides):
        warnings.warn(condition, stacklevel=outer_level())
    return scenario


def _conditions(dynamics: str, scenario: Scenario, overrides: Mapping[str, Value] | None) -> list[str]:
    """The conditions of a scenario under these dynamics; `Settings` refuses an unknown name of them."""
    if dynamics == "static":
        return check_exact(scenario, override_texts(overrides or {}))
    return closed_loop_conditions(scenario) if dynamics == "closed-loop" else []


def _episode_of(value: Any) -> tuple[int, int, int]:
    """Index, states and seeds of an episode of a comparison."""
    if not isinstance(value, Sequence) or len(value) != 3:
        raise ValueError(f"episode = {value!r}: expected the index, the number of states and that of seeds")
    states, seeds = states_of(*value[1:])
    return integer("index of the episode", value[0], 0, states * seeds - 1), states, seeds


def identity(form: str, scenario: Scenario, settings: Mapping[str, Any]) -> dict[str, Any]:
    """What must be equal where a state is restored; `form` is "environment" or "batch"."""
    return {"form": form, "hash of the scenario": scenario.hash, **settings}


def check_identity(state: Any, expected: Mapping[str, Any]) -> None:
    """Refuses what is no state, and the state of another environment."""
    if not isinstance(state, EnvState):
        raise TypeError(f"expected a state that clone_state has returned, found {type(state).__name__}")
    differing = [name for name, value in expected.items() if state.settings.get(name) != value]
    if differing:
        reasons = ", ".join(f"{name} = {state.settings.get(name)!r} and not {expected[name]!r}" for name in differing)
        raise ValueError(f"the state is of another environment: {reasons}; expected the same scenario and settings")


class Layout:
    """The spaces of a batch, and the parts of a flat observation."""

    def __init__(self, batch: Batch, observation: str) -> None:
        self.parts = [(name, start, tuple(shape)) for name, start, shape in batch.layout()]
        self.is_dict = observation == "dict"
        self.action_space = spaces.Box(-1.0, 1.0, (batch.action_len,), np.float32)
        self.observation_space: spaces.Space[Any]
        if self.is_dict:
            self.observation_space = spaces.Dict(
                {
                    name: spaces.MultiBinary(shape)
                    if name == "mask"
                    else spaces.Box(-BOUND, BOUND, shape, np.float32)
                    for name, _, shape in self.parts
                }
            )
        else:
            self.observation_space = spaces.Box(-BOUND, BOUND, (batch.observation_len,), np.float32)

    def shown(self, flat: NDArray[np.float32]) -> Observation:
        """The observation of a flat array of shape (..., n); the parts are views, the mask excepted."""
        if not self.is_dict:
            return flat
        lead = flat.shape[:-1]
        parts: dict[str, NDArray[np.float32] | NDArray[np.int8]] = {}
        for name, start, shape in self.parts:
            part = flat[..., start : start + int(np.prod(shape))].reshape(lead + shape)
            parts[name] = part.astype(np.int8) if name == "mask" else part
        return parts


@dataclass(frozen=True)
class EnvState:
    """The state of an environment or of a batch, as `clone_state` returns it.

    It can be kept, pickled and restored as often as needed. It holds the room, the controller's belief, the mirrors and
    the random generators; not the settings of wrappers, such as the number of steps that `TimeLimit` has counted.
    """

    batch: Batch
    """The rooms; no part of the interface."""
    generator: Mapping[str, Any]
    flags: dict[str, Any]
    settings: Mapping[str, Any]


class HeliostatEnv(gymnasium.Env[Any, NDArray[np.float32]]):
    """A room with a mirror array, in steps of a learner.

    Args:
        scenario: a built-in name, the path of a TOML file, or a `Scenario`; default "specular".
        overrides: keys of the scenario as "users.count", with their values; default: none. A static room refuses those
            of reports, belief and moving mirrors, which have no effect on it.
        dynamics: "static" (true state, instant mirrors), the default, or "closed-loop" (reports, belief, mirror
            dynamics). A step of a closed loop is the time between two position reports.
        action: "angles" (roll of each mirror, then yaw of each, over the range of an axis), the default, or "weights"
            (one for each slot; the decoder computes the angles). All components are in [-1, 1].
        observation: "flat" (the vector that the controller gives to an actor), the default, "dict" (its parts by name,
            with the mask of the slots), "belief" (the rows of all slots one after another, with the columns
            `heliostat.BELIEF_COLUMNS`) or "paper".
        reward: "shortfall" (a rate below the minimum is penalised), the default, or "printed" (as in the paper).
        penalty: weight of the penalty, without unit, from 0; default 1.
        margin: factor on the minimum rates in the penalty, without unit, from 0; default 1.
        step_s: time in s between two actions of a static room, above 0; default 1. A closed loop refuses it.
        settle_s: time in s that users walk before the first observation, from 0; default `SETTLE_S`, 20.
        oracle: whether `info` has the oracle's rate, which takes far longer than the step; default false.
        render_mode: "rgb_array" or "human", which needs pygame; default: no pictures.

    It warns of the conditions of the scenario under its dynamics, as `heliostat-lab eval` states them.

    `info` has `sum_rate_mbps`, `rates_mbps` (one for each user present), `qos_met` (share of users whose minimum rate
    is met), and `oracle_mbps` with `oracle=True`.
    """

    metadata: dict[str, Any] = {"render_modes": list(get_args(RenderMode)), "render_fps": 10}

    def __init__(
        self,
        scenario: str | os.PathLike[str] | Scenario = "specular",
        *,
        overrides: Mapping[str, Value] | None = None,
        render_mode: RenderMode | None = None,
        observation: ObservationForm = "flat",
        action: ActionForm = "angles",
        dynamics: Dynamics = "static",
        reward: RewardForm = "shortfall",
        **settings: Any,
    ) -> None:
        if render_mode is not None:
            one_of("render_mode", render_mode, RenderMode)
        self.scenario = make_scenario(scenario, overrides, dynamics, settings)
        self.action_form, self.observation_form = action, observation
        self._settings: dict[str, Any] = {
            **DEFAULTS,
            "action": action,
            "observation": observation,
            "dynamics": dynamics,
            "reward": reward,
            **settings,
        }
        checked = make_settings(self.scenario, **self._settings)
        self._oracle = bool(self._settings["oracle"])
        self._batch = Batch(checked, [self.scenario.seed], "disabled", _UNLIMITED)
        self._layout = Layout(self._batch, observation)
        self.action_space = self._layout.action_space
        self.observation_space = self._layout.observation_space
        self.render_mode = render_mode
        self._window: Window | None = None
        self._is_reset = False
        self._in_episode = False
        self._actions_shape = self._layout.action_space.shape

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Starts an episode in the room of this seed, or of the next one.

        `options={"held_out": index}` starts in a held-out room, which training never uses; "held_out_set" is the
        seed of the comparison, that of the scenario if absent. `options={"episode": (index, states, seeds)}` starts an
        episode of a comparison with that many states of each of that many seeds; in a static room it is one state. Its
        last step is truncated. The `info["samples"]` of this step has a row for each sampling time: sum rate in Mbit/s,
        share of minimum rates met, Jain's fairness index (NaN where no user has a rate), mean rate in Mbit/s of the users
        without a direct path (NaN without such a user), and mean bit error rate.
        """
        if seed is not None:
            seed = seed_of(seed)
        super().reset(seed=seed)
        room_seed = seed
        if options is not None and not isinstance(options, Mapping):
            raise TypeError(f'options: expected a mapping such as {{"held_out": 0}}, found {type(options).__name__}')
        unknown = set(options or ()) - RESET_OPTIONS
        if unknown:
            raise ValueError(f"unknown reset options {sorted(unknown)}: expected held_out, held_out_set, episode")
        if options and "held_out" in options:
            room_seed = held_out_seed(
                seed_of(options.get("held_out_set", self.scenario.seed), "held_out_set"),
                seed_of(options["held_out"], "held_out"),
            )
        elif seed is None and not self._is_reset:
            room_seed = int(self.np_random.integers(2**63))
        seen = np.empty((1, self._batch.observation_len), np.float32)
        in_episode = bool(options) and "episode" in (options or {})
        if options and in_episode:
            seen[0] = self._batch.begin_episode(*_episode_of(options["episode"]))
        else:
            self._batch.reset([room_seed], seen)
        # A refused reset leaves the environment in the episode in which it was.
        self._is_reset, self._in_episode = True, in_episode
        if self.render_mode == "human":
            self.render()
        return self._layout.shown(seen[0]), {}

    def step(self, action: NDArray[np.float32]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Performs an action; raises `ValueError` for another shape or a component that is not finite."""
        if not self._is_reset:
            raise gymnasium.error.ResetNeeded("call reset before the first step")
        checked = np.ascontiguousarray(real("action", action), np.float32)
        if checked.shape != self._actions_shape:
            raise ValueError(f"an action of shape {checked.shape}, expected {self._actions_shape}")
        seen, reward, _, (sum_rate, met, oracle), rates = self._batch.step_one(checked)
        info = {"sum_rate_mbps": sum_rate, "qos_met": met, "rates_mbps": rates}
        if self._oracle:
            info["oracle_mbps"] = oracle
        is_over = False
        if self._in_episode:
            is_over, samples = self._batch.samples()
            if is_over:
                info["samples"] = samples
        if self.render_mode == "human":
            self.render()
        return self._layout.shown(seen), reward, False, is_over, info

    def render(self) -> Any:
        """The floor from above, (400, n, 3) in uint8; with "human" it is also shown in a window."""
        if self.render_mode is None:
            gymnasium.logger.warn('render has no effect: make the environment with render_mode="rgb_array"')
            return None
        picture = draw(self.scenario, self._batch.state(0))
        if self.render_mode == "rgb_array":
            return picture
        if self._window is None:
            self._window = Window(picture.shape, int(self.metadata["render_fps"]))
        self._window.show(picture)
        return None

    def clone_state(self) -> EnvState:
        """The present state, for `restore_state` of this environment or of another one with the same settings."""
        return EnvState(
            copy.copy(self._batch),
            self.np_random.bit_generator.state,
            {"is_reset": self._is_reset, "in_episode": self._in_episode},
            identity("environment", self.scenario, self._settings),
        )

    def restore_state(self, state: EnvState) -> None:
        """Continues from a state: the same actions give the same observations and rewards as after `clone_state`.

        Raises `ValueError` for a state of an environment with other settings.
        """
        check_identity(state, identity("environment", self.scenario, self._settings))
        batch, self._batch = self._batch, copy.copy(state.batch)
        batch.close()
        self.np_random.bit_generator.state = state.generator
        self._is_reset, self._in_episode = state.flags["is_reset"], state.flags["in_episode"]

    def __copy__(self) -> HeliostatEnv:
        """A copy has a room of its own, as `copy.deepcopy`: two environments cannot share one room."""
        return copy.deepcopy(self)

    def __getstate__(self) -> dict[str, Any]:
        # A window stays with the process that opened it.
        return {**self.__dict__, "_window": None}

    def state(self) -> dict[str, Any]:
        """The true state of the room: positions, blockers, headings, angles, and the rates that these angles give there.

        No part of the observation. The users of a static room walk behind the action of a step: `info` of the step has the
        rates before, and the state those after.
        """
        return dict(self._batch.state(0))

    @property
    def is_static(self) -> bool:
        """Whether the learner observes the true state, and the mirrors turn at once."""
        return bool(self._settings["dynamics"] == "static")

    @property
    def conditions(self) -> tuple[str, ...]:
        """The conditions of the scenario, as `heliostat-lab eval` states them; those of policies excepted."""
        return tuple(_conditions(self._settings["dynamics"], self.scenario, None))

    @contextmanager
    def with_other_rooms(self) -> Iterator[None]:
        """Within the context, the environment has other rooms, whose steps do not evaluate the oracle."""
        kept = self._batch, self._oracle, self._is_reset, self._in_episode
        settings = {**self._settings, "oracle": False}
        self._batch = Batch(make_settings(self.scenario, **settings), [self.scenario.seed], "disabled", _UNLIMITED)
        self._oracle = False
        try:
            yield
        finally:
            self._batch.close()
            self._batch, self._oracle, self._is_reset, self._in_episode = kept

    @property
    def slots(self) -> int:
        """Slots for users in an observation."""
        return self._batch.slots_max

    @property
    def users_max(self) -> int:
        """Most users who are in the room at once."""
        return self._batch.users_max

    @property
    def parts(self) -> dict[str, tuple[slice, tuple[int, ...]]]:
        """The indices and the shape of each part of a flat observation, or of each column of a belief, by name.

        Raises `ValueError` for the observation "paper", which has no parts.
        """
        if self.observation_form == "paper":
            raise ValueError('parts: the observation "paper" has none, expected "flat", "dict" or "belief"')
        if self.observation_form == "belief":
            columns, length = len(BELIEF_COLUMNS), self._batch.observation_len
            return {name: (slice(index, length, columns), (self.slots,)) for index, name in enumerate(BELIEF_COLUMNS)}
        return {name: (slice(first, first + int(np.prod(shape))), shape) for name, first, shape in self._layout.parts}

    def close(self) -> None:
        """Frees the room; later steps raise `RuntimeError`."""
        self._batch.close()
        if self._window is not None:
            self._window.close()
            self._window = None


_STATIC = {"scenario": "specular", "dynamics": "static"}
_HALL = {"scenario": "hall", "dynamics": "closed-loop"}
_OFFICE = {"scenario": "office", "dynamics": "closed-loop"}
_PAPER = {"scenario": "paper", "dynamics": "static", "observation": "paper", "reward": "printed"}

IDS: dict[str, tuple[dict[str, str], int]] = {
    "heliostat/Static-v0": (_STATIC, 40),
    "heliostat/Hall-v0": (_HALL, 600),
    "heliostat/Office-v0": (_OFFICE, 600),
    "heliostat/Paper-v0": (_PAPER, 40),
}
"""The ids with their keywords and the number of steps of an episode."""

for _id, (_keywords, _steps) in IDS.items():
    if _id not in gymnasium.registry:
        gymnasium.register(
            _id,
            entry_point="heliostat.envs:HeliostatEnv",
            vector_entry_point="heliostat.vector:HeliostatVectorEnv",
            max_episode_steps=_steps,
            kwargs=dict(_keywords),
        )
