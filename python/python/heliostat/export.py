"""From a PyTorch module to an ONNX file that the controller runs."""

from __future__ import annotations

import io
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ._core import finish_actor
from .envs import HeliostatEnv

_OPSET = 17


_OBSERVATIONS = ("flat", "paper")
"""The observations that the controller can give to a network."""


def export_onnx(module: Any, env: HeliostatEnv | Any, path: str | os.PathLike[str]) -> Path:
    """Writes `module` as an actor for the room of `env`, with the metadata that the controller needs.

    `module` maps a batch of observations, (1, n), to actions in [-1, 1], (1, m). Values beyond the bounds count as the
    nearest bound, as in the environment. The environment has the action "angles" or "weights", and the observation
    "flat" or "paper". With the action "weights" the file holds the decoder too.

    Needs PyTorch. Raises `ValueError` for a module whose file no controller accepts.
    """
    inner = getattr(env, "unwrapped", env)
    if not isinstance(inner, HeliostatEnv):
        raise TypeError(f"expected an environment of heliostat, found {type(inner).__name__}")
    action, observation = inner.action_form, inner.observation_form
    if observation not in _OBSERVATIONS:
        names = " or ".join(f'"{name}"' for name in _OBSERVATIONS)
        raise ValueError(f"observation = {observation!r}: expected {names}, which the controller gives a network")
    try:
        import onnx as _  # For the exporter of PyTorch.
        import torch
    except ImportError as problem:
        raise ImportError('export_onnx needs PyTorch and onnx: pip install "heliostat[export]"') from problem
    inputs, outputs = (int(np.prod(space.shape or ())) for space in (inner.observation_space, inner.action_space))
    file = io.BytesIO()
    was_training = module.training
    module.eval()
    try:
        with warnings.catch_warnings(), torch.no_grad():
            # PyTorch announces that this exporter will be replaced by one that needs further
            # packages.
            warnings.simplefilter("ignore", DeprecationWarning)
            example = torch.zeros(1, inputs)
            found, expected = tuple(module(example).shape), (1, outputs)
            if found != expected:
                raise ValueError(f"the module returns the shape {found} for one observation, expected {expected}")
            torch.onnx.export(
                module,
                (example,),
                file,
                input_names=["input"],
                output_names=["output"],
                opset_version=_OPSET,
                dynamo=False,
            )
    finally:
        module.train(was_training)
    actor = finish_actor(file.getvalue(), inner.scenario, action, observation, inner.slots)
    target = Path(path)
    target.write_bytes(actor)
    return target
