"""Every complete `rig …` command of the pages is carried out, in a folder that contains a demo's out/demo:

    python -m tests.run_documented_commands [WORD]     # only pages with this word in their path

`make commands` does so. Each page has a folder of its own with the files that it takes for granted. What does not end
by itself (a server, a test that waits for a hand) is interrupted as by Ctrl-C, and so is what is long (a demo, a
study), which runs to its end only with RIG_TESTS_THOROUGH=1. A command that a page indents twice is given when the one
before it prompts for it. `rig devices` searches the ports of this machine.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Sequence, Set
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.io

from daq import load_run
from tests.effort import cases
from tests.studies.small_maps import dask_processes
from tests.studies.test_dask_studies import free_port
from tests.test_documented_commands import PAGES, ROOT, in_blocks, text_of

LIMIT_S, ENDING_S, STARTING_S = 60.0, 15.0, 90.0
LONG_LIMIT_S, ENDLESS_LIMIT_S = cases(5, 7200), 5
LONG = re.compile(
    r"rig (?:(?:basins|bench|demo|map|reproduce|study|track LOG|driver check tilt --thorough)\b"
    r"|test \S+ \w(?!.*--plan)|record .*--duration)"
)
ENDLESS = re.compile(
    r"rig (?:calibrate|live|check .*--tap|record (?!.*(?:--until-silent|--duration))|replay .*--to"
    r"|test \S+ (?:ring|spin)-down|test .*--live)"
)
AT_A_PROMPT = re.compile(r"^ {8}(rig virtual .*)$", re.MULTILINE)
PROMPT, PROMPT_LIMIT_S = ">>> ", 300.0  # a test with prompts runs to its end
ORDERLY = {0, 130, -signal.SIGINT}  # after Ctrl-C, which may come while Python ends; a shell shows 130 then, too
NOT_CARRIED_OUT = {"tls://SCHEDULER": "needs machines with certificates; see tests/studies/test_dask_over_tls.py"}
OWN_CODES = {
    "rig devices --ask --port": {3},  # this machine has no such ports
    "rig check": {0, 3},  # on a busy machine virtual devices are late
    "rig demo --fault": {1},  # the points fail, as they should
    "rig validate": {0, 1},  # by design a verdict is wrong once in twenty
    "rig replay run.mcap --to pty --speed 1": {0, 3},  # those who check the devices leave before its end
    "rig record my.toml -o again.mcap": {0, 3},  # Ctrl-C while the rotor turns in the log that is played
}
LOGS = "out/demo/logs"
IN_PLACE = {"LAST_LOG": f"{LOGS}/09-point-E.mcap", "LOG…": f"{LOGS}/05-point-A.mcap", "FOLDER": LOGS, "…": ""}
COPIES = {
    "run.mcap": f"{LOGS}/05-point-A.mcap",
    "parameters.toml": "out/demo/parameters.toml",
    "before.toml": "out/demo/parameters-before-points.toml",
    "after.toml": "out/demo/parameters.toml",
    "out/*-start-ups.mcap": f"{LOGS}/06-point-B.mcap",
    "logs/": LOGS,
}
DASK = "127.0.0.1:8786"


@dataclass(frozen=True)
class Ended:
    """How a command ended; its code is None if it did not."""

    code: int | None
    interrupted: bool
    text: str


def fault_of(ended: Ended, expected: set[int]) -> str:
    """What is wrong with an end; empty if nothing is."""
    fine = expected | ORDERLY if ended.interrupted else expected
    if ended.code is None:
        return f"still runs {ENDING_S:g} s after Ctrl-C"
    if "Traceback (most recent call last)" in ended.text:
        return f"exit {ended.code}, a traceback"
    return "" if ended.code in fine else f"exit {ended.code}, expected {sorted(fine)}"


def expected_of(command: str) -> set[int]:
    """Exit codes that are right: the one that the page states, else those of the command."""
    if stated := re.search(r"# exit (\d+)$", command):
        return {int(stated[1])}
    return next((codes for begin, codes in OWN_CODES.items() if command.startswith(begin)), {0})


def limit_of(command: str) -> float:
    """Time after which a command is interrupted, s."""
    if ENDLESS.match(command):
        return ENDLESS_LIMIT_S
    return LONG_LIMIT_S if LONG.match(command) else LIMIT_S


class Started:
    """A command as in a terminal of its own: a group of processes; what it writes is kept."""

    def __init__(self, command: str, folder: Path) -> None:
        added = {"PYTHONPATH": f"{folder / 'installed'}", "PATH": f"{Path(sys.executable).parent}"}
        paths = {name: f"{place}:{os.environ.get(name, '')}" for name, place in added.items()}
        environment = {**os.environ, **paths, "XDG_RUNTIME_DIR": str(folder), "PYTHONUNBUFFERED": "1"}
        self.began, self.command = time.monotonic(), command
        descriptor, self.written = tempfile.mkstemp(".txt", "shown-", folder)
        words = ["sh", "-c", f"exec {command}"]
        import pty

        self.keyboard, keys = pty.openpty()  # no key is pressed
        with open(descriptor, "wb") as shown:
            self.process = subprocess.Popen(
                words,
                cwd=folder,
                env=environment,
                stdin=keys,
                stdout=shown,
                stderr=shown,
                start_new_session=True,
            )
        os.close(keys)

    def text(self) -> str:
        """Return what it has written."""
        return Path(self.written).read_text("utf-8", "replace")

    def wait_for(self, ready: Callable[[], bool], limit_s: float = STARTING_S) -> None:
        """Return when it is ready, or never will be."""
        until = time.monotonic() + limit_s
        while not ready() and self.process.poll() is None and time.monotonic() < until:
            time.sleep(0.05)

    def ended(self, limit_s: float) -> Ended:
        """Wait, interrupt it at the limit, and leave no process of it behind."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(limit_s)
        if interrupted := self.process.returncode is None:
            os.killpg(self.process.pid, signal.SIGINT)
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(ENDING_S)
        code = self.process.returncode
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        os.close(self.keyboard)
        return Ended(code, interrupted, self.text())


def make_files(commands: str, folder: Path) -> None:
    """Make the files that a page takes for granted, from a demo."""
    demo = shutil.copytree("out/demo", folder / "out/demo")
    if "identify out " in commands:  # the tests before it are interrupted
        for path in (folder / LOGS).glob("0[1-4]-*"):
            shutil.copy(path, folder / "out")
    log = (folder / COPIES["run.mcap"]).read_bytes()
    half = len(log) // 2
    (folder / "NAME.mcap.part").write_bytes(log[:half])
    (folder / "damaged.mcap").write_bytes(log[:half] + bytes(1000) + log[half + 1000 :])
    (folder / "better.toml").write_text("[devices.laser_x]\nrange_m = 0.02503\n")
    (folder / "results").mkdir()
    for parameters in demo.glob("*.toml"):
        shutil.copy(parameters, folder / "results")
    if "rig import" in commands:
        make_recordings(folder)
    if "tilt" in commands:
        install_tilt(folder / "installed")


def make_recordings(folder: Path) -> None:
    """Write the recordings of other programs that pages import."""
    names = ("03-spin-down.mcap", "01-ring-down-x.mcap", "06-point-B.mcap")
    spin, pluck, point = (load_run(folder / LOGS / name) for name in names)
    y_m = [np.interp(run.x_time_s, run.y_time_s, run.y_m) for run in (pluck, point)]
    swing = np.column_stack([spin.angle_time_s, spin.angle_rad])
    np.savetxt(folder / "spin.csv", swing, delimiter=",", header="t,a,b", comments="")
    decay = np.column_stack([pluck.x_time_s * 1e3, pluck.x_m * 1e3, -y_m[0] * 1e6])
    np.savetxt(folder / "pluck.csv", decay, delimiter=",", header="t,disp1,disp2", comments="")
    a, b = np.rad2deg(point.angle_rad).T
    lasers = {"t": point.x_time_s, "d": np.column_stack([point.x_m, y_m[1]]) * 1e3}
    content = {"rec": lasers, "enc": {"t": point.angle_time_s, "a": a, "b": b}, "idx": point.mark_time_s}
    scipy.io.savemat(folder / "b.mat", content)


def install_tilt(site: Path) -> None:
    """Install the example of a driver, for the commands of one page."""
    source = ROOT / "examples/rig_driver_tilt"
    project = tomllib.loads((source / "pyproject.toml").read_text("utf-8"))["project"]
    site.mkdir(exist_ok=True)
    shutil.copy(source / "rig_driver_tilt.py", site)
    (facts := site / "rig_driver_tilt.dist-info").mkdir()
    (facts / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    drivers = project["entry-points"]["rig.drivers"].items()
    (facts / "entry_points.txt").write_text("\n".join(["[rig.drivers]", *(f"{k} = {v}" for k, v in drivers)]))


class PageRun:
    """The commands of one page, and those that run with them until it ends."""

    def __init__(self, page: Path, folder: Path) -> None:
        self.name, self.folder = page.stem, folder
        self.running: list[Started] = []
        self.faults: list[str] = []

    def carry_out(self, shown: str, at_prompts: Sequence[str] = ()) -> None:
        """Run one command to its end or limit, and others at its prompts; only start a rig."""
        self.provide(shown)
        if rig := re.match(r"rig virtual (?:\w+ )?-o (\S+)", shown):
            self.start(shown, lambda _: (self.folder / rig[1]).exists())
            return
        command = self.played_to(shown) if "/dev/pts/3" in shown else shown
        for word, meant in IN_PLACE.items():
            command = re.sub(rf"(?<!\w){word}(?!\w)", meant, command)
        started = Started(command, self.folder)
        for number, answer in enumerate(at_prompts, 1):
            started.wait_for(lambda number=number: started.text().count(PROMPT) >= number, PROMPT_LIMIT_S)
            self.carry_out(answer)
        self.judge(shown, started, PROMPT_LIMIT_S if at_prompts else limit_of(shown))

    def provide(self, command: str) -> None:
        """Copy from the demo what a command names and none before it has made; remove the file that it makes."""
        for name, origin in COPIES.items():
            place = self.folder / name.replace("*", "01")
            if re.search(rf"(?<![\w/.-]){re.escape(name)}", command) and not place.exists():
                (shutil.copytree if name.endswith("/") else shutil.copy)(self.folder / origin, place)
        made = re.search(r" -o (\S+\.\w+)", command)
        if made and (self.folder / made[1]).is_file():
            (self.folder / made[1]).unlink()

    def start(self, command: str, ready: Callable[[str], bool]) -> str:
        """Start a command that runs with the others; return what it has written when it is ready."""
        self.running.append(started := Started(command, self.folder))
        started.wait_for(lambda: ready(started.text()))
        return started.text()

    def played_to(self, command: str) -> str:
        """Play the log to ports, and return a command with these ports."""
        replay = "rig replay run.mcap --to pty --speed 1"
        shown = self.start(replay, lambda text: bool(re.search(r'^\{"ports".*\n', text, re.MULTILINE)))
        ports = json.loads(next(line for line in shown.splitlines() if line.startswith('{"ports"')))["ports"]
        return re.sub(
            r"--set \S+=/dev/pts/3 …", " ".join(f"--set devices.{k}.port={v}" for k, v in ports.items()), command
        )

    def judge(self, shown: str, started: Started, limit_s: float) -> None:
        """Print how a command ended, and keep what is wrong with it."""
        ended = started.ended(limit_s)
        seconds, code = time.monotonic() - started.began, "" if ended.code is None else ended.code
        fault = fault_of(ended, expected_of(shown))
        print(f"{seconds:5.1f} s {code:>4}  {shown}   [{self.name}]{fault and f'  FAULT {fault}'}", flush=True)
        if fault:
            last = "\n".join(ended.text.splitlines()[-25:])
            self.faults.append(f"\n{self.name}: {started.command}\n{fault}\n{last}")


def run_page(page: Path) -> list[str]:
    """Carry out a page's commands and return the faults."""
    port = free_port()
    commands = [command.replace(DASK, f"127.0.0.1:{port}") for command in shown_on(page)]
    text = "\n".join(commands)
    rig = ["rig virtual -o my.toml"] if "my.toml" in text and "-o my.toml" not in text else []
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        run = PageRun(page, Path(name))
        make_files(text, run.folder)
        if str(port) in text:
            stack.enter_context(dask_processes(run.folder, port))
        for command, at_prompts in with_answers([*rig, *commands], set(AT_A_PROMPT.findall(text_of(page)))):
            run.carry_out(command, at_prompts)
        for started in run.running:
            run.judge(started.command, started, 1.0)
    return run.faults


def with_answers(commands: Sequence[str], answers: Set[str]) -> list[tuple[str, list[str]]]:
    """Return the commands that are no answers, each with the answers that follow it."""
    out: list[tuple[str, list[str]]] = []
    for command in commands:
        if command in answers and out:
            out[-1][1].append(command)
        else:
            out.append((command, []))
    return out


def shown_on(page: Path) -> list[str]:
    """Return the commands of a page that are carried out."""
    return [each for each in in_blocks(text_of(page)) if not any(far in each for far in NOT_CARRIED_OUT)]


def main(word: str = "") -> int:
    """Run the pages, those with a virtual rig last, whose devices are late during a long study."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it
    pages = [page for page in PAGES if word in page.as_posix() and shown_on(page)]
    pages.sort(
        key=lambda page: (bool(re.search(r"(?:my|hand)\.toml|rig virtual", str(shown_on(page)))), -len(shown_on(page)))
    )
    with ThreadPoolExecutor(2) as pool:
        faults = [fault for found in pool.map(run_page, pages) for fault in found]
    print(*faults, sep="\n")
    print(
        f"{sum(len(shown_on(page)) for page in pages)} commands on {len(pages)} pages ran, {len(faults)} with a fault"
    )
    for key, why in NOT_CARRIED_OUT.items():
        print(
            *(f"not carried out: {each}: {why}" for page in PAGES for each in in_blocks(text_of(page)) if key in each)
        )
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
