"""Environments, physics and policies of a MEMS mirror array for indoor optical wireless links.

>>> import gymnasium, heliostat
>>> env = gymnasium.make("heliostat/Static-v0")
>>> observation, info = env.reset(seed=1)
>>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
>>> env.close()

- `heliostat.envs`: the four environments, registered with Gymnasium by the import of the package.
- `heliostat.vector`: the same in a batch that steps on all cores.
- `heliostat.physics`: gains, rates, maps, the decoder, the oracle and policies as functions.
- `heliostat.evaluation`: scores on held-out rooms, as `heliostat-lab eval` computes them.
- `heliostat.recording`: recordings of rooms as arrays.
- `heliostat.names`: the names that parameters accept, as types for a type checker.
- `heliostat.export`: from a PyTorch module to a file that the controller runs.
- `heliostat.sb3`: the batch as a vector environment of Stable-Baselines3.
- `heliostat.controller`: a function that commands the mirrors of a room.
- `heliostat.driver`, `heliostat.tracker`: drivers and trackers in a room; `heliostat.wire`: its messages.

Angles are mechanical angles in rad, positions are in m with the origin at the centre of the floor, z up,
and rates are in Mbit/s.
"""

from . import envs as envs
from ._core import BELIEF_COLUMNS, BUILTIN_SCENARIOS, __version__, held_out_seed, policy_names
from .controller import RunSummary, run
from .envs import EnvState, HeliostatEnv
from .evaluation import Score, evaluate
from .export import export_onnx
from .physics import Policy, Room, decode, rate_map
from .recording import Recording
from .scenario import Bounds, Scenario, bounds_of, load_scenario
from .vector import HeliostatVectorEnv

__all__ = [
    "BELIEF_COLUMNS",
    "BUILTIN_SCENARIOS",
    "Bounds",
    "EnvState",
    "HeliostatEnv",
    "HeliostatVectorEnv",
    "Policy",
    "Recording",
    "Room",
    "RunSummary",
    "Scenario",
    "Score",
    "__version__",
    "bounds_of",
    "decode",
    "evaluate",
    "export_onnx",
    "held_out_seed",
    "load_scenario",
    "policy_names",
    "rate_map",
    "run",
]
