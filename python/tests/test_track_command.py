"""The command that connects a tracking system: its help, its refusals, and what it makes of its flags."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

pytest.importorskip("zenoh")
from heliostat.track import bridge
from heliostat.track.__main__ import SOURCES, main, parser, setup_of
from heliostat.track.bridge import Intake, Source
from heliostat.track.frame import about_z
from heliostat.track.users import Instant, Problems, Setup, Users
from room import LIMIT_S, python


class Silent(Source):
    """A source that delivers nothing."""

    name = "nothing"
    unit = "cm"
    clock = "aligned"

    def start(self, intake: Intake) -> None:
        pass

    def close(self) -> None:
        pass


def test_the_help_explains_each_system_and_its_flags(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, texts in (
        ([], ("--dry-run", "@FILE", *SOURCES)),
        *((([name], ("--connect", "--unit", "--axes", "--user", "--clock", "--tls")) for name in SOURCES)),
    ):
        with pytest.raises(SystemExit) as ended:
            main([*arguments, "--help"])
        shown = capsys.readouterr().out
        assert ended.value.code == 0 and all(text in shown for text in texts), shown


@pytest.mark.parametrize(
    ("flags", "reason"),
    [
        ((), "the following arguments are required"),
        (("--unit", "yard"), "invalid choice"),
        (("--origin", "1,2"), "expected 3 numbers with commas"),
        (("--user", "helmet"), "expected NAME=NUMBER"),
        (("--room-size", "8,8,0"), "expected lengths above 0"),
        (("--upright", "wand=1,0,0"), "expected 4 numbers with commas"),
        (("--axes", "up"), "expected z-up, y-up, or three axes"),
        (("--rotation", "2,0,0,0"), "length 1"),
        (("--user", "a=1", "--user", "b=1"), "two bodies"),
        (("--rate-hz", "0"), "rate 0.0"),
    ],
)
def test_flags_that_cannot_be_used_are_refused(flags: tuple[str, ...], reason: str, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("paho.mqtt.client")
    arguments = ["mqtt", *(("--broker", "127.0.0.1", "--connect", "tcp/127.0.0.1:1") if flags else ()), *flags]
    try:
        status = main(arguments)
    except SystemExit as ended:
        status = int(str(ended.code))
    assert status == 2 and reason in capsys.readouterr().err


def test_settings_that_cannot_be_used_end_with_status_2_and_no_data_with_1(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("paho.mqtt.client")
    assert main(["mqtt", "--broker", "127.0.0.1", "--port", "9"]) == 2
    assert "error: no endpoint: expected --listen or --connect" in capsys.readouterr().err
    assert main(["mqtt", "--broker", "127.0.0.1", "--port", "9", "--dry-run", "--seconds", "0.5"]) == 1
    assert "reports made: 0" in capsys.readouterr().out


def test_no_data_from_a_source_that_has_named_its_problem_is_not_named_again(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []
    intake = Intake(Users(Setup(), Problems(shown.append)))

    def at(seconds: int) -> Instant:
        moment = Instant(seconds * 10**9, seconds * 10**9)
        monkeypatch.setattr(bridge, "_now", lambda: moment)
        return moment

    silence = bridge._Silence(Silent(), intake, at(0))
    at(1)
    intake.problem("lost", "the computer does not answer")
    at(3)
    assert silence.lasts() and shown == ["the computer does not answer"]
    at(4)
    intake.poses([])
    assert not silence.lasts()
    at(7)
    advice = "check that the system is running and that its address is right"
    assert silence.lasts() and shown[1:] == [f"no data from nothing for 3 s: {advice}"]


def test_a_system_without_its_library_names_the_extra(tmp_path: Path) -> None:
    script = tmp_path / "without.py"
    hidden = "sys.modules.update({name: None for name in ('paho', 'rosbags', 'qtm_rt')})"
    script.write_text(
        f"import sys\n{hidden}\nfrom heliostat.track.__main__ import main\nsys.exit(main(sys.argv[1:]))\n", encoding="utf-8"
    )
    required = {"ros2": ("--topic", "/a"), "mqtt": ("--broker", "a"), "qtm": ("--host", "a")}
    for name in SOURCES:
        with python(script, name, *required[name], "--dry-run", folder=tmp_path) as process:
            _, errors = process.communicate(timeout=LIMIT_S)
        assert process.returncode == 2 and f'pip install "heliostat[zenoh,{name}]"' in errors, errors


def test_flags_become_a_setup(tmp_path: Path) -> None:
    file = tmp_path / "studio.txt"
    file.write_text("--axes=y-up\n--origin=-1,0.5,0\n--turn-deg=90\n--user=helmet=3\n", encoding="utf-8")
    flags = ["--offset", "0,0,0.1", "--offset", "helmet=0,0.2,0", "--upright", "wand=0,1,0,0", "--min-rate-mbps", "2"]
    given = parser().parse_args(["qtm", "--host", "a", f"@{file}", *flags, "--clock-offset-ms", "-20"])
    setup = setup_of(given, Silent())
    assert setup.frame.axes == "y-up" and setup.frame.unit_m == 0.01 and setup.frame.origin_m == (-1.0, 0.5, 0.0)
    assert setup.frame.rotation == about_z(math.pi / 2) and setup.numbers == {"helmet": 3}
    assert setup.offsets_m == {"": (0.0, 0.0, 0.1), "helmet": (0.0, 0.2, 0.0)}
    assert setup.uprights == {"wand": (0.0, 1.0, 0.0, 0.0)} and setup.min_rate_bps == 2e6
    assert setup.clock == "aligned" and setup.clock_offset_ns == -20_000_000 and setup.orientation
    given = parser().parse_args(["qtm", "--host", "a", "--unit", "in", "--clock", "arrival", "--no-orientation"])
    setup = setup_of(given, Silent())
    assert setup.frame.unit_m == 0.0254 and setup.clock == "arrival" and not setup.orientation
