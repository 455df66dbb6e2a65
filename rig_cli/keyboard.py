"""The keys of a running test: p pause, r resume, a abort, n TEXT a note, Enter confirms a prompt."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Callable
from types import TracebackType

from daq.errors import ProcedureError
from daq.guided_tests.controls import Controls
from rig_basics.ignoring import ignoring
from rig_cli.console import notify

KEYS = "p pause   r resume   a abort   n note   Ctrl-C stop"
_POLL_S = 0.1  # s between two reads of the keyboard
_log = logging.getLogger(__name__)


class Keys:
    """Meaning of the keys.

    Args:
        controls: of the running test.

    Attributes:
        typed: the note being written; None without one.
        confirmed: set by Enter outside a note.
        aborted: set by the key a.
    """

    def __init__(self, controls: Controls) -> None:
        self._controls = controls
        self.typed: str | None = None
        self.confirmed: threading.Event = threading.Event()
        self.aborted: threading.Event = threading.Event()

    def press(self, key: str) -> None:
        """Handle one key; keys without a meaning are ignored."""
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
    """Context in which the terminal's keys are read; without a terminal it does nothing.

    Args:
        keys: receives the keys.
    """

    def __init__(self, keys: Keys) -> None:
        self.keys: Keys = keys
        self.there: bool = sys.stdin.isatty()
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
            elsewhere: whether a prompt can also be confirmed elsewhere, on the live page.
        Raises:
            ProcedureError: standard input is not a terminal, and prompts cannot be confirmed elsewhere.
        """
        notify(f">>> {text}")
        if not self.there and not elsewhere:
            raise ProcedureError(
                f"{text}: standard input is not a terminal, so no key can be pressed. Run the test in a terminal"
            )
        self.keys.confirmed.clear()
        while not self.keys.confirmed.wait(_POLL_S) and not self.keys.aborted.is_set():
            pass

    def _read(self) -> None:
        with ignoring(_log, "reading the keyboard", OSError, ValueError):  # the terminal is closed: no more keys
            while not self._ending.is_set():
                if key := _key(_POLL_S):
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
        """Switch the terminal to single keys without echo, Ctrl-C unchanged; returns the function that restores it."""
        descriptor = sys.stdin.fileno()
        before = termios.tcgetattr(descriptor)
        tty.setcbreak(descriptor)
        return lambda: termios.tcsetattr(descriptor, termios.TCSADRAIN, before)

    _pending = bytearray()  # incomplete bytes of a character

    def _key(wait_s: float) -> str:
        """Return the next key; empty after `wait_s` without one."""
        ready, _, _ = select.select([sys.stdin], [], [], wait_s)
        if not ready:
            return ""
        if not (data := os.read(sys.stdin.fileno(), 1)):
            raise OSError("the terminal is closed")
        _pending.extend(data)
        try:
            key = _pending.decode()
        except UnicodeDecodeError:  # usual: a part of a character
            if len(_pending) > 4:
                _pending.clear()
            return ""
        _pending.clear()
        return key


class TerminalOperator:
    """Prompts the person at the terminal. The test continues when the sensors show that the action was done.

    Args:
        keyboard: confirms what no sensor detects.
        notify: called with each prompt too, for a page next to the terminal.
        elsewhere: whether a prompt can also be confirmed on that page.
    """

    def __init__(
        self, keyboard: Keyboard, notify: Callable[[str], None] = lambda text: None, elsewhere: bool = False
    ) -> None:
        self._keyboard, self._notify, self._elsewhere = keyboard, notify, elsewhere

    def _prompt(self, text: str) -> None:
        self._notify(text)
        notify(f">>> {text}")

    def place(self, device: str, mm: float | None) -> None:
        """See daq.calibration.sensor.PlacesTargets."""
        if mm is None:
            self._prompt("the readings are complete: remove the block or withdraw the micrometer")
            return
        text = f"bring the target of {device} to {mm:.4f} mm, from the side of the last position; Enter when it rests"
        self._notify(text)
        self._keyboard.confirm(text, self._elsewhere)
        if self._keyboard.keys.aborted.is_set():
            raise ProcedureError("aborted by the key a")

    def turn_pendulum(self, pendulum: int) -> None:
        """See daq.calibration.encoder.TurnsPendulums."""
        name = "AB"[pendulum]
        self._prompt(f"turn pendulum {name} alone, counter-clockwise seen from +z, by about a quarter of a turn")

    def pluck(self, axis: str) -> None:
        """See daq.guided_tests.hands.Operator."""
        self._prompt(f"displace the column by 2 to 3 mm along {axis} and release it")

    def flick(self) -> None:
        """See daq.guided_tests.hands.Operator."""
        self._prompt("flick both pendulums, slower than two turns a second")

    def scatter(self) -> None:
        """See daq.guided_tests.hands.Operator."""
        self._prompt("leave both pendulums or balls anywhere, at another place each time, and take your hands off")

    def lock(self, seen: bool) -> None:
        """See daq.guided_tests.hands.Operator."""
        self._prompt("the rotor at rest: lock both pendulums, A at 0° and B at 180°")
        if not seen:
            text = "no encoder measures the pendulums: press Enter when both are locked"
            self._notify(text)
            self._keyboard.confirm(text, self._elsewhere)

    def release(self) -> None:
        """See daq.guided_tests.hands.Operator."""
        self._prompt("release both pendulums, both at once")

    def turn(self, rpm: float, ramp_rpm_per_s: float) -> None:
        """See daq.guided_tests.hands.Operator."""
        if rpm:
            self._prompt(
                f"turn the rotor to {rpm:.0f} rpm, by about {ramp_rpm_per_s:.0f} rpm a second, and hold it there"
            )
        else:
            self._prompt(f"bring the rotor to rest, by about {ramp_rpm_per_s:.0f} rpm a second")
