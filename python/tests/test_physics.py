"""Physics and policies as functions."""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import heliostat
import numpy as np
import pytest
from heliostat.names import Dynamics, Quantity
from heliostat.tables import LinkResult
from room import needs_program

USERS = np.array([[1.0, 0.5, 0.85], [-1.5, 1.0, 0.85], [0.2, -1.9, 0.85]])
FLAT = np.zeros(100)
NOT_IN_THIS_ROOM = {"exhaustive": "too many assignments"}
"""The policies that the default room refuses, with the reason."""


def test_the_direct_gain_follows_the_equation_of_the_paper() -> None:
    room = heliostat.Room("paper", {"led.side_m": 0.0})
    place = np.array([[0.6, -0.8, 0.85]])
    gain = room.link(place, FLAT, FLAT)["los_gain"][0]
    text = room.scenario.to_toml()
    value = {line.split(" = ")[0]: line.split(" = ")[1] for line in text.splitlines() if " = " in line}
    offset = place[0] - np.array(room.scenario.leds_m[0])
    distance = np.linalg.norm(offset)
    cosine = -offset[2] / distance
    order = -np.log(2) / np.log(np.cos(np.radians(float(value["half_power_semi_angle_deg"]))))
    area = float(value["area_mm2"]) * 1e-6
    plain = (order + 1) * area * cosine**order * cosine / (2 * np.pi * distance**2)
    ratio = gain / plain
    further = np.array([[1.2, -1.0, 0.85]])
    offset = further[0] - np.array(room.scenario.leds_m[0])
    distance, cosine = np.linalg.norm(offset), -offset[2] / np.linalg.norm(offset)
    expected = ratio * (order + 1) * area * cosine ** (order + 1) / (2 * np.pi * distance**2)
    assert room.link(further, FLAT, FLAT)["los_gain"][0] == pytest.approx(expected, rel=1e-9)
    concentrator = float(value["concentrator_index"]) ** 2 if value["concentrator"] == "true" else 1.0
    sine = 1.0 if concentrator == 1.0 else np.sin(np.radians(float(value["fov_deg"])))
    assert ratio == pytest.approx(float(value["filter_gain"]) * concentrator / sine**2, rel=1e-9)


def test_a_tilted_receiver_has_the_cosine_of_its_own_incidence_angle() -> None:
    room = heliostat.Room("paper", {"led.side_m": 0.0})
    place = np.array([[0.6, -0.8, 0.85]])
    to_led = np.array(room.scenario.leds_m[0]) - place[0]
    to_led /= np.linalg.norm(to_led)
    normal = np.array([0.3, -0.1, 1.0])
    expected = normal @ to_led / np.linalg.norm(normal) / to_led[2]
    held: list[Any] = [normal, [7.0 * normal], None]
    gains = [room.link(place, FLAT, FLAT, normals=one)["los_gain"][0] for one in held]
    assert gains[0] / gains[2] == pytest.approx(expected, rel=1e-9) and gains[1] == pytest.approx(gains[0], rel=1e-12)
    assert room.link(place, FLAT, FLAT, normals=[0.0, 0.0, -1.0])["los_gain"][0] == 0.0


def test_receivers_face_up_without_normals_and_each_function_takes_them() -> None:
    room, policy = heliostat.Room(), heliostat.Policy("nearest")
    angles = room.decode(USERS, [0.0, 1.0, 0.0])
    calls: list[Callable[..., Any]] = [
        lambda **held: list(room.link(USERS, *angles, **held).values()),
        lambda **held: room.steering_gain(USERS, **held),
        lambda **held: room.oracle(USERS, **held),
        lambda **held: room.decode(USERS, [1.0, 2.0, 1.0], **held),
        lambda **held: heliostat.decode(USERS, [1.0, 2.0, 1.0], **held),
        lambda **held: policy.act(USERS, **held),
        lambda **held: heliostat.rate_map(room, *angles, step_m=1.0, **held),
    ]
    for call in calls:
        np.testing.assert_equal(call(normals=[0.0, 0.0, 2.0]), call())
    only_one = [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]
    served = room.link(USERS, *policy.act(USERS, normals=only_one), normals=only_one)["irs_gain"]
    aimed = room.link(USERS, *angles, normals=only_one)["irs_gain"]
    assert served[1] == pytest.approx(aimed[1], rel=0.1) and aimed[1] > 0.0


def test_a_room_with_tilted_receivers_warns_where_no_normals_are_given() -> None:
    room, users = heliostat.Room("office"), [[0.5, 0.5, 0.85]]
    flat = np.zeros(room.mirrors)
    policy = heliostat.Policy("nearest", "office")
    calls: list[Callable[..., object]] = [
        lambda **held: room.link(users, flat, flat, **held),
        lambda **held: room.steering_gain(users, **held),
        lambda **held: room.decode(users, [1.0], **held),
        lambda **held: heliostat.decode(users, [1.0], "office", **held),
        lambda **held: room.oracle(users, **held),
        lambda **held: policy.act(users, **held),
        lambda **held: heliostat.rate_map(room, flat, flat, step_m=1.0, **held),
    ]
    for call in calls:
        with pytest.warns(UserWarning, match="normals is absent, so every receiver faces up: give normals") as warned:
            call()
        assert [warning.filename for warning in warned] == [__file__]
        call(normals=[0.0, 0.0, 1.0])


def test_the_normals_of_a_state_give_the_rates_of_the_room() -> None:
    held = {"users.orientation.model": "measured"}
    env = heliostat.HeliostatEnv("specular", overrides=held)
    env.reset(seed=6)
    state = env.state()
    assert np.linalg.norm(state["normals"], axis=1) == pytest.approx(1.0)
    *_, info = env.step(np.zeros(200, np.float32))
    room = heliostat.Room("specular", held)
    tilted, upright = (
        room.link(state["positions"], FLAT, FLAT, state["blockers"], normals=normals)["rate_mbps"]
        for normals in (state["normals"], [0.0, 0.0, 1.0])
    )
    assert info["rates_mbps"] == pytest.approx(tilted, rel=1e-9)
    assert np.abs(upright - tilted).max() > 0.1
    env.close()


@pytest.mark.parametrize("dynamics", ["static", "closed-loop"])
def test_the_rates_of_a_state_are_those_of_its_places_and_angles(dynamics: Dynamics) -> None:
    env = heliostat.HeliostatEnv("specular", dynamics=dynamics, action="weights")
    room = heliostat.Room("specular")
    env.reset(seed=6)
    for _ in range(3):
        state = env.state()
        link = room.link(state["positions"], state["roll"], state["yaw"], state["blockers"])
        assert state["rates_mbps"] == pytest.approx(link["rate_mbps"], rel=1e-6)
        assert np.array_equal(state["blocked"], link["blocked"])
        env.step(np.eye(10, dtype=np.float32)[0])
    env.close()


def test_the_bounds_of_a_room_are_those_of_its_mirrors_and_users() -> None:
    bounds = heliostat.bounds_of("specular", {"room.length_x_m": 8.0, "control.range_deg": 30.0})
    assert bounds.roll_rad == bounds.yaw_rad == pytest.approx((-np.pi / 6, np.pi / 6))
    assert bounds.position_m == ((-4.0, -2.5, 0.0), (4.0, 2.5, 3.0))
    room = heliostat.Room()
    bounds = heliostat.bounds_of(room.scenario)
    assert room.link(bounds.position_m, FLAT, FLAT)["los_gain"].shape == (2,)
    drawn = np.random.default_rng(3).uniform(*bounds.position_m, (4, 3))
    assert room.link(drawn, FLAT, FLAT)["los_gain"].shape == (4,)


def test_a_cylinder_blocks_the_direct_path_of_the_user_behind_it() -> None:
    room = heliostat.Room()
    clear = room.link(USERS, FLAT, FLAT)
    blocked = room.link(USERS, FLAT, FLAT, np.array([[0.95, 0.47, 0.1, 2.5]]))
    assert clear["los_gain"].min() > 0.0
    assert blocked["blocked"].tolist() == [True, False, False] and blocked["los_gain"][0] == 0.0
    assert np.array_equal(blocked["los_gain"][1:], clear["los_gain"][1:])


def test_all_weight_on_one_user_gives_that_user_the_mirrors() -> None:
    room = heliostat.Room()
    angles = room.decode(USERS, [0.0, 1.0, 0.0])
    gains = room.link(USERS, *angles)["irs_gain"]
    assert gains[1] > 10.0 * max(gains[0], gains[2], 1e-12)
    module_angles = heliostat.decode(USERS, [0.0, 1.0, 0.0])
    assert all(np.array_equal(one, two) for one, two in zip(angles, module_angles, strict=True))
    reachable = room.steering_gain(USERS)
    assert reachable.shape == (3, 100)
    assert gains[1] == pytest.approx(reachable[1].sum(), rel=0.1)


@pytest.mark.parametrize("name", heliostat.policy_names())
def test_every_policy_decides_within_the_range_and_the_oracle_is_at_least_as_good(name: str) -> None:
    room = heliostat.Room()
    if reason := NOT_IN_THIS_ROOM.get(name):
        with pytest.raises(ValueError, match=reason):
            heliostat.Policy(name)
        return
    oracle = room.link(USERS, *room.oracle(USERS, min_rate_mbps=[0.0] * 3))["rate_mbps"].sum()
    roll, yaw = heliostat.Policy(name).act(USERS, min_rate_mbps=[0.0] * 3)
    assert roll.shape == yaw.shape == (100,)
    assert np.abs([roll, yaw]).max() <= room.scenario.range_rad * (1.0 + 1e-12)
    assert 0.0 < room.link(USERS, roll, yaw)["rate_mbps"].sum() <= oracle * (1.0 + 1e-9)


def test_the_exhaustive_search_of_a_small_room_is_no_better_than_its_oracle() -> None:
    small = {"mirrors.rows": 2, "mirrors.columns": 2, "users.count": 3}
    room = heliostat.Room("specular", small)
    best = room.link(USERS, *room.oracle(USERS, min_rate_mbps=[0.0] * 3))["rate_mbps"].sum()
    angles = heliostat.Policy("exhaustive", overrides=small).act(USERS, min_rate_mbps=[0.0] * 3)
    flat = room.link(USERS, np.zeros(4), np.zeros(4))["rate_mbps"].sum()
    assert flat < room.link(USERS, *angles)["rate_mbps"].sum() <= best * (1.0 + 1e-9)


def test_learned_policies_are_built_in_by_name() -> None:
    room = heliostat.Room()
    rate = {}
    for name in ("ddpg", "analytic", "greedy", "flat"):
        rate[name] = room.link(USERS, *heliostat.Policy(name).act(USERS))["rate_mbps"].sum()
    assert rate["ddpg"] > 0.9 * rate["greedy"] and rate["analytic"] > 0.9 * rate["greedy"]
    assert rate["greedy"] > 1.2 * rate["flat"]
    assert rate["ddpg"] != rate["greedy"] != rate["analytic"]
    assert {"ddpg", "greedy"} <= set(heliostat.policy_names())
    with pytest.raises(ValueError, match="no actor is built in for ddpg-raw"):
        heliostat.Policy("ddpg-raw", overrides={"mirrors.rows": 3})


def test_an_observation_without_users_has_an_answer_and_one_without_numbers_is_refused() -> None:
    policy = heliostat.Policy("ddpg")
    length = len(heliostat.HeliostatEnv().reset(seed=1)[0])
    # Without users the last angles stay, as in a controller.
    empty = np.zeros(length)
    empty[1060:1260] = 0.125
    assert np.concatenate(policy.answer(empty)) == pytest.approx(np.full(200, 0.125))
    with pytest.raises(ValueError, match="observation has the shape .1, .*expected 1 dimensions"):
        policy.answer(np.zeros((1, length)))
    with pytest.raises(ValueError, match="observation holds NaN or infinity, expected finite numbers"):
        policy.answer(np.full(length, np.nan))


def test_the_quantities_of_a_map_are_those_of_a_link() -> None:
    assert list(get_args(Quantity)) == list(LinkResult.__annotations__)
    assert set(heliostat.Room().link(USERS, FLAT, FLAT)) == set(get_args(Quantity))


def test_a_map_has_the_rates_of_its_points() -> None:
    room = heliostat.Room()
    angles = room.decode(USERS, [0.0, 1.0, 0.0])
    x, y, rates = heliostat.rate_map(room, *angles, step_m=0.5)
    assert rates.shape == (len(y), len(x)) == (10, 10)
    one = room.link([[x[3], y[7], 0.85]], *angles, sharing=1)
    assert rates[7, 3] == pytest.approx(one["rate_mbps"][0], rel=1e-12)
    with pytest.raises(ValueError, match="quantity"):
        heliostat.rate_map(room, *angles, quantity="speed")  # type: ignore[arg-type]


@needs_program
@pytest.mark.parametrize("seconds", [0.0, 7.5])
def test_a_map_with_the_blockers_of_the_room_is_that_of_the_command_line(seconds: float, tmp_path: Path) -> None:
    lab = str(Path(os.environ["HELIOSTAT_PROGRAM"]).with_name("heliostat-lab"))
    command = [lab, "map", "--scenario", "specular", "--array", "flat", "--step-cm", "50", "--at-seconds", str(seconds)]
    done = subprocess.run([*command, "--out", str(tmp_path / "map.svg"), "--json"], check=True, capture_output=True, text=True)
    drawn = json.loads(done.stdout)
    env = heliostat.HeliostatEnv("specular", settle_s=seconds)
    env.reset(seed=env.scenario.seed)
    blockers, sharing = env.state()["blockers"], env.scenario.users
    room = heliostat.Room("specular")
    _, _, rates = heliostat.rate_map(room, FLAT, FLAT, step_m=0.5, sharing=sharing, blockers=blockers)
    found = [rates.min(), rates.mean(), rates.max()]
    assert rates.size == drawn["points"] and found == pytest.approx([drawn["min"], drawn["mean"], drawn["max"]], rel=1e-9)
    _, _, free = heliostat.rate_map(room, FLAT, FLAT, step_m=0.5, sharing=sharing)
    assert free.mean() > rates.mean()


def test_arguments_outside_their_domain_are_refused_with_the_reason() -> None:
    room = heliostat.Room()
    nan = USERS.copy()
    nan[1, 2] = np.nan
    misspelt: Any = "snrr"
    for call, reason in [
        (lambda: room.link(USERS[:, :2], FLAT, FLAT), "positions has the shape"),
        (lambda: room.link(USERS[0], FLAT, FLAT), "expected 2 dimensions"),
        (lambda: room.link(np.zeros((0, 3)), FLAT, FLAT), "holds no user"),
        (lambda: room.link(nan, FLAT, FLAT), "positions holds NaN"),
        (lambda: room.link(USERS, FLAT[:9], FLAT), "roll has the length 9, expected 100"),
        (lambda: room.link(USERS, FLAT + 45.0, FLAT), "roll holds 45 at index 0: expected radians from -pi/2 to pi/2"),
        (lambda: heliostat.rate_map(room, FLAT, FLAT - 2.0), "yaw holds -2 at index 0: expected radians"),
        (lambda: room.link(USERS, FLAT, FLAT, np.zeros((1, 3))), "blockers has the shape"),
        (lambda: room.link(USERS, FLAT, FLAT, [[0.0, 0.0, -0.1, 2.0]]), "blockers holds the radius -0.1, expected metres"),
        (lambda: room.link(USERS, FLAT, FLAT, normals=USERS[:2]), r"normals has the shape \(2, 3\), expected \(3, 3\), one"),
        (lambda: room.link(USERS, FLAT, FLAT, normals=[0.0, 1.0]), r"normals has the shape \(2,\), .* or \(3,\), one for all"),
        (lambda: room.steering_gain(USERS, normals=0.0 * USERS), "normals holds a vector of length 0 for user 0, expected"),
        (lambda: room.decode(USERS, [1.0] * 3, normals=nan), "normals holds NaN, expected finite numbers"),
        (lambda: room.oracle(USERS, [[0.0, 0.0, 0.1, -2.0]]), "blockers holds the height -2, expected metres from 0"),
        (lambda: room.link(USERS, FLAT, FLAT, sharing=0), "sharing = 0"),
        (lambda: room.decode(USERS, [1.0, -1.0, 0.0]), "weights holds -1"),
        (lambda: room.oracle(USERS, min_rate_mbps=[1.0, -1.0, 0.0]), "min_rate_mbps holds -1, expected 0 or more"),
        (lambda: heliostat.Policy("greedy").act(USERS, min_rate_mbps=-np.ones(3)), "min_rate_mbps holds -1, expected 0"),
        (lambda: room.link(USERS, FLAT, FLAT, sharing=-1), "sharing = -1: expected an integer from 1"),
        (lambda: heliostat.rate_map(room, FLAT, FLAT, step_m=0.0), "step_m = 0.0: expected a positive number"),
        (lambda: heliostat.rate_map(room, FLAT, FLAT, step_m=1e-6), "2.5e.13 points in this room, expected at most"),
        (lambda: heliostat.rate_map(room, FLAT, FLAT, step_m=1e9), "step_m = 1000000000.0: expected .* below 10"),
        (lambda: heliostat.rate_map(room, FLAT, FLAT, height_m=9), "height_m = 9.0: expected a number of metres from 0 to 3"),
        (lambda: heliostat.rate_map(room, FLAT, FLAT, quantity=misspelt), "expected one of .*; a similar name exists: sinr$"),
        (lambda: heliostat.Policy("gready"), 'unknown policy "gready": .* a similar name exists: greedy$'),
        (lambda: heliostat.Policy("none.onnx"), "none.onnx"),
    ]:
        with pytest.raises(ValueError, match=reason):
            call()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize("place", [[9.0, 0.5, 0.85], [0.0, -2.6, 0.85], [0.0, 0.0, -0.1], [0.0, 0.0, 3.1]])
def test_a_user_outside_the_room_is_refused_by_its_number_and_place(place: list[float]) -> None:
    room, users = heliostat.Room(), [[2.5, -2.5, 0.0], place]
    expected = (
        f"user 1 at ({place[0]:g}, {place[1]:g}, {place[2]:g}) is outside the room: expected x from -2.5 to 2.5 m, "
        "y from -2.5 to 2.5 m, z from 0 to 3 m"
    )
    calls: list[Callable[[], object]] = [
        lambda: heliostat.Policy("nearest").act(users),
        lambda: room.link(users, FLAT, FLAT),
        lambda: room.steering_gain(users),
        lambda: room.decode(users, [1.0, 1.0]),
        lambda: room.oracle(users),
    ]
    for call in calls:
        with pytest.raises(ValueError, match=re.escape(expected)):
            call()


def test_a_map_in_parts_equals_one_evaluation_of_all_places(monkeypatch: pytest.MonkeyPatch) -> None:
    room = heliostat.Room("office")
    angles = np.random.default_rng(2).uniform(-0.2, 0.2, (2, room.mirrors))
    complete = heliostat.rate_map(room, *angles, step_m=0.5, normals=[0.0, 0.0, 1.0])
    monkeypatch.setattr("heliostat.physics._PLACES_AT_ONCE", 7)
    in_parts = heliostat.rate_map(room, *angles, step_m=0.5, normals=[0.0, 0.0, 1.0])
    assert all(np.array_equal(one, two) for one, two in zip(complete, in_parts, strict=True))
    assert complete[2].size > 14 and complete[2].max() > complete[2].min()
    with pytest.raises(ValueError, match="quantity = 'rate': expected one of los_gain"):
        heliostat.rate_map(room, *angles, quantity="rate")  # type: ignore[arg-type]


def test_more_users_than_memory_allows_are_refused() -> None:
    room = heliostat.Room()
    with pytest.raises(ValueError, match="positions holds 400000 users, expected at most 335544 at once"):
        room.link(np.tile(USERS[:1], (400_000, 1)), FLAT, FLAT)
    for call in (room.oracle, heliostat.Policy("greedy").act):
        with pytest.raises(ValueError, match="positions holds 65 users, expected at most 64"):
            call(np.tile(USERS[:1], (65, 1)))
    with pytest.raises(ValueError, match="positions: dtype complex128, expected real numbers"):
        room.link(USERS.astype(complex), FLAT, FLAT)


def test_arguments_of_another_type_are_refused_with_the_expected_one() -> None:
    wrong: Any = [1]
    wrong_value: Any = object()
    name: Any = "specular"
    for call, reason in [
        (lambda: heliostat.Room("specular", wrong), "overrides: expected a mapping .*, found list"),
        (lambda: heliostat.Room("specular", {"users.count": wrong_value}), "users.count is of the type object"),
        (lambda: heliostat.rate_map(name, FLAT, FLAT), "room: expected a Room, found str"),
        (lambda: heliostat.Scenario("specular", wrong), "overrides: expected a mapping .*, found list"),
        (lambda: heliostat.evaluate(wrong, 3), "act: expected a function of an observation, found list"),
        (lambda: heliostat.evaluate(lambda seen: seen, 3), "expected an environment of heliostat, found int"),
    ]:
        with pytest.raises(TypeError, match=reason):
            call()  # type: ignore[no-untyped-call]
    assert heliostat.load_scenario("specular", {"users.count": np.int64(3)}).users == 3  # type: ignore[dict-item]
    for overrides in ({"users.count": 3}, ["users.count=3"]):
        assert heliostat.Scenario("specular", overrides).users == 3
    assert heliostat.Scenario("specular").hash == heliostat.Scenario("specular", None).hash
