"""Deep deterministic policy gradient in one file, in the style of CleanRL, exported for the controller.

    python python/examples/ddpg_continuous_action.py own.onnx [STEPS]

Deviations from CleanRL: a batch of environments, no discount of later rewards (an action does not change where users
walk), and observations on a logarithmic scale inside the networks.
"""

import sys
from typing import Any

import heliostat
import numpy as np
import torch
from torch import nn

SEED, ENVIRONMENTS, BATCH, CAPACITY, WARM_UP = 1, 16, 128, 20_000, 1_000
ACTOR_RATE, CRITIC_RATE, NOISE_START, NOISE_END = 3e-4, 1e-3, 0.3, 0.05


def scaled(observation: torch.Tensor) -> torch.Tensor:
    return torch.sign(observation) * torch.log1p(torch.abs(observation))


class Actor(nn.Module):
    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.net = nn.Sequential(nn.Linear(inputs, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU(), nn.Linear(256, outputs))

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        return torch.tanh(self.net(scaled(observation)))


class Critic(nn.Module):
    def __init__(self, inputs: int, actions: int) -> None:
        super().__init__()
        self.net = nn.Sequential(nn.Linear(inputs + actions, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU(), nn.Linear(256, 1))

    def forward(self, observation: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        return self.net(torch.cat([scaled(observation), action], 1)).squeeze(1)


def main(path: str, steps: str = "20000") -> None:
    torch.manual_seed(SEED)
    generator = np.random.default_rng(SEED)
    many = heliostat.HeliostatVectorEnv("specular", num_envs=ENVIRONMENTS, max_episode_steps=40)
    inputs, outputs = many.single_observation_space.shape[0], many.single_action_space.shape[0]
    actor, critic = Actor(inputs, outputs), Critic(inputs, outputs)
    actor_optimiser = torch.optim.Adam(actor.parameters(), lr=ACTOR_RATE)
    critic_optimiser = torch.optim.Adam(critic.parameters(), lr=CRITIC_RATE)
    memory = [np.zeros((CAPACITY, width), np.float32) for width in (inputs, outputs, 1)]
    seen, _ = many.reset(seed=SEED)
    ended = np.zeros(ENVIRONMENTS, bool)
    stored, rounds = 0, int(steps) // ENVIRONMENTS
    for round_ in range(rounds):
        with torch.no_grad():
            action = actor(torch.from_numpy(seen)).numpy()
        noise = NOISE_START + (NOISE_END - NOISE_START) * round_ / rounds
        action = np.clip(action + generator.normal(0.0, noise, action.shape), -1, 1).astype(np.float32)
        following, rewards, _, truncated, _ = many.step(action)
        # A step that restarts has no reward of its action.
        for index in np.flatnonzero(~ended):
            for part, value in zip(memory, (seen[index], action[index], rewards[index]), strict=True):
                part[stored % CAPACITY] = value
            stored += 1
        seen, ended = following, truncated
        if stored < WARM_UP:
            continue
        chosen = generator.integers(0, min(stored, CAPACITY), BATCH)
        states, actions, values = (torch.from_numpy(part[chosen]) for part in memory)
        loss = nn.functional.mse_loss(critic(states, actions), values.squeeze(1))
        critic_optimiser.zero_grad()
        loss.backward()
        critic_optimiser.step()
        actor_loss = -critic(states, actor(states)).mean()
        actor_optimiser.zero_grad()
        actor_loss.backward()
        actor_optimiser.step()

    def act(observation: Any) -> Any:
        with torch.no_grad():
            return actor(torch.from_numpy(observation)[None])[0].numpy()

    env = heliostat.HeliostatEnv("specular")
    print(f"sum rate over the oracle's: {heliostat.evaluate(act, env, states=100).ratio_to_oracle:.3f}")
    print(f"written: {heliostat.export_onnx(actor, env, path)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
