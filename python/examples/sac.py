"""Soft actor-critic of Stable-Baselines3, from training to a file that the controller runs.

    python python/examples/sac.py train FOLDER [--environment heliostat/Hall-v0] [--minutes 20] [--cores 2]
    python python/examples/sac.py report FOLDER [--program heliostat] [--page PAGE.md]

`train` writes checkpoints into the folder. `report` exports the last one as own.onnx, compares it with other policies by
the program, runs it in the demo, and scores each checkpoint on held-out states.

An action is one weight per user. It has little effect on later states, so later rewards are not discounted but left
out (gamma = 0). The networks read the summary of an observation, a few values per user.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import time
from pathlib import Path
from typing import Any


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    train = commands.add_parser("train", help="train, and write checkpoints")
    train.add_argument("folder", type=Path)
    train.add_argument("--environment", default="heliostat/Hall-v0", help="the id of an environment")
    train.add_argument("--action", default="weights", help="the form of the action")
    train.add_argument("--minutes", type=float, default=20.0, help="time on that many cores that no other process uses")
    train.add_argument("--steps", type=int, default=10**9, help="steps of all environments, if they end earlier")
    train.add_argument("--cores", type=int, default=2, help="cores that the training may use")
    train.add_argument("--rooms", type=int, default=8, help="environments of the batch")
    train.add_argument("--seed", type=int, default=1)
    report = commands.add_parser("report", help="score the checkpoints and export the last one")
    report.add_argument("folder", type=Path)
    report.add_argument("--states", type=int, default=100, help="held-out states for each seed")
    report.add_argument("--seeds", type=int, default=3, help="seeds of held-out rooms for the comparison")
    report.add_argument("--program", help="the program heliostat, for the comparison and the demo")
    report.add_argument("--page", type=Path, help="the page to write")
    return parser.parse_args()


ARGUMENTS = parsed() if __name__ == "__main__" else None
if ARGUMENTS is not None and ARGUMENTS.command == "train":
    # Before the libraries start their threads.
    os.environ["RAYON_NUM_THREADS"] = str(ARGUMENTS.cores)

import gymnasium
import heliostat
import torch
from heliostat.sb3 import HeliostatVecEnv
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

CHECKPOINTS = 20


class Summary(BaseFeaturesExtractor):  # type: ignore[misc]
    """The summary of a flat observation, on a logarithmic scale."""

    def __init__(self, space: gymnasium.spaces.Box, first: int, last: int) -> None:
        super().__init__(space, last - first)
        self.first, self.last = first, last

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        part = observation[:, self.first : self.last]
        return torch.sign(part) * torch.log1p(torch.abs(part))


class Actor(torch.nn.Module):
    """The mean action of the trained policy."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.features = policy.actor.features_extractor
        self.latent, self.mean = policy.actor.latent_pi, policy.actor.mu

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        return torch.tanh(self.mean(self.latent(self.features(observation))))


class Checkpoints(BaseCallback):  # type: ignore[misc]
    """Saves the model at times of equal spacing, and ends the training after this much processor time."""

    def __init__(self, folder: Path, processor_s: float) -> None:
        super().__init__()
        self.folder, self.processor_s = folder, processor_s
        self.begun = time.monotonic(), time.process_time()
        self.rows: list[dict[str, Any]] = []

    def save(self) -> None:
        name = f"{self.num_timesteps}.zip"
        self.model.save(self.folder / name)
        elapsed_s, processor_s = time.monotonic() - self.begun[0], time.process_time() - self.begun[1]
        row = {"file": name, "steps": self.num_timesteps, "elapsed_s": elapsed_s, "processor_s": processor_s}
        self.rows.append(row)
        (self.folder / "checkpoints.json").write_text(json.dumps(self.rows))
        print(f"{processor_s:6.0f} s of processor time, {elapsed_s:.0f} s, {self.num_timesteps} steps", flush=True)

    def _on_step(self) -> bool:
        processor_s = time.process_time() - self.begun[1]
        if processor_s >= len(self.rows) * self.processor_s / CHECKPOINTS:
            self.save()
        return processor_s < self.processor_s

    def _on_training_end(self) -> None:
        if self.rows[-1]["steps"] < self.num_timesteps:
            self.save()


def train(arguments: argparse.Namespace) -> None:
    arguments.folder.mkdir(parents=True, exist_ok=True)
    # The networks are too small to gain from a second thread; the rooms use all cores.
    torch.set_num_threads(1)
    env = gymnasium.make(arguments.environment, action=arguments.action).unwrapped
    assert isinstance(env, heliostat.HeliostatEnv)
    spec = gymnasium.spec(arguments.environment)
    keywords = {**spec.kwargs, "action": arguments.action}
    settings = {name: str(value) for name, value in vars(arguments).items()}
    (arguments.folder / "settings.json").write_text(json.dumps({**settings, "keywords": keywords}))
    summary, _ = env.parts["summary"]
    rooms = HeliostatVecEnv(num_envs=arguments.rooms, max_episode_steps=spec.max_episode_steps, **keywords)
    extractor = {"first": summary.start, "last": summary.stop}
    model = SAC(
        "MlpPolicy",
        rooms,
        gamma=0.0,
        ent_coef="auto_0.05",
        buffer_size=100_000,
        learning_starts=1_000,
        gradient_steps=arguments.rooms // 2,
        batch_size=128,
        policy_kwargs={
            "net_arch": [128, 128],
            "features_extractor_class": Summary,
            "features_extractor_kwargs": extractor,
        },
        seed=arguments.seed,
        device="cpu",
    )
    model.learn(arguments.steps, callback=Checkpoints(arguments.folder, 60.0 * arguments.minutes * arguments.cores))


def checkpoint(folder: Path, name: str) -> SAC:
    """A saved model, with an empty memory."""
    return SAC.load(folder / name, device="cpu", buffer_size=1)


def output_of(command: list[str]) -> str:
    """What a command prints; where it fails, its message is on standard error and the script ends."""
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    if done.returncode != 0:
        raise SystemExit(f"exit status {done.returncode}, expected 0: {shlex.join(command)}; its message is above")
    return done.stdout


def evaluated(program: str, path: Path, scenario: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """The report of `heliostat-lab eval` in closed loop for the file and other policies."""
    policies = f"{path},greedy,fixed-point,ddpg,nearest,flat"
    lab = str(Path(program).with_name("heliostat-lab"))
    command = [lab, "eval", "--scenario", scenario, "--closed-loop", "--policies", policies, "--json"]
    command += ["--states", str(arguments.states), "--seeds", str(arguments.seeds)]
    return dict(json.loads(output_of(command)))


def demonstrated(program: str, path: Path, scenario: str) -> list[str]:
    """The summary of the demo with the file."""
    shown = output_of([program, "demo", "--scenario", scenario, "--model", str(path), "--seconds", "20"])
    return shown[shown.rindex("\nsum rate") :].strip().splitlines()


def report(arguments: argparse.Namespace) -> None:
    folder = arguments.folder
    settings = json.loads((folder / "settings.json").read_text())
    rows = json.loads((folder / "checkpoints.json").read_text())
    env = gymnasium.make(settings["environment"], action=settings["action"]).unwrapped
    assert isinstance(env, heliostat.HeliostatEnv)
    path = heliostat.export_onnx(Actor(checkpoint(folder, rows[-1]["file"]).policy), env, folder / "own.onnx")
    print(f"written: {path}", flush=True)
    # Before the scores, which take far longer: a file that a program refuses ends the script here.
    runs: tuple[dict[str, Any], list[str]] | None = None
    if arguments.program:
        program, scenario = arguments.program, env.scenario.name
        runs = evaluated(program, path, scenario, arguments), demonstrated(program, path, scenario)

    def score(model: SAC) -> heliostat.Score:
        return heliostat.evaluate(
            lambda seen: model.predict(seen, deterministic=True)[0], env, arguments.states, arguments.seeds
        )

    zero = heliostat.evaluate(lambda _: 0 * env.action_space.sample(), env, arguments.states, arguments.seeds)
    lines = ["# Results: soft actor-critic in Python", ""]
    lines += ["Written by `python/examples/sac.py report`; do not edit. What it trains: [python.md](../python.md).", ""]
    lines += ["```", f"python python/examples/sac.py train FOLDER --environment {settings['environment']} --action "
              f"{settings['action']} --minutes {settings['minutes']} --cores {settings['cores']} --seed {settings['seed']}"]
    lines += [f"python python/examples/sac.py report FOLDER --states {arguments.states} --seeds {arguments.seeds}", "```", ""]
    scores: list[heliostat.Score] = []
    for row in rows:
        scores.append(score(checkpoint(folder, row["file"])))
        print(f"{row['steps']} steps: {figures(scores[-1])}", flush=True)
    last = scores[-1]
    lines += ["## Result", "", *outcome(settings, rows[-1], scores, zero), ""]
    lines += ["## Learning curve", "", f"{arguments.states} held-out states of each of {arguments.seeds} seeds, in closed loop.", ""]
    lines += ["| processor time, s | elapsed, s | steps | sum rate, Mbit/s | ratio to the oracle | minimum rates met |"]
    lines += ["| --- | --- | --- | --- | --- | --- |"]
    lines += [f"| action 0 | | | {figures(zero)} |"]
    for row, scored in zip(rows, scores, strict=True):
        lines += [f"| {row['processor_s']:.0f} | {row['elapsed_s']:.0f} | {row['steps']} | {figures(scored)} |"]
    if runs is not None:
        lines += compared(arguments, path, last, *runs)
    if arguments.page:
        arguments.page.write_text("\n".join(lines) + "\n")
        print(f"written: {arguments.page}")


def outcome(
    settings: dict[str, str], row: dict[str, Any], scores: list[heliostat.Score], zero: heliostat.Score
) -> list[str]:
    """How long the training took until its last row, and whether it is better than an action of zeros."""
    last, best = scores[-1].ratio_to_oracle, max(score.ratio_to_oracle for score in scores)
    used_s, full_s = row["processor_s"], 60.0 * float(settings["minutes"]) * int(settings["cores"])
    ended = "" if used_s >= full_s else f" It was ended before its {full_s:.0f} s of processor time."
    difference, half = scores[-1].minus(zero)
    paired = f" The paired difference is {difference:+.4f} ± {half:.4f}." if half >= 0.0 else ""
    side = "below" if last < zero.ratio_to_oracle else "above" if last > zero.ratio_to_oracle else "equal to"
    return [
        f"The last checkpoint has the ratio {last:.4f} to the oracle. That is {side} the ratio {zero.ratio_to_oracle:.4f} "
        f"of action 0, which needs no training.{paired} The best checkpoint has {best:.4f}.",
        "",
        f"The training took {row['elapsed_s']:.0f} s for {row['steps']} steps, and {used_s:.0f} s of processor time.{ended} "
        "Other processes used the machine too, so processor time shows the effort.",
    ]


def figures(score: heliostat.Score) -> str:
    return f"{score.sum_rate_mbps:.1f} | {score.ratio_to_oracle:.4f} | {score.qos_met:.4f}"


def interval(figure: dict[str, Any], digits: int) -> str:
    """A mean with half the width of its interval, which a single episode does not have."""
    half = "" if figure["ci95"] is None else f" ± {figure['ci95']:.{digits}f}"
    return f"{figure['mean']:.{digits}f}{half}"


def compared(
    arguments: argparse.Namespace, path: Path, own: heliostat.Score, found: dict[str, Any], summary: list[str]
) -> list[str]:
    """The exported file beside other policies, and in the demo."""
    scenario = found["scenario"]
    lines = ["", "## The exported file beside other policies", "", "```"]
    lines += [f"heliostat-lab eval --scenario {scenario} --closed-loop --policies own.onnx,greedy,fixed-point,ddpg,nearest,flat "
              f"--states {arguments.states} --seeds {arguments.seeds}", "```", ""]
    lines += [f"A figure is a mean with half the width of its 95 % interval, of {found['episodes']} episodes. Commit {found['commit']}.", ""]
    lines += ["| policy | sum rate, Mbit/s | ratio to the oracle | minimum rates met |", "| --- | --- | --- | --- |"]
    policies = sorted(found["policies"].items(), key=lambda item: -item[1]["ratio_to_oracle"]["mean"])
    for name, row in policies:
        shown = [interval(row[key], digits) for key, digits in (("sum_rate_mbps", 1), ("ratio_to_oracle", 4), ("qos_met", 4))]
        lines += [f"| {'own.onnx' if name == str(path) else name} | {' | '.join(shown)} |"]
    by_program = found["policies"][str(path)]["ratio_to_oracle"]["mean"]
    lines += ["", f"`heliostat.evaluate` gives the ratio {own.ratio_to_oracle:.4f} for the same network, the program "
              f"{by_program:.4f} for the file.", "", "## In the demo", "", "```"]
    lines += [f"heliostat demo --scenario {scenario} --model own.onnx --seconds 20", *summary, "```"]
    return lines


def main(arguments: argparse.Namespace) -> None:
    if arguments.command == "train":
        train(arguments)
    else:
        report(arguments)


if ARGUMENTS is not None:
    main(ARGUMENTS)
