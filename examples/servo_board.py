"""A servo board in Python on a pseudo-terminal of Linux or macOS, with the protocol of docs/servo-board.md.

    python3 examples/servo_board.py --mirrors 4

It prints the path of its port for the file of a driver, and the orders to its servos. It measures angles, and its
mirrors reach them at once. With --reset SECONDS it resets at each opening of its port, loses what arrives meanwhile, and
prints two lines, as some microcontrollers do. It needs the standard library only.
"""
import argparse
import os
import pty
import select
import termios
import time
import tty

LIMIT_URAD = 523599  # 30 degrees either way
SILENCE_S = 1.0
POLL_S = 0.05


class Board:
    """Mirrors of two axes each, with their angles in urad, roll before yaw."""

    def __init__(self, mirrors):
        self.angles = [0] * (2 * mirrors)
        self.is_stopped = True

    def answer(self, line):
        """Executes a line of the host, and returns the answer."""
        word, *values = line.split() or [""]
        if word == "set":
            return self.turn(values)
        if word == "hello" and not values:
            return f"heliostat 1 {len(self.angles) // 2} {-LIMIT_URAD} {LIMIT_URAD} 1"
        if word == "get" and not values:
            return " ".join(["at", *map(str, self.angles)])
        if word == "stop" and not values:
            self.stop()
            return "ok"
        return f"error unknown line {line!r}"

    def turn(self, values):
        """Applies all angles, or none."""
        try:
            angles = [int(value) for value in values]
        except ValueError:
            return "error an angle is no decimal integer"
        if len(angles) != len(self.angles):
            return f"error {len(angles)} angles, expected {len(self.angles)}"
        for angle in angles:
            if abs(angle) > LIMIT_URAD:
                return f"error {angle} is beyond {LIMIT_URAD}"
        self.angles, self.is_stopped = angles, False
        print("turn", *angles, flush=True)
        return "ok"

    def stop(self):
        """Stops and holds; a board that has stopped stays so."""
        if not self.is_stopped:
            print("stop", flush=True)
        self.is_stopped = True


def read(port):
    """What the host has sent, nothing within a moment; None while no host has the port open."""
    if not select.select([port], [], [], POLL_S)[0]:
        return b""
    try:
        return os.read(port, 4096) or None
    except OSError:
        return None


def reset(port, duration_s):
    """What some boards do when their port opens: lines that arrive meanwhile are lost, and the board prints lines."""
    time.sleep(duration_s)
    termios.tcflush(port, termios.TCIFLUSH)
    os.write(port, b"boot 1.2\r\nready\r\n")


def serve(board, port, reset_s):
    """Answers the lines of one host after the other."""
    is_open, rest, received_s = False, b"", time.monotonic()
    while True:
        found = read(port)
        if found is not None and not is_open and reset_s > 0:
            reset(port, reset_s)
            found = b""
        is_open = found is not None
        *lines, rest = ((rest + found) if is_open else b"").split(b"\n")
        for line in lines:
            received_s = time.monotonic()
            os.write(port, board.answer(line.decode("ascii", "replace").strip()).encode() + b"\r\n")
        if time.monotonic() - received_s > SILENCE_S:
            board.stop()
        if not is_open:
            time.sleep(POLL_S)


if __name__ == "__main__":
    flags = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    flags.add_argument("--mirrors", type=int, required=True, help="number of mirrors")
    flags.add_argument("--reset", type=float, default=0.0, metavar="SECONDS", help="duration of a reset at each opening")
    given = flags.parse_args()
    master, port_of_host = pty.openpty()
    tty.setraw(port_of_host)
    print("the board is at", os.ttyname(port_of_host), flush=True)
    os.close(port_of_host)
    serve(Board(given.mirrors), master, given.reset)
