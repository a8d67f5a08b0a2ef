"""Proximal policy optimisation of Stable-Baselines3, from training to a file that the controller runs.

    python python/examples/ppo.py own.onnx [--environment heliostat/Hall-v0] [--steps 100000]

It prints the scores of the trained network and of action 0 in held-out rooms, and exports the network. As in sac.py,
an action is one weight per user, later rewards are left out (gamma = 0), and the networks read the summary of an
observation.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import gymnasium
import heliostat
import torch
from heliostat.sb3 import HeliostatVecEnv
from sac import Summary
from stable_baselines3 import PPO

ROUND = 512
"""Steps of all environments between two updates."""


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, help="the file to write")
    parser.add_argument("--environment", default="heliostat/Hall-v0", help="the id of an environment")
    parser.add_argument("--steps", type=int, default=100_000, help="steps of all environments, at least")
    parser.add_argument("--rooms", type=int, default=8, help="environments of the batch")
    parser.add_argument("--states", type=int, default=100, help="held-out states of the score")
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


class Actor(torch.nn.Module):
    """The mean action of the trained policy, within the bounds of actions."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.features, self.latent = policy.features_extractor, policy.mlp_extractor.policy_net
        self.mean = policy.action_net

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        return torch.clamp(self.mean(self.latent(self.features(observation))), -1.0, 1.0)


def train(arguments: argparse.Namespace, env: heliostat.HeliostatEnv, keywords: dict[str, Any]) -> PPO:
    # The networks are too small to gain from a second thread; the rooms use all cores.
    torch.set_num_threads(1)
    summary, _ = env.parts["summary"]
    steps_max = gymnasium.spec(arguments.environment).max_episode_steps
    rooms = HeliostatVecEnv(num_envs=arguments.rooms, max_episode_steps=steps_max, **keywords)
    model = PPO(
        "MlpPolicy",
        rooms,
        gamma=0.0,
        gae_lambda=0.0,
        n_steps=max(ROUND // arguments.rooms, 2),
        batch_size=128,
        policy_kwargs={
            "net_arch": [128, 128],
            "log_std_init": -1.0,
            "features_extractor_class": Summary,
            "features_extractor_kwargs": {"first": summary.start, "last": summary.stop},
        },
        seed=arguments.seed,
        device="cpu",
    )
    model.learn(arguments.steps)
    rooms.close()
    return model


def main(arguments: argparse.Namespace) -> None:
    keywords = {**gymnasium.spec(arguments.environment).kwargs, "action": "weights"}
    env = heliostat.HeliostatEnv(**keywords)
    actor = Actor(train(arguments, env, keywords).policy)

    def act(observation: Any) -> Any:
        with torch.no_grad():
            return actor(torch.from_numpy(observation)[None])[0].numpy()

    own = heliostat.evaluate(act, env, states=arguments.states)
    zero = heliostat.evaluate(lambda seen: 0 * act(seen), env, states=arguments.states)
    print(f"sum rate over the oracle's: {own.ratio_to_oracle:.4f}, and {zero.ratio_to_oracle:.4f} of action 0")
    print(f"written: {heliostat.export_onnx(actor, env, arguments.file)}")


if __name__ == "__main__":
    main(parsed())
