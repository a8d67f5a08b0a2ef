"""From a PyTorch module to an ONNX file that the controller runs."""

from __future__ import annotations

import inspect
import io
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ._checks import name_of
from ._core import check_input, finish_actor
from .envs import HeliostatEnv

_OPSET = 17

_CHECKS = 4
"""Fixed inputs whose outputs are in the metadata."""

_OBSERVATIONS = ("flat", "paper")
"""The observations that the controller can give to a network."""

_EXAMPLE = "as in python/examples/ppo.py"


def export_onnx(module: Any, env: HeliostatEnv | Any, path: str | os.PathLike[str]) -> Path:
    """Writes `module` as an actor for the room of `env`, with the metadata that the controller needs.

    `module` maps a batch of observations, (1, n), to actions in [-1, 1], (1, m). Values beyond the bounds count as the
    nearest bound, as in the environment. The environment has the action "angles" or "weights", and the observation
    "flat" or "paper". The controller turns weights into angles with the decoder of the environment.

    A chain of dense layers runs everywhere. Any other module needs ONNX Runtime where it runs: `heliostat[export]` installs
    it for programs that are started in the same environment.

    The file also holds outputs of `module` for four fixed inputs, by which the controller verifies its engine.

    Needs PyTorch. Raises `TypeError` for an object that is no module, and `ValueError` for a module whose file no
    controller accepts: one that samples, or that returns several values. Of an actor or a policy whose forward has the
    parameter `deterministic`, as those of Stable-Baselines3, the deterministic action is written.
    """
    inner = _environment(env)
    if inner.observation_form not in _OBSERVATIONS:
        raise ValueError(f"observation = {inner.observation_form!r}: expected \"flat\" or \"paper\", which the controller "
                         f"gives a network with the action {inner.action_form!r}")
    try:
        import onnx as _  # For the exporter of PyTorch.
        import torch
    except ImportError as problem:
        raise ImportError('export_onnx needs PyTorch and onnx: pip install "heliostat[export]"') from problem
    _check_module(module, torch)
    inputs, outputs = (int(np.prod(space.shape or ())) for space in (inner.observation_space, inner.action_space))
    module = _deterministic(module, torch)
    was_training = bool(module.training)
    module.eval()
    try:
        with warnings.catch_warnings(), torch.no_grad():
            # PyTorch announces that this exporter will be replaced by one that needs further
            # packages.
            warnings.simplefilter("ignore", DeprecationWarning)
            check = [_outputs(module, torch, number, (inputs, outputs)) for number in range(_CHECKS)]
            if _outputs(module, torch, 0, (inputs, outputs)) != check[0]:
                raise ValueError(f"{name_of(module)} samples: two runs on one observation differ; pass a module that returns "
                                 "the deterministic action, that is the mean")
            network = _exported(module, torch, inputs)
    finally:
        module.train(was_training)
    actor = finish_actor(network, inner.scenario, inner.action_form, inner.observation_form, inner.slots, check)
    target = Path(path)
    target.write_bytes(actor)
    return target


def _environment(env: Any) -> HeliostatEnv:
    """The environment that the module acts in."""
    inner = getattr(env, "unwrapped", env)
    if isinstance(inner, HeliostatEnv):
        return inner
    found = type(inner).__name__
    if hasattr(inner, "venv") or hasattr(inner, "num_envs"):
        raise TypeError(f"expected one environment, found the batch {found}: pass heliostat.HeliostatEnv with the same "
                        "settings; a normalisation of VecNormalize belongs into the module")
    raise TypeError(f"expected an environment of heliostat, found {found}")


def _check_module(module: Any, torch: Any) -> None:
    """Refuses what is no module that can be written, and says what to pass instead."""
    name = name_of(module)
    if isinstance(module, torch.nn.Module):
        if hasattr(module, "_orig_mod"):
            raise TypeError("expected a module, found a compiled one: pass the module that torch.compile got")
        devices = {parameter.device.type for parameter in module.parameters()}
        if devices - {"cpu"}:
            raise ValueError(f"{name} is on the device {', '.join(sorted(devices))}: pass module.cpu()")
        return
    if hasattr(module, "policy"):
        raise TypeError(f"expected a module, found the model {name}: pass a module that returns the actions of "
                        f"model.policy, {_EXAMPLE}")
    raise TypeError(f"expected a torch.nn.Module, found {name}: write a module whose forward calls it, {_EXAMPLE}")


def _deterministic(module: Any, torch: Any) -> Any:
    """The module, or one that calls it for its deterministic action, as policies of Stable-Baselines3 need."""
    parameters = inspect.signature(module.forward).parameters if not isinstance(module, torch.jit.ScriptModule) else {}
    if "deterministic" not in parameters:
        return module

    class Mean(torch.nn.Module):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self.inner = module

        def forward(self, observation: Any) -> Any:
            return self.inner(observation, deterministic=True)

    Mean.__name__ = type(module).__name__
    return Mean()


def _outputs(module: Any, torch: Any, number: int, sizes: tuple[int, int]) -> list[float]:
    """The module's own outputs for a fixed input."""
    inputs, outputs = sizes
    found = module(torch.tensor([check_input(number, inputs)]))
    if isinstance(found, tuple | list):
        raise ValueError(f"{name_of(module)} returns {len(found)} values: pass a module that returns the actions, {_EXAMPLE}")
    shape = tuple(found.shape)
    if shape != (1, outputs):
        raise ValueError(f"the module returns the shape {shape} for one observation, expected {(1, outputs)}")
    values = [float(value) for value in found[0]]
    if not np.isfinite(values).all():
        raise ValueError(f"{name_of(module)} returns a value that is not finite: train it again if the training diverged")
    return values


def _exported(module: Any, torch: Any, inputs: int) -> bytes:
    """The network as the exporter of PyTorch writes it."""
    file = io.BytesIO()
    try:
        torch.onnx.export(
            module,
            (torch.zeros(1, inputs),),
            file,
            input_names=["input"],
            output_names=["output"],
            opset_version=_OPSET,
            dynamo=False,
        )
    except Exception as problem:
        reason = " ".join(str(problem).split())[:200]
        raise ValueError(f"PyTorch does not export {name_of(module)}: {reason}") from problem
    return file.getvalue()
