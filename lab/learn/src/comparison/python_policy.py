"""Answers observations by a function in Python; heliostat-lab starts it for --policies FILE.py:FUNCTION.

Messages in little-endian order. Request: a length n of 4 bytes, then n numbers of 4 bytes; n = 0 begins an episode.
Answer: a status of 1 byte, a length of 4 bytes, then the content: 0 and numbers of 4 bytes (an action), 1 and a text in
UTF-8 (what is wrong), 2 and a text (the form of the actions; once, at the start).
"""

import importlib.util
import os
import select
import signal
import struct
import sys
import threading
import traceback

# Different problems whose lines are shown.
SHOWN_MAX = 3

# The variable names the interpreter.
file, name, variable = sys.argv[1:]
requests = os.fdopen(os.dup(0), "rb")
answers = os.fdopen(os.dup(1), "wb")
# What the function prints must not be taken for an answer.
os.dup2(2, 1)
# The end of this process flushes nothing.
sys.stdout.reconfigure(line_buffering=True)
# Ctrl-C in a terminal reaches this process too, but heliostat-lab says what it ends. A handler, in place of SIG_IGN,
# leaves the processes that the function starts as they are.
signal.signal(signal.SIGINT, lambda *_: None)


def end_with_heliostat_lab():
    """Ends this process, also while the function computes, when the pipe of the requests is closed."""
    watched = select.poll()
    watched.register(requests, select.POLLHUP)
    watched.poll()
    os._exit(0)


# Windows has no poll: there the function returns first.
if hasattr(select, "poll"):
    threading.Thread(target=end_with_heliostat_lab, daemon=True).start()


def answer(status, content):
    try:
        answers.write(struct.pack("<BI", status, len(content)) + content)
        answers.flush()
    except OSError:
        # heliostat-lab has ended.
        os._exit(0)


shown = set()


def from_user(trace):
    """The part of a traceback that begins in the file of the function; None where this program raised."""
    while trace is not None and trace.tb_frame.f_code.co_filename.startswith(("<string>", "<frozen importlib")):
        trace = trace.tb_next
    return trace


def reason(problem):
    """The text for heliostat-lab; the first time, standard error has the lines of the user's file that led there."""
    if str(problem) not in shown and len(shown) < SHOWN_MAX:
        shown.add(str(problem))
        trace = from_user(problem.__traceback__)
        # A SyntaxError names its line without a traceback.
        if trace is not None or isinstance(problem, SyntaxError):
            traceback.print_exception(type(problem), problem, trace)
    text = f"{type(problem).__name__}: {problem}".removesuffix(": ")
    if isinstance(problem, ImportError):
        text += f"; the interpreter is {sys.executable}: install what is missing there, or name another one in {variable}"
    return text.encode()


try:
    import numpy

    sys.path.insert(0, os.path.dirname(os.path.abspath(file)))
    specification = importlib.util.spec_from_file_location("policy", file)
    module = importlib.util.module_from_spec(specification)
    sys.modules["policy"] = module
    specification.loader.exec_module(module)
    act = getattr(module, name, None)
    if act is None:
        raise AttributeError(f"{file} has no function {name}")
    if not callable(act):
        raise TypeError(f"{name} is no function")
    form = getattr(act, "action", "angles")
except BaseException as problem:  # noqa: BLE001: the reason goes to heliostat-lab
    answer(1, reason(problem))
    sys.exit(0)
answer(2, str(form).encode())
while len(head := requests.read(4)) == 4:
    count = struct.unpack("<I", head)[0]
    try:
        if count == 0:
            getattr(act, "reset", lambda: None)()
            continue
        action = act(numpy.frombuffer(requests.read(4 * count), "<f4").copy())
        if action is None:
            raise TypeError(f"{name} returned None: expected an action")
        status, content = 0, numpy.ascontiguousarray(action, "<f4").reshape(-1).tobytes()
    except BaseException as problem:  # noqa: BLE001: as above, also for sys.exit
        status, content = 1, reason(problem)
    answer(status, content)
