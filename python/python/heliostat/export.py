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


_OBSERVATIONS = {"angles": ("flat", "paper"), "weights": ("flat", "paper"), "compact": ("evidence",)}
"""The observations that the controller can give to a network with each action."""


def export_onnx(module: Any, env: HeliostatEnv | Any, path: str | os.PathLike[str]) -> Path:
    """Writes `module` as an actor for the room of `env`, with the metadata that the controller needs.

    `module` maps a batch of observations, (1, n), to actions in [-1, 1], (1, m). Values beyond the bounds count as the
    nearest bound, as in the environment. The environment has the action "angles" or "weights", and the observation
    "flat" or "paper". With the action "weights" the file holds the decoder too.

    With the action "compact" and the observation "evidence", `module` maps rows of `EVIDENCE_FEATURES` values, (k, n),
    to rows of three numbers, (k, 3): one row for each user. The file then serves any number of users, any array and
    any room.

    Needs PyTorch. Raises `ValueError` for a module whose file no controller accepts.
    """
    inner = getattr(env, "unwrapped", env)
    if not isinstance(inner, HeliostatEnv):
        raise TypeError(f"expected an environment of heliostat, found {type(inner).__name__}")
    action, observation = inner.action_form, inner.observation_form
    known = _OBSERVATIONS[action]
    if observation not in known:
        names = " or ".join(f'"{name}"' for name in known)
        raise ValueError(f"observation = {observation!r}: expected {names}, which the controller gives a network "
                         f"with the action {action!r}")
    try:
        import onnx as _  # For the exporter of PyTorch.
        import torch
    except ImportError as problem:
        raise ImportError('export_onnx needs PyTorch and onnx: pip install "heliostat[export]"') from problem
    rows = inner.slots if action == "compact" else 1
    inputs, outputs = (int(np.prod(space.shape or ())) // rows for space in (inner.observation_space, inner.action_space))
    file = io.BytesIO()
    was_training = module.training
    module.eval()
    try:
        with warnings.catch_warnings(), torch.no_grad():
            # PyTorch announces that this exporter will be replaced by one that needs further
            # packages.
            warnings.simplefilter("ignore", DeprecationWarning)
            example = torch.zeros(rows, inputs)
            found, expected = tuple(module(example).shape), (rows, outputs)
            if found != expected:
                what = "one observation" if rows == 1 else f"rows of the shape {tuple(example.shape)}"
                raise ValueError(f"the module returns the shape {found} for {what}, expected {expected}")
            torch.onnx.export(
                module,
                (example,),
                file,
                input_names=["input"],
                output_names=["output"],
                dynamic_axes={"input": {0: "rows"}} if action == "compact" else None,
                opset_version=_OPSET,
                dynamo=False,
            )
    finally:
        module.train(was_training)
    actor = finish_actor(file.getvalue(), inner.scenario, action, observation, inner.slots)
    target = Path(path)
    target.write_bytes(actor)
    return target
