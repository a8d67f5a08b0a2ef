"""A batch of environments that steps on all cores, in buffers that are allocated once."""

from __future__ import annotations

import copy as copying
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from ._checks import integer, real, seed_of
from ._core import Batch
from .envs import (
    _UNLIMITED,
    DEFAULTS,
    KEYWORDS,
    EnvState,
    Layout,
    check_identity,
    identity,
    make_scenario,
    make_settings,
)
from .names import ActionForm, Dynamics, ObservationForm, RewardForm
from .rendering import draw
from .scenario import Scenario, Value

_MODES = {
    AutoresetMode.NEXT_STEP: "next-step",
    AutoresetMode.SAME_STEP: "same-step",
    AutoresetMode.DISABLED: "disabled",
}

_KEYWORDS = KEYWORDS | {"num_envs", "max_episode_steps", "autoreset_mode", "copy"}

NUM_ENVS_MAX = 16_384
"""Most environments of a batch; each holds a room in memory."""


@contextmanager
def _owned_buffers() -> Iterator[None]:
    """Explains buffers that another thread uses: in this process, or in its parent during the fork."""
    try:
        yield
    except TypeError as problem:
        if "already borrowed" not in str(problem):
            raise
        raise RuntimeError(
            "another thread uses this batch, or used it when the process was forked: give each thread a batch of its own, "
            'make a new one in a forked process, or start workers with the method "spawn"'
        ) from problem


class HeliostatVectorEnv(VectorEnv[Any, Any, Any]):
    """Environments of the same settings, as `gymnasium.vector.VectorEnv`.

    Environment i after `reset(seed=s)` equals a `HeliostatEnv` after `reset(seed=s + i)`.

    Args:
        scenario: as for `HeliostatEnv`, as are `overrides` and the other settings, with the same defaults.
        num_envs: number of environments, at most `NUM_ENVS_MAX`; default 1.
        max_episode_steps: steps of an episode; default: an episode does not end.
        autoreset_mode: when an environment restarts after the end of its episode. `NEXT_STEP`, the default: the next
            step ignores its action. `SAME_STEP`: the step that ends the episode; `info["final_obs"]` has its last
            observation and `info["final_info"]` its last figures. `DISABLED`: by `reset(options={"reset_mask": mask})`.
        copy: whether a step returns arrays of its own; default true. Without copies the next step overwrites them.
        render_mode: "rgb_array"; default: no pictures.

    `info` has the figures of `HeliostatEnv`, an array for each. As in Gymnasium, the mask `info["_NAME"]` is true for
    the environments whose figures belong to the episode of the returned observation: not for those that restarted.
    """

    metadata: dict[str, Any] = {
        "render_modes": ["rgb_array"],
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        scenario: str | os.PathLike[str] | Scenario = "specular",
        *,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        overrides: Mapping[str, Value] | None = None,
        render_mode: Literal["rgb_array"] | None = None,
        observation: ObservationForm = "flat",
        action: ActionForm = "angles",
        dynamics: Dynamics = "static",
        reward: RewardForm = "shortfall",
        **settings: Any,
    ) -> None:
        num_envs = integer("num_envs", num_envs, 1, NUM_ENVS_MAX)
        if max_episode_steps is not None:
            max_episode_steps = integer("max_episode_steps", max_episode_steps, 1, _UNLIMITED)
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f'render_mode = {render_mode!r}: expected "rgb_array"')
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.scenario = make_scenario(scenario, overrides, dynamics, settings, _KEYWORDS)
        forms = {"action": action, "observation": observation, "dynamics": dynamics, "reward": reward}
        all_settings: dict[str, Any] = {**DEFAULTS, **forms, **settings}
        checked = make_settings(self.scenario, **all_settings)
        seeds = [self.scenario.seed + index for index in range(num_envs)]
        steps_max = _UNLIMITED if max_episode_steps is None else max_episode_steps
        self._batch = Batch(checked, seeds, _MODES[self.autoreset_mode], steps_max)
        self._layout = Layout(self._batch, observation)
        self._oracle = bool(all_settings["oracle"])
        of_batch: dict[str, Any] = {
            "num_envs": num_envs,
            "max_episode_steps": max_episode_steps,
            "autoreset_mode": self.autoreset_mode.value,
        }
        self._identity = identity("batch", self.scenario, {**of_batch, **all_settings})
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.single_action_space = self._layout.action_space
        self.single_observation_space = self._layout.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._copy = copy
        self._is_reset = False
        self._seen = np.zeros((num_envs, self._batch.observation_len), np.float32)
        self._last = np.zeros_like(self._seen)
        self._rewards = np.zeros(num_envs)
        self._terminated = np.zeros(num_envs, np.bool_)
        self._truncated = np.zeros(num_envs, np.bool_)
        self._figures = np.zeros((num_envs, 3))
        self._rates = np.zeros((num_envs, self._batch.users_max))
        self._restarts_next = np.zeros(num_envs, np.bool_)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Restarts all environments, or those of `options["reset_mask"]`; the first reset must be of all."""
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        if options:
            raise ValueError(f"unknown reset options {sorted(options)}: expected reset_mask")
        seeds: list[int | None]
        if isinstance(seed, (Sequence, np.ndarray)) and not isinstance(seed, str):
            seeds = [None if one is None else seed_of(one) for one in seed]
        else:
            first = None if seed is None else seed_of(seed)
            super().reset(seed=first)
            if first is None and not self._is_reset:
                first = int(self.np_random.integers(2**62))
            seeds = [None if first is None else seed_of(first + index) for index in range(self.num_envs)]
        if mask is not None:
            mask = np.ascontiguousarray(mask)
            if mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
                raise ValueError(f"reset_mask: expected booleans of shape ({self.num_envs},)")
            if not self._is_reset and not mask.all():
                left = int(np.flatnonzero(~mask)[0])
                raise ValueError(f"reset_mask leaves out environment {left}: the first reset must be of all environments")
        with _owned_buffers():
            self._batch.reset(seeds, self._seen, mask)
        self._is_reset = True
        self._restarts_next[slice(None) if mask is None else mask] = False
        return self._shown(self._seen), {}

    def step(self, actions: Any) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Steps all environments; raises `ValueError`, without a step, if any action is not valid."""
        if not self._is_reset:
            raise gymnasium.error.ResetNeeded("call reset before the first step")
        checked = np.ascontiguousarray(real("actions", actions), np.float32)
        if checked.shape != self.action_space.shape:
            raise ValueError(f"actions of shape {checked.shape}, expected {self.action_space.shape}")
        with _owned_buffers():
            self._batch.step(
                checked, self._seen, self._last, self._rewards, self._truncated, self._figures, self._rates
            )
        figures = {
            "sum_rate_mbps": self._figures[:, 0],
            "qos_met": self._figures[:, 1],
            "rates_mbps": self._rates,
        }
        if self._oracle:
            figures["oracle_mbps"] = self._figures[:, 2]
        restarts_now = self.autoreset_mode == AutoresetMode.SAME_STEP
        info = self._masked(figures, ~(self._truncated if restarts_now else self._restarts_next))
        if self.autoreset_mode == AutoresetMode.NEXT_STEP:
            self._restarts_next[:] = self._truncated
        if restarts_now and self._truncated.any():
            final = np.full(self.num_envs, None, object)
            for index in np.flatnonzero(self._truncated):
                final[index] = self._layout.shown(self._last[index].copy())
            info["final_obs"], info["_final_obs"] = final, self._truncated.copy()
            info["final_info"], info["_final_info"] = self._masked(figures, self._truncated), self._truncated.copy()
        return (
            self._shown(self._seen),
            self._own(self._rewards),
            self._own(self._terminated),
            self._own(self._truncated),
            info,
        )

    def clone_state(self) -> EnvState:
        """The present state of all environments, for `restore_state` of this batch or of another with equal settings."""
        flags = {"is_reset": self._is_reset, "restarts_next": self._restarts_next.copy()}
        return EnvState(copying.copy(self._batch), self.np_random.bit_generator.state, flags, self._identity)

    def restore_state(self, state: EnvState) -> None:
        """Continues from a state: the same actions give the same steps as after `clone_state`."""
        check_identity(state, self._identity)
        batch, self._batch = self._batch, copying.copy(state.batch)
        batch.close()
        self.np_random.bit_generator.state = state.generator
        self._is_reset = state.flags["is_reset"]
        self._restarts_next[:] = state.flags["restarts_next"]

    def __copy__(self) -> HeliostatVectorEnv:
        """A copy has rooms of its own, as `copy.deepcopy`."""
        return copying.deepcopy(self)

    def render(self) -> Any:
        """The pictures of all environments."""
        if self.render_mode is None:
            return None
        return tuple(draw(self.scenario, self._batch.state(index)) for index in range(self.num_envs))

    def close_extras(self, **_: Any) -> None:
        """Frees the rooms; later steps raise `RuntimeError`."""
        # Gymnasium closes what it deletes, also where the constructor refused its arguments.
        if hasattr(self, "_batch"):
            self._batch.close()

    def _masked(self, figures: Mapping[str, NDArray[np.float64]], mask: NDArray[np.bool_]) -> dict[str, Any]:
        """The figures in the form of Gymnasium: each with the mask of the environments for which it holds."""
        info: dict[str, Any] = {}
        for name, values in figures.items():
            info[name], info[f"_{name}"] = self._own(values), mask.copy()
        return info

    def _own(self, array: NDArray[Any]) -> NDArray[Any]:
        return array.copy() if self._copy else array

    def _shown(self, flat: NDArray[np.float32]) -> Any:
        return self._layout.shown(self._own(flat))
