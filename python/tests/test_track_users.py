"""From poses to reports: rates, presence, clocks, and the poses that are left out. Time is an argument here."""

from __future__ import annotations

import math
from typing import Any

import pytest
from heliostat import wire

pytest.importorskip("zenoh")
from heliostat.track.frame import Frame
from heliostat.track.users import Clock, Instant, Pose, Problems, Report, Setup, Users

MS = 1_000_000
SECOND = 1_000_000_000
UTC = 1_767_323_045 * SECOND


def at(ms: float) -> Instant:
    return Instant(round(ms * MS), UTC + round(ms * MS))


def users(**setup: Any) -> tuple[Users, list[str]]:
    shown: list[str] = []
    one = Users(Setup(**setup), Problems(shown.append))
    one.room_m = (8.0, 6.0, 3.0)
    return one, shown


def helmet(x: float = 1.0, **more: Any) -> Pose:
    return Pose("helmet", (x, 0.5, 0.85), **more)


def positions(report: Report | None) -> dict[int, float]:
    assert report is not None
    return {one.user: one.position_m[0] for one in report.users}


def test_of_a_system_with_100_frames_a_second_the_newest_pose_is_reported_20_times_a_second() -> None:
    one, _ = users(rate_hz=20.0)
    reports = []
    for frame in range(100):
        one.take([helmet(frame / 1000, time_ns=None)], at(10 * frame))
        if report := one.report(at(10 * frame)):
            reports.append((frame, report))
    assert [frame for frame, _ in reports] == list(range(0, 100, 5))
    assert all(positions(report) == {0: frame / 1000} for frame, report in reports)
    assert all(report.time_ns == UTC + 10 * frame * MS for frame, report in reports)


def test_a_slow_system_is_reported_at_its_own_rate_without_repetitions() -> None:
    one, _ = users(rate_hz=20.0)
    counts = []
    for ms in range(0, 1000, 5):
        if ms % 200 == 0:
            one.take([helmet()], at(ms))
        counts.append(one.report(at(ms)) is not None)
        assert counts[-1] or one.wait_ns(at(ms)) > 0, "the wait must not be busy"
    assert sum(counts) == 5


def test_bodies_that_arrive_within_10_ms_share_a_report_and_a_missing_one_delays_it_no_longer() -> None:
    one, _ = users()
    one.take([helmet(1.0)], at(0))
    one.take([Pose("tag", (2.0, 0.0, 1.0))], at(0))
    assert positions(one.report(at(0))) == {0: 1.0, 1: 2.0}
    one.take([helmet(1.1)], at(60))
    assert one.report(at(61)) is None and one.wait_ns(at(61)) == 9 * MS
    one.take([Pose("tag", (2.1, 0.0, 1.0))], at(65))
    assert positions(one.report(at(65))) == {0: 1.1, 1: 2.1}
    one.take([helmet(1.2)], at(120))
    assert one.report(at(129)) is None
    assert positions(one.report(at(130))) == {0: 1.2, 1: 2.1}


def test_a_body_that_is_lost_leaves_while_the_system_works_and_keeps_its_number() -> None:
    one, _ = users(timeout_s=0.5)
    both = [helmet(), Pose("tag", (2.0, 0.0, 1.0))]
    one.take(both, at(0))
    assert positions(one.report(at(0))) == {0: 1.0, 1: 2.0}
    one.take(both[1:], at(400))
    assert positions(one.report(at(410))) == {0: 1.0, 1: 2.0}
    one.take(both[1:], at(600))
    assert positions(one.report(at(610))) == {1: 2.0}
    one.take([], at(1200))
    report = one.report(at(1200))
    assert positions(report) == {} and report is not None and report.time_ns == at(1200).utc_ns
    one.take([both[0], Pose("third", (0.0, 0.0, 1.0))], at(1300))
    assert positions(one.report(at(1310))) == {0: 1.0, 2: 0.0}


def test_a_system_that_is_silent_is_no_empty_room() -> None:
    one, _ = users(timeout_s=0.5)
    one.take([helmet()], at(0))
    assert one.report(at(0)) is not None
    assert all(one.report(at(ms)) is None for ms in range(10, 5000, 10))


def test_poses_that_cannot_be_used_are_no_empty_room() -> None:
    one, shown = users(timeout_s=0.5)
    for ms in range(0, 2000, 50):
        one.take([helmet(100.0)], at(ms))
        assert one.report(at(ms)) is None and one.wait_ns(at(ms)) > 0
    one.take([], at(3000))
    assert positions(one.report(at(3000))) == {}
    assert one.problems.counts["outside-room"] == 40 and len(shown) == 1


@pytest.mark.parametrize(
    ("position", "hint"),
    [
        ((1500.0, 500.0, 850.0), "with --unit mm it would be at (1.500, 0.500, 0.850) m"),
        ((150.0, 50.0, 85.0), "with --unit cm it would be at (1.500, 0.500, 0.850) m"),
        ((1.5, 0.85, -2.9), "with --axes y-up it would be at (1.500, 2.900, 0.850) m"),
        ((1500.0, 850.0, -2900.0), "with --unit mm --axes y-up it would be at (1.500, 2.900, 0.850) m"),
        ((1e9, 0.0, 0.0), "check --unit, --axes, --origin and --turn-deg"),
    ],
)
def test_a_pose_outside_the_room_is_left_out_with_the_unit_and_the_axes_that_fit(position: Any, hint: str) -> None:
    one, shown = users()
    one.take([Pose("helmet", position)], at(0))
    assert one.report(at(20)) is None
    assert "outside the room of 8 m x 6 m x 3 m" in shown[0] and hint in shown[0], shown


def test_a_pose_beyond_a_wall_by_less_than_the_margin_of_the_controller_is_reported() -> None:
    one, shown = users()
    one.take([helmet(4.9)], at(0))
    assert positions(one.report(at(0))) == {0: 4.9}
    one.take([helmet(5.1)], at(100))
    assert one.report(at(120)) is None and "outside" in shown[0]


def test_positions_and_orientations_that_are_no_numbers_are_named() -> None:
    one, shown = users()
    one.take([Pose("tag", (math.nan, 0.0, 1.0))], at(0))
    assert one.report(at(20)) is None and '"tag" has the position (nan, 0.000, 1.000): expected numbers' in shown[0]
    one.take([helmet(rotation=(0.0, 0.0, 0.0, 0.0))], at(100))
    report = one.report(at(120))
    assert positions(report) == {1: 1.0} and report is not None and report.orientations == []
    assert 'the orientation of "helmet" is left out' in shown[1]


def test_orientations_have_the_form_of_the_contract_and_can_be_left_out() -> None:
    tilt = (math.cos(0.1), 0.0, math.sin(0.1), 0.0)
    for wanted in (True, False):
        one, _ = users(orientation=wanted)
        one.take([helmet(rotation=tilt), Pose("tag", (2.0, 0.0, 1.0))], at(0))
        report = one.report(at(0))
        assert report is not None and len(report.users) == 2
        assert [entry["user"] for entry in report.orientations] == ([0] if wanted else [])
        stamp = {"source": 1, "sequence": 1, "time_ns": report.time_ns}
        wire.encode({"stamp": stamp, "users": report.orientations}, wire.KINDS["orientation"])


def test_only_named_bodies_are_users_where_names_are_given() -> None:
    one, shown = users(numbers={"helmet": 7}, offsets_m={"": (0.0, 0.0, 0.5), "helmet": (0.0, 0.0, -0.1)})
    one.take([helmet(), Pose("wand", (0.0, 0.0, 1.0))], at(0))
    report = one.report(at(20))
    assert report is not None and positions(report) == {7: 1.0}
    assert report.users[0].position_m[2] == pytest.approx(0.75)
    assert shown == ['"wand" is no user: expected "helmet"']


@pytest.mark.parametrize(
    ("offset_ms", "named"),
    [(0, None), (40, None), (-900, None), (60, "0.060 s ahead of"), (-1100, "1.100 s behind"), (-3.6e6, "3600.000 s behind")],
)
def test_a_clock_that_is_not_synchronised_is_named(offset_ms: float, named: str | None) -> None:
    one, shown = users(clock="source")
    one.take([helmet(time_ns=at(100 + offset_ms).utc_ns)], at(100))
    report = one.report(at(120))
    if named is None:
        assert report is not None and report.time_ns == at(100 + offset_ms).utc_ns and not shown
    else:
        assert report is None and named in shown[0] and "--clock arrival" in shown[0]


def test_a_clock_offset_corrects_the_time_of_the_source() -> None:
    one, _ = users(clock="source", clock_offset_ns=3600 * SECOND)
    one.take([helmet(time_ns=at(100).utc_ns - 3600 * SECOND)], at(110))
    report = one.report(at(130))
    assert report is not None and report.time_ns == at(100).utc_ns


def test_an_aligned_clock_removes_the_jitter_of_the_transport_and_follows_a_restart() -> None:
    clock = Clock("aligned", 0)
    delays = [3, 9, 4, 25, 2, 14, 30, 5] * 20
    for frame, delay in enumerate(delays):
        stamp = 7 * SECOND + 10 * frame * MS
        utc = clock.utc_ns(stamp, at(10 * frame + delay))
        if frame > 8:
            assert utc == at(10 * frame + 2).utc_ns, "the smallest delay, 2 ms, is in every time"
    # The measurement starts again at 0.
    assert clock.utc_ns(0, at(5000)) == at(5000).utc_ns
    # A clock that runs ahead by 100 ppm is followed: old minima end after 20 s.
    for second in range(6, 120):
        utc = clock.utc_ns(round((second - 5) * SECOND * 1.0001), at(1000 * second))
    assert abs(utc - at(119_000).utc_ns) <= 21 * SECOND // 10_000


def test_a_pose_that_another_one_has_overtaken_is_left_out() -> None:
    one, _ = users(clock="source")
    one.take([helmet(1.0, time_ns=at(50).utc_ns)], at(60))
    one.take([helmet(0.9, time_ns=at(40).utc_ns)], at(61))
    assert positions(one.report(at(80))) == {0: 1.0} and one.problems.counts["overtaken"] == 1


def test_more_bodies_than_a_report_can_have_are_named() -> None:
    one, shown = users()
    one.take([Pose(f"tag {index}", (0.0, 0.0, 1.0)) for index in range(70)], at(0))
    report = one.report(at(20))
    assert report is not None and len(report.users) == 64 and "at most 64 users" in shown[0]
    one.take([Pose(f"other {index}", (0.0, 0.0, 1.0)) for index in range(5000)], at(100))
    assert any("4096 other names" in text for text in shown)


def test_a_problem_is_shown_at_once_and_then_each_10_s_with_its_count() -> None:
    shown: list[str] = []
    problems = Problems(shown.append)
    for ms in range(0, 25_000, 100):
        problems.note("lost", f"lost at {ms} ms", at(ms))
    assert shown == ["lost at 0 ms", "lost at 10000 ms (99 more of this kind)", "lost at 20000 ms (99 more of this kind)"]
    assert problems.counts["lost"] == 250 and problems.latest == "lost at 24900 ms"


@pytest.mark.parametrize(
    ("setup", "reason"),
    [
        ({"rate_hz": 0.0}, "rate"),
        ({"timeout_s": math.nan}, "timeout"),
        ({"clock": "sun"}, "clock"),
        ({"min_rate_bps": -1.0}, "minimum rate"),
        ({"numbers": {"a": 1, "b": 1}}, "two bodies"),
        ({"numbers": {"a": 2**32}}, "2\\^32"),
        ({"uprights": {"": (0.0, 0.0, 0.0, 0.0)}}, "length 1"),
    ],
)
def test_a_setup_that_cannot_be_used_is_refused(setup: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        Setup(**setup)
    with pytest.raises(ValueError, match="unit"):
        Frame(unit_m=math.inf)
