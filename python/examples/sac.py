"""Soft actor-critic of Stable-Baselines3 on the angles of all mirrors, exported for the controller.

    python python/examples/sac.py own.onnx [STEPS]
"""

import sys
from typing import Any

import heliostat
import torch
from heliostat.sb3 import HeliostatVecEnv
from stable_baselines3 import SAC


class Actor(torch.nn.Module):
    """The mean action of the trained policy."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.latent, self.mean = policy.actor.latent_pi, policy.actor.mu

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        return torch.tanh(self.mean(self.latent(observation)))


def main(path: str, steps: str = "20000") -> None:
    settings: dict[str, Any] = {"scenario": "specular", "max_episode_steps": 40}
    model = SAC("MlpPolicy", HeliostatVecEnv(num_envs=8, **settings), gamma=0.0, seed=1, verbose=1)
    model.learn(int(steps))
    env = heliostat.HeliostatEnv("specular")
    score = heliostat.evaluate(lambda seen: model.predict(seen, deterministic=True)[0], env, states=100)
    print(f"sum rate over the oracle's: {score.ratio_to_oracle:.3f}")
    print(f"written: {heliostat.export_onnx(Actor(model.policy).cpu(), env, path)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
