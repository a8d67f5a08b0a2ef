"""The batch as a vector environment of Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from .vector import HeliostatVectorEnv

_FIGURES = ("sum_rate_mbps", "qos_met", "rates_mbps", "oracle_mbps")
"""What the information of each environment has of the batch's."""


class HeliostatVecEnv(VecEnv):  # type: ignore[misc]
    """Environments of the same settings as `stable_baselines3.common.vec_env.VecEnv`.

    The arguments are those of `HeliostatVectorEnv`; the mode of autoreset is that of Stable-Baselines3. The information
    of each environment has the figures that `HeliostatEnv` describes.
    """

    def __init__(self, scenario: str = "specular", *, num_envs: int = 1, **settings: Any) -> None:
        settings["autoreset_mode"] = AutoresetMode.SAME_STEP
        self.inner = HeliostatVectorEnv(scenario, num_envs=num_envs, **settings)
        self.render_mode = self.inner.render_mode
        super().__init__(num_envs, self.inner.single_observation_space, self.inner.single_action_space)
        self._actions: Any = None

    def reset(self) -> Any:
        """Restarts all environments, with the seeds of `seed` if it was called.

        Raises `ValueError` for the options of `set_options`: a batch has none.
        """
        if any(self._options):
            self._reset_options()
            raise ValueError("set_options: the environments of a batch have no options of a reset; reset heliostat.HeliostatEnv "
                             "with them, or call heliostat.evaluate for a score in held-out rooms")
        given = [one for one in self._seeds if one is not None]
        observation, _ = self.inner.reset(seed=list(self._seeds) if given else None)
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: Any) -> None:
        """Takes the actions of the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
        """Steps all environments."""
        observation, rewards, _, truncated, info = self.inner.step(self._actions)
        infos: list[dict[str, Any]] = []
        for index in range(self.num_envs):
            one: dict[str, Any] = {name: info[name][index] for name in _FIGURES if name in info}
            one["TimeLimit.truncated"] = bool(truncated[index])
            if truncated[index]:
                one["terminal_observation"] = info["final_obs"][index]
            infos.append(one)
        return observation, rewards.astype(np.float32), truncated, infos

    def close(self) -> None:
        """Frees the rooms."""
        self.inner.close()

    def get_images(self) -> Sequence[Any]:
        """The pictures of all environments."""
        return self.inner.render() or []

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the batch, once for each environment."""
        value = getattr(self.inner, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: the environments of a batch share their attributes."""
        raise NotImplementedError("the environments of a batch share their attributes; make a new batch")

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Refused: the environments of a batch have no methods of their own."""
        raise NotImplementedError(f"the environments of a batch have no method {method_name} of their own")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """No environment of a batch is wrapped."""
        return [False for _ in self._get_indices(indices)]
