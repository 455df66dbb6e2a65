"""The campaign's worker process ends with the command that started it, also when that is killed outright."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import pytest

from rig_cli import workbench

PARENT = """
    import os, time
    from rig_cli import workbench

    if __name__ == "__main__":
        bench = workbench.Workbench()
        print(bench._pool.submit(os.getpid).result(), flush=True)
        time.sleep(60)
"""


def test_a_killed_command_leaves_no_worker(tmp_path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(textwrap.dedent(PARENT))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    parent = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True, env=environment)
    with parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        try:
            parent.kill()
            # the worker has inherited the pipe: it ends when neither of them is there any more
            assert parent.communicate(timeout=20) == ("", None)
        except subprocess.TimeoutExpired:
            os.kill(worker, signal.SIGTERM)
            pytest.fail("the worker outlived the command that started it")


def test_a_command_that_is_interrupted_does_not_wait_for_its_worker() -> None:
    bench = workbench.Workbench()
    bench._pool.submit(time.sleep, 3600)  # a fit that goes on for ever
    worker = next(iter(bench._pool._processes.values()))
    closing = threading.Thread(target=bench.close, daemon=True)
    closing.start()
    closing.join(20)  # the only waiter for the worker's end: of two waiters for a process one misses it
    assert not closing.is_alive()
    assert worker.exitcode is not None
