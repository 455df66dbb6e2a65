# pyright: strict
"""The keys of a running test: p pause, r resume, a abort, n TEXT a note, Enter when something asked for is done."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable
from types import TracebackType

from rig_cli.console import say
from daq.errors import ProcedureError
from daq.guided_tests.controls import Controls

KEYS = "p pause   r resume   a abort   n note   Ctrl-C stop"
_TURN_S = 0.1  # wall s between two looks for a key


class Keys:
    """What keys mean.

    Args:
        controls: of the running test.

    Attributes:
        typed: the note that is being written; None when none is.
        confirmed: set by Enter outside a note.
    """

    def __init__(self, controls: Controls) -> None:
        self._controls = controls
        self.typed: str | None = None
        self.confirmed = threading.Event()
        self.aborted = threading.Event()

    def press(self, key: str) -> None:
        """One key; those without a meaning are passed over."""
        if self.typed is not None:
            self._write(key)
        elif key in "\r\n":
            self.confirmed.set()
        elif key == "p":
            self._controls.pause()
        elif key == "r":
            self._controls.resume()
        elif key == "a":
            self._controls.abort("by the key a")
            self.aborted.set()
        elif key == "n":
            self.typed = ""

    def _write(self, key: str) -> None:
        typed = self.typed or ""
        if key in "\r\n":
            if typed.strip():
                self._controls.note(typed.strip())
            self.typed = None
        elif key == "\x1b":  # Esc: no note
            self.typed = None
        elif key in "\x08\x7f":
            self.typed = typed[:-1]
        elif key.isprintable():
            self.typed = typed + key


class Keyboard:
    """The keys of a terminal, as long as the context lasts; where there is no terminal, nothing.

    Args:
        keys: who is given them.
    """

    def __init__(self, keys: Keys) -> None:
        self.keys = keys
        self.there = sys.stdin.isatty()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._read, name="keyboard", daemon=True)
        self._restore: Callable[[], None] = lambda: None

    def __enter__(self) -> Keyboard:
        if self.there:
            self._restore = _single_keys()
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending.set()
        if self.there:
            self._thread.join()
            self._restore()

    def confirm(self, text: str, elsewhere: bool = False) -> None:
        """Wait for Enter, or for an abort.

        Args:
            elsewhere: whether somebody may confirm by something else than this keyboard.
        Raises:
            ProcedureError: no terminal is there to press it at.
        """
        say(f">>> {text}")
        if not self.there and not elsewhere:
            raise ProcedureError(f"{text}: standard input is no terminal, so nobody can. Run the test in a terminal")
        self.keys.confirmed.clear()
        while not self.keys.confirmed.wait(_TURN_S) and not self.keys.aborted.is_set():
            pass

    def _read(self) -> None:
        with contextlib.suppress(OSError, ValueError):  # the terminal has gone: nobody presses keys any more
            while not self._ending.is_set():
                if key := _key(_TURN_S):
                    self.keys.press(key)


if sys.platform == "win32":
    import msvcrt

    def _single_keys() -> Callable[[], None]:
        return lambda: None

    def _key(wait_s: float) -> str:
        if msvcrt.kbhit():
            return msvcrt.getwch()
        threading.Event().wait(wait_s)
        return ""
else:
    import os
    import select
    import termios
    import tty

    def _single_keys() -> Callable[[], None]:
        """Have the terminal hand over each key at once, unseen; returns what undoes it. Ctrl-C stays as it is."""
        descriptor = sys.stdin.fileno()
        before = termios.tcgetattr(descriptor)
        tty.setcbreak(descriptor)
        return lambda: termios.tcsetattr(descriptor, termios.TCSADRAIN, before)

    _left = bytearray()  # of a letter of several bytes

    def _key(wait_s: float) -> str:
        """The next key; empty when none comes in time."""
        ready, _, _ = select.select([sys.stdin], [], [], wait_s)
        if not ready:
            return ""
        if not (data := os.read(sys.stdin.fileno(), 1)):
            raise OSError("the terminal has gone")
        _left.extend(data)
        with contextlib.suppress(UnicodeDecodeError):
            key = _left.decode()
            _left.clear()
            return key
        if len(_left) > 4:
            _left.clear()
        return ""


class TerminalOperator:
    """Asks the person at the terminal; the test goes on when the sensors see that it was done.

    Args:
        keyboard: where a person confirms what no sensor sees.
        told: is told too what is asked for, as a page beside the terminal.
        elsewhere: whether a person may confirm there too.
    """

    def __init__(
        self, keyboard: Keyboard, told: Callable[[str], None] = lambda text: None, elsewhere: bool = False
    ) -> None:
        self._keyboard, self._told, self._elsewhere = keyboard, told, elsewhere

    def _ask(self, text: str) -> None:
        self._told(text)
        say(f">>> {text}")

    def pluck(self, axis: str) -> None:
        """See daq.guided_tests.hands.Operator."""
        self._ask(f"displace the column by 2 to 3 mm along {axis} and let go")

    def flick(self) -> None:
        """See daq.guided_tests.hands.Operator."""
        self._ask("flick both pendulums, slower than two turns a second")

    def scatter(self) -> None:
        """See daq.guided_tests.hands.Operator."""
        self._ask("leave both pendulums or balls anywhere, elsewhere each time, and take your hands off")

    def lock(self, seen: bool) -> None:
        """See daq.guided_tests.hands.Operator."""
        self._ask("the rotor at rest: lock both pendulums, A at 0° and B at 180°")
        if not seen:
            text = "no encoder sees the pendulums: press Enter when both are locked"
            self._told(text)
            self._keyboard.confirm(text, self._elsewhere)

    def release(self) -> None:
        """See daq.guided_tests.hands.Operator."""
        self._ask("release both pendulums, both at once")

    def turn(self, rpm: float, ramp_rpm_per_s: float) -> None:
        """See daq.guided_tests.hands.Operator."""
        if rpm:
            self._ask(f"turn the rotor to {rpm:.0f} rpm, by about {ramp_rpm_per_s:.0f} rpm a second, and hold it there")
        else:
            self._ask(f"bring the rotor to rest, by about {ramp_rpm_per_s:.0f} rpm a second")
