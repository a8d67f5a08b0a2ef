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


def export_onnx(module: Any, env: HeliostatEnv | Any, path: str | os.PathLike[str]) -> Path:
    """Writes `module` as an actor for the room of `env`, with the metadata that the controller needs.

    `module` maps a batch of observations, (1, n), to actions in [-1, 1], (1, 2 M). Values beyond the bounds count as
    the nearest bound, as in the environment. The environment has the action "angles", and the observation "flat" or
    "paper". Needs PyTorch. Raises `ValueError` for a module whose file no controller accepts.
    """
    inner = env.unwrapped
    if not isinstance(inner, HeliostatEnv):
        raise TypeError(f"expected an environment of heliostat, found {type(inner).__name__}")
    if inner.action_form != "angles":
        raise ValueError(
            f"action = {inner.action_form!r}: a file that the controller runs gives angles; "
            'train in an environment with action="angles"'
        )
    if inner.observation_form not in ("flat", "paper"):
        raise ValueError(
            f'observation = {inner.observation_form!r}: expected "flat" or "paper", which the controller can give'
        )
    try:
        import torch
    except ImportError as problem:
        raise ImportError('export_onnx needs PyTorch: pip install "heliostat[export]"') from problem
    length = int(np.prod(inner.observation_space.shape or ()))
    file = io.BytesIO()
    was_training = module.training
    module.eval()
    try:
        with warnings.catch_warnings(), torch.no_grad():
            # PyTorch announces that this exporter will be replaced by one that needs further packages.
            warnings.simplefilter("ignore", DeprecationWarning)
            example = torch.zeros(1, length)
            found = tuple(module(example).shape)
            expected = (1, *(inner.action_space.shape or ()))
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
    actor = finish_actor(file.getvalue(), inner.scenario, inner.observation_form, inner.slots)
    target = Path(path)
    target.write_bytes(actor)
    return target
