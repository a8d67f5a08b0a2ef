"""Proximal policy optimisation of Ray RLlib: the users of a room as agents that share one network, on several workers.

    pip install "./python[pettingzoo]" "ray[rllib]" torch
    python python/examples/rllib.py [--scenario hall] [--workers 2] [--steps 100000]

Each worker is a process with rooms of its own. With RAY_ADDRESS=auto a cluster of Ray that runs already spreads them
over its machines; each needs the same packages. An agent observes the belief about all users, its own user first, and
chooses the weight of its user. The agents share the reward of the room. As in ppo.py, later rewards are left out
(gamma = 0): an action hardly changes the rooms that follow.

It prints the steps a second of the workers, and the mean sum rate of the learned and of equal weights in the same rooms,
which no worker has used.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from typing import Any

import numpy as np

SHARED = "weight"
"""The name of the network that all agents share."""


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="hall", help="built-in name or file of a scenario")
    parser.add_argument("--users", type=int, default=5, help="users of a room")
    parser.add_argument("--workers", type=int, default=2, help="processes that sample rooms")
    parser.add_argument("--steps", type=int, default=100_000, help="steps of all rooms, at least")
    parser.add_argument("--rooms", type=int, default=20, help="held-out rooms of the score")
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


def make(settings: dict[str, Any]) -> Any:
    """An environment of RLlib; each worker calls it."""
    from heliostat.multiagent import parallel_env
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv

    return ParallelPettingZooEnv(parallel_env("users", **settings))


def configured(arguments: argparse.Namespace, settings: dict[str, Any]) -> Any:
    """The learner."""
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
    from ray.tune.registry import register_env

    register_env("heliostat", make)
    return (
        PPOConfig()
        .environment("heliostat", env_config=dict(settings))
        .env_runners(num_env_runners=arguments.workers, num_cpus_per_env_runner=1, sample_timeout_s=600.0)
        .learners(num_learners=0)
        .multi_agent(policies={SHARED}, policy_mapping_fn=lambda agent, *_, **__: SHARED)
        .rl_module(model_config=DefaultModelConfig(fcnet_hiddens=[64, 64], vf_share_layers=False))
        .training(gamma=0.0, lambda_=0.0, lr=3e-4, train_batch_size_per_learner=1000, minibatch_size=500, num_epochs=4)
        .debugging(seed=arguments.seed)
    )


def mean_rate(algorithm: Any, settings: dict[str, Any], rooms: int, *, learned: bool) -> float:
    """The mean sum rate in Mbit/s in held-out rooms, by the mean actions of the network or by equal weights."""
    import torch
    from heliostat.multiagent import parallel_env

    module = algorithm.get_module(SHARED)
    env, rates = parallel_env("users", **settings), []
    for index in range(rooms):
        seen, _ = env.reset(options={"held_out": index})
        while env.agents:
            actions = {agent: np.zeros(1, np.float32) for agent in env.agents}
            if learned:
                batch = {"obs": torch.from_numpy(np.stack([seen[agent] for agent in env.agents]))}
                with torch.no_grad():
                    means = module.forward_inference(batch)["action_dist_inputs"][:, :1].clamp(-1.0, 1.0).numpy()
                actions = dict(zip(env.agents, means, strict=True))
            seen, _, _, _, infos = env.step(actions)
            rates.append(infos[next(iter(infos))]["sum_rate_mbps"])
    env.close()
    return float(np.mean(rates))


def main(arguments: argparse.Namespace) -> None:
    import ray

    own: dict[str, Any] = {"num_cpus": max(arguments.workers, os.cpu_count() or 1), "include_dashboard": False}
    # Ray refuses these for a cluster that runs already.
    ray.init(log_to_driver=False, **({} if os.environ.get("RAY_ADDRESS") else own))
    dynamics = "static" if arguments.scenario in ("specular", "paper") else "closed-loop"
    settings = {
        "scenario": arguments.scenario,
        "dynamics": dynamics,
        "max_steps": 100,
        "overrides": {"users.count": arguments.users},
    }
    algorithm = configured(arguments, settings).build_algo()
    began, steps = time.monotonic(), 0
    while steps < arguments.steps:
        result = algorithm.train()
        steps = int(result["env_runners"]["num_env_steps_sampled_lifetime"])
        print(f"{steps} steps, {steps / (time.monotonic() - began):.0f} a second", flush=True)
    seconds = time.monotonic() - began
    learned = mean_rate(algorithm, settings, arguments.rooms, learned=True)
    equal = mean_rate(algorithm, settings, arguments.rooms, learned=False)
    figures = {
        "workers": arguments.workers,
        "steps": steps,
        "steps_per_s": round(steps / seconds, 1),
        "learned_mbps": round(learned, 2),
        "equal_weights_mbps": round(equal, 2),
    }
    print(json.dumps(figures))
    algorithm.stop()
    ray.shutdown()


if __name__ == "__main__":
    main(parsed())
